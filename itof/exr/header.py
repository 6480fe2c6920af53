"""The structure of an EXR file, read and checked in plain Python before OpenEXR sees the file.

OpenEXR is a C++ library. A header that is damaged, or made to do harm, can crash the process, or make it use
all memory. `read_structure` therefore reads everything but the pixels itself: magic number, version, header,
table of chunk offsets, and the place and length of every chunk. It refuses what it does not know for certain.
Only files that pass are handed to OpenEXR, which then meets nothing but a plausible image.

Source: https://openexr.com/en/latest/OpenEXRFileLayout.html (version 2, single-part scan-line images).
"""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from disk import NightError

_MAGIC: Final = b"\x76\x2f\x31\x01"
_LONG_NAMES: Final = 0x400  # the flags of the version that a single-part scan-line image may have
_FLAGS: Final = {0x200: "tiled", 0x800: "deep", 0x1000: "multi-part"}
_PIXEL_TYPES: Final = {0: ("UINT", 4), 1: ("HALF", 2), 2: ("FLOAT", 4)}  # name and bytes of a value
# Scan lines of a chunk. Not listed are DWAA, DWAB and the JPEG 2000 methods: they are lossy or can expand a
# few bytes without limit.
_CHUNK_LINES: Final = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 13: 1}
_COMPRESSIONS: Final = "NONE, RLE, ZIPS, ZIP, PIZ, PXR24, B44 or ZSTD"
# Unpacked by packed bytes, at most: 1032 is the limit of deflate, PXR24 has 4/3 of that. ZSTD (13) can expand
# 4 bytes to 128 KiB.
_EXPANSION: Final = dict.fromkeys(_CHUNK_LINES, 1400) | {13: 32_768}
_MOST_HEADER_BYTES: Final = 16 * 2**20
_MOST_ATTRIBUTES: Final = 10_000
_REQUIRED: Final = {  # attributes that every file has, and their types
    "channels": "chlist",
    "compression": "compression",
    "dataWindow": "box2i",
    "displayWindow": "box2i",
    "lineOrder": "lineOrder",
    "pixelAspectRatio": "float",
    "screenWindowCenter": "v2f",
    "screenWindowWidth": "float",
}
_KINDS_OF_SIZE: Final = {  # types of attributes by the bytes that their values have; others have any size
    1: "compression lineOrder envmap deepImageState",
    4: "float int",
    8: "double rational timecode v2f v2i",
    9: "tiledesc",
    12: "v3f v3i",
    16: "box2f box2i v2d",
    24: "v3d",
    28: "keycode",
    32: "chromaticities",
    36: "m33f",
    64: "m44f",
    72: "m33d",
    128: "m44d",
}
_SIZES: Final = {kind: size for size, kinds in _KINDS_OF_SIZE.items() for kind in kinds.split()}


class ImageFileError(NightError):
    """An image file that is missing, damaged, of another program, or against its layout."""


class UnsupportedImageError(ImageFileError):
    """An EXR file of a kind that NIGHT does not read."""


@dataclass(frozen=True)
class ExrStructure:
    """What an EXR file says of its pixels.

    Attributes
    ----------
    channels : number type of each channel, by name: ``FLOAT``, ``HALF`` or ``UINT``.
    texts : attributes of type string, by name.
    first_column, first_row : corner of the data window.
    width, height : size of the data window, pixels.
    chunk_lines : rows that are packed together, and therefore unpacked together.
    """

    channels: dict[str, str]
    texts: dict[str, str]
    first_column: int
    first_row: int
    width: int
    height: int
    chunk_lines: int

    @property
    def row_bytes(self) -> int:
        """Size of a row of all channels, unpacked."""
        types = dict(_PIXEL_TYPES.values())
        return self.width * sum(types[kind] for kind in self.channels.values())

    @property
    def unpacking_bytes(self) -> int:
        """Memory that OpenEXR needs to unpack one chunk: about twice its size (measured with PIZ)."""
        return 2 * self.row_bytes * min(self.chunk_lines, self.height)

    @property
    def float_bytes(self) -> int:
        """Size of all channels in memory as float32."""
        return 4 * len(self.channels) * self.width * self.height


