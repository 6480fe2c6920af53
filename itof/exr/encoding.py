"""An EXR image as bytes, written in plain Python: so thousands of small images cost little, and errors are
those of the system.

Source: https://openexr.com/en/latest/OpenEXRFileLayout.html (version 2, single-part scan-line images), and
``ImfZip.cpp`` of OpenEXR for the order of bytes before compression.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

ATTRIBUTE_PREFIX: Final = "night."
_MAGIC: Final = 20000630
_LONG_NAMES: Final = 0x400  # of the version: names of more than 31 bytes
_FLOAT: Final = 2
_NONE, _ZIPS = 0, 2  # compressions
_LEVEL: Final = 4  # of deflate, as OpenEXR has it
_LONGEST: Final = 31


def image_bytes(
    channels: Mapping[str, ArrayLike], attributes: Mapping[str, str], *, packed: bool = True
) -> bytearray:
    """The file of named (H, W) channels as float32, with text attributes.

    Parameters
    ----------
    packed : compressed (ZIPS), or not at all: rows of phasors become 0 to 2 % smaller, for most of the time
        that it takes to write them.

    Raises
    ------
    ValueError : channels of different shapes, or not of two dimensions.
    """
    pixels = {name: np.ascontiguousarray(values, dtype="<f4") for name, values in channels.items()}
    shapes = {values.shape for values in pixels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise ValueError(f"all channels of an image have one shape (H, W), got {sorted(shapes)}")
    height, width = next(iter(shapes))
    names = sorted(pixels, key=str.encode)
    header = _header(names, width, height, attributes, _ZIPS if packed else _NONE)
    table = np.empty((height, 8 + 4 * width * len(names)), np.uint8)  # a chunk in each row
    for place, name in enumerate(names):
        start = 8 + 4 * width * place
        table[:, start : start + 4 * width] = pixels[name].view(np.uint8)
    rows = _packed(table[:, 8:]) if packed else [table[0, 8:]] * height
    lengths = np.array([len(row) for row in rows])
    table[:, :8] = np.stack([np.arange(height), lengths], axis=1).astype("<i4").view(np.uint8)
    offsets = len(header) + 8 * height + np.cumsum(lengths + 8) - lengths - 8
    whole = bytearray(header + offsets.astype("<u8").tobytes())
    if not packed:
        return whole + table.data
    return whole + b"".join(head.tobytes() + row for head, row in zip(table[:, :8], rows, strict=True))


def _header(names: list[str], width: int, height: int, attributes: Mapping[str, str], method: int) -> bytes:
    """Magic number, version and attributes, sorted by name as OpenEXR sorts them."""
    channels = b"".join(name.encode() + b"\0" + struct.pack("<4i", _FLOAT, 0, 1, 1) for name in names)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    found = {
        "channels": ("chlist", channels + b"\0"),
        "compression": ("compression", bytes([method])),
        "dataWindow": ("box2i", window),
        "displayWindow": ("box2i", window),
        "lineOrder": ("lineOrder", bytes([0])),
        "pixelAspectRatio": ("float", struct.pack("<f", 1)),
        "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1)),
        **{ATTRIBUTE_PREFIX + name: ("string", text.encode()) for name, text in attributes.items()},
    }
    long = max(len(name.encode()) for name in (*names, *found)) > _LONGEST
    version = struct.pack("<2i", _MAGIC, 2 | (_LONG_NAMES if long else 0))
    parts = (
        b"\0".join([name.encode(), kind.encode(), struct.pack("<i", len(value)) + value])
        for name, (kind, value) in sorted(found.items())
    )
    return version + b"".join(parts) + b"\0"


def _packed(raw: NDArray[np.uint8]) -> list[bytes]:
    """The rows, each as deflate makes it, or as it is where that is not smaller."""
    split = np.concatenate([raw[:, ::2], raw[:, 1::2]], axis=1)
    split[:, 1:] = np.diff(split, axis=1) + np.uint8(128)
    rows = [(row.tobytes(), step.tobytes()) for row, step in zip(raw, split, strict=True)]
    made = {step: zlib.compress(step, _LEVEL) for step in {step for _, step in rows}}  # many rows are alike
    return [
        min(row, made[step], key=len) for row, step in rows
    ]  # readers take one of a row's length as it is