def read_structure(stream: BinaryIO) -> ExrStructure:
    """Read and check the structure of an open EXR file, from its beginning.

    Raises
    ------
    ImageFileError : it is damaged, truncated or no EXR file; the message is a clause without the file's name.
    UnsupportedImageError : it is not a single-part scan-line image, or its compression is not supported.
    OSError : the file cannot be read.
    """
    size = os.fstat(stream.fileno()).st_size
    stream.seek(0)
    if stream.read(4) != _MAGIC:
        raise ImageFileError("it does not begin as an EXR file does")
    attributes = _attributes(stream, _name_limit(stream), size)
    for name, kind in _REQUIRED.items():
        if attributes.get(name, ("", b""))[0] != kind:
            raise ImageFileError(f"its header has no attribute {name} of type {kind}")
    found = _checked(attributes)
    _check_chunks(stream, size, found, attributes["compression"][1][0], found.row_bytes)
    return found


def _name_limit(stream: BinaryIO) -> int:
    """Greatest length of a name, from the version field."""
    field = _number(stream)
    flags = field & ~0xFF
    kinds = [kind for flag, kind in _FLAGS.items() if flags & flag]
    if kinds:
        raise UnsupportedImageError(
            f"it is a {kinds[0]} image, and only single-part scan-line images are read"
        )
    if field & 0xFF != 2 or flags & ~_LONG_NAMES:
        raise ImageFileError(f"its version field is {field:#x}, and only version 2 is supported")
    return 255 if flags & _LONG_NAMES else 31


def _attributes(stream: BinaryIO, longest: int, size: int) -> dict[str, tuple[str, bytes]]:
    """Type and value of every attribute, by name."""
    found: dict[str, tuple[str, bytes]] = {}
    while name := _name(_until_zero(stream, longest)):
        kind = _name(_until_zero(stream, longest))
        length = _number(stream)
        if not kind or name in found:
            raise ImageFileError(f"its attribute {name} is there twice, or has no type")
        if length > size - stream.tell():
            raise ImageFileError(f"its attribute {name} claims {length} bytes, more than the file has left")
        if length != _SIZES.get(kind, length):
            raise ImageFileError(f"its attribute {name} of type {kind} has {length} bytes")
        if stream.tell() + length > _MOST_HEADER_BYTES or len(found) == _MOST_ATTRIBUTES:
            raise ImageFileError(
                f"its header has more than {_MOST_HEADER_BYTES} bytes or {_MOST_ATTRIBUTES} attributes"
            )
        found[name] = (kind, stream.read(length))
    return found


def _checked(attributes: dict[str, tuple[str, bytes]]) -> ExrStructure:
    """The image that the header describes."""
    values = {name: value for name, (_, value) in attributes.items()}
    kind = values.get("type", b"scanlineimage")
    if kind != b"scanlineimage" or "tiles" in values:
        raise UnsupportedImageError("it is not a scan-line image")
    if values["compression"][0] not in _CHUNK_LINES:
        raise UnsupportedImageError(f"its compression is none of {_COMPRESSIONS}: save it with ZIPS")
    if values["lineOrder"][0] > 1:
        raise ImageFileError("the order of its scan lines is unknown")
    for name, least in (("pixelAspectRatio", 1e-6), ("screenWindowWidth", 0.0)):
        if not least <= struct.unpack("<f", values[name])[0] <= 1e6:
            raise ImageFileError(f"its {name} is not plausible")
    if not all(math.isfinite(value) for value in struct.unpack("<2f", values["screenWindowCenter"])):
        raise ImageFileError("its screenWindowCenter is not finite")
    _box(values["displayWindow"], "displayWindow")
    left, top, right, bottom = _box(values["dataWindow"], "dataWindow")
    found = ExrStructure(
        channels=_channels(values["channels"]),
        texts={
            name: _decoded(value, f"its attribute {name}")
            for name, (kind, value) in attributes.items()
            if kind == "string"
        },
        first_column=left,
        first_row=top,
        width=right - left + 1,
        height=bottom - top + 1,
        chunk_lines=_CHUNK_LINES[values["compression"][0]],
    )
    chunks = -(-found.height // found.chunk_lines)
    if values.get("chunkCount", struct.pack("<i", chunks)) != struct.pack("<i", chunks):
        raise ImageFileError("its attribute chunkCount does not fit its height")
    return found


def _channels(value: bytes) -> dict[str, str]:
    """Number type of each channel, by name, from the attribute ``channels``."""
    found: dict[str, str] = {}
    at = 0
    while value[at : at + 1] != b"\0":
        end = value.find(b"\0", at)
        if end < 0 or end - at > 255 or len(value) < end + 18:
            raise ImageFileError("its list of channels is damaged")
        name = _name(value[at:end])
        kind, _, across, down = struct.unpack("<iB3x2i", value[end + 1 : end + 17])
        if not name or name in found or kind not in _PIXEL_TYPES:
            raise ImageFileError(f"its channel {name!r} is there twice, or of an unknown number type")
        if (across, down) != (1, 1):
            raise UnsupportedImageError(f"its channel {name} does not have a value for every pixel")
        found[name] = _PIXEL_TYPES[kind][0]
        at = end + 17
    if not found or at != len(value) - 1:
        raise ImageFileError("its list of channels is empty or damaged")
    return found


def _box(value: bytes, name: str) -> tuple[int, int, int, int]:
    left, top, right, bottom = struct.unpack("<4i", value)
    if not (left <= right and top <= bottom and max(map(abs, (left, top, right, bottom))) < 2**30):
        raise ImageFileError(f"its {name} is not plausible")
    return left, top, right, bottom


def _check_chunks(stream: BinaryIO, size: int, found: ExrStructure, compression: int, row_bytes: int) -> None:
    """Refuse a table of offsets whose chunks do not fill the rest of the file, one after the other."""
    lines = _CHUNK_LINES[compression]
    count = -(-found.height // lines)
    start = stream.tell() + 8 * count
    held = size - start
    if held < 8 * count or row_bytes * found.height > held * _EXPANSION[compression]:
        raise ImageFileError(
            f"it claims {found.width}x{found.height} pixels in {len(found.channels)} channels, more than "
            f"a file of {size} bytes can hold: it is truncated, or its header is damaged"
        )
    table = np.frombuffer(stream.read(8 * count), "<u8")
    if ((table < start) | (table > size - 8)).any():
        raise ImageFileError("its scan lines lie outside the file: it is damaged, truncated or unfinished")
    offsets = table.astype(np.int64)
    packed = _packed_bytes(stream, offsets, found.first_row, lines)
    rows = np.minimum(lines, found.height - lines * np.arange(count))
    order = np.argsort(offsets)
    ends = (offsets + 8 + packed)[order]
    if (packed < 1).any() or (packed > rows * row_bytes).any():
        raise ImageFileError("its scan lines do not have the size that its header says")
    if offsets[order[0]] != start or (ends[:-1] != offsets[order[1:]]).any() or ends[-1] != size:
        raise ImageFileError("its scan lines do not fill the file without gaps: it is damaged or truncated")


def _packed_bytes(
    stream: BinaryIO, offsets: NDArray[np.int64], first_row: int, lines: int
) -> NDArray[np.int64]:
    """Packed bytes of the chunk at each offset; a chunk of other rows than its place says is refused."""
    heads = b"".join(os.pread(stream.fileno(), 8, offset) for offset in offsets.tolist())
    if len(heads) != 8 * len(offsets):
        raise ImageFileError("it ends too early")
    row, packed = np.frombuffer(heads, "<i4").reshape(-1, 2).T.astype(np.int64)
    if (row != first_row + lines * np.arange(len(offsets))).any():
        raise ImageFileError("its scan lines are not where its header says")
    return packed


def _number(stream: BinaryIO) -> int:
    """An unsigned number of four bytes."""
    value = stream.read(4)
    if len(value) < 4:
        raise ImageFileError("it ends within its header")
    return int.from_bytes(value, "little")


def _until_zero(stream: BinaryIO, longest: int) -> bytes:
    """Bytes up to the next zero, at most `longest`."""
    start = stream.tell()
    value, zero, _ = stream.read(longest + 1).partition(b"\0")
    if not zero:
        raise ImageFileError("its header is damaged: a name has no end")
    stream.seek(start + len(value) + 1)
    return value


def _name(value: bytes) -> str:
    name = _decoded(value, "a name in its header")
    if not name.isprintable():  # the empty name is
        raise ImageFileError("a name in its header has characters that cannot be printed")
    return name


def _decoded(value: bytes, what: str) -> str:
    try:
        return value.decode()
    except UnicodeDecodeError:
        raise ImageFileError(f"{what} is not UTF-8") from None
