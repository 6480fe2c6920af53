"""Arrays of an ``.npz`` file, a ZIP archive of ``.npy`` files, or of one of these; no pickled arrays.

`numpy.load` allocates what a header claims before it reads. Here the claim is checked first, and no more
bytes are unpacked than it says.
"""

from __future__ import annotations

import lzma
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np

from itof.arrays import Numbers
from itof.files.array_claims import PICKLED, Claims, RefusedError

_STEP = 16 * 2**20  # bytes unpacked at a time
_ZIP, _NPY, _PICKLE = b"PK", b"\x93NUMPY", b"\x80"  # first bytes of such files
BARE = "array"  # name of the array of a file that has no names
# RuntimeError: the archive is encrypted or its compression is unknown. The others: a header is damaged.
_ERRORS = (
    *(ValueError, OSError, EOFError, KeyError, RuntimeError, zipfile.BadZipFile, zlib.error),
    *(
        lzma.LZMAError,
        tokenize.TokenError,
        SyntaxError,
        RecursionError,
        NotImplementedError,
        OverflowError,
        TypeError,
    ),
)


def read_npz(path: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Numbers], list[str]]:
    """The arrays among `wanted` that a file has, and the names of all its arrays.

    Raises
    ------
    RefusedError : it is no archive, is damaged, has pickled arrays, or claims more than it can hold.
    """
    try:
        with path.open("rb") as stream:
            _refuse_other_kinds(path, stream.read(6))
            with zipfile.ZipFile(stream) as archive:
                entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
                claims = Claims(path)
                here = [name for name in dict.fromkeys(wanted) if name in entries]
                found = {name: _read(claims, name, archive, entries[name]) for name in here}
    except RefusedError:
        raise
    except _ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RefusedError(f"{path} cannot be read: it is damaged or no .npz archive ({reason})") from None
    return found, list(entries)


def read_npy(path: Path) -> tuple[dict[str, Numbers], list[str]]:
    """The array of an ``.npy`` file, under the name `BARE`; errors as of `read_npz`."""
    size = path.stat().st_size
    try:
        with path.open("rb") as stream:
            found = {BARE: _array(Claims(path), BARE, stream, size)}
    except RefusedError:
        raise
    except _ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RefusedError(f"{path} cannot be read: it is damaged or no .npy file ({reason})") from None
    return found, [BARE]


def _refuse_other_kinds(path: Path, start: bytes) -> None:
    if start.startswith(_NPY):
        raise RefusedError(
            f"{path} is one bare array, not an .npz archive: write it with numpy.savez, or name it .npy"
        )
    if start.startswith(_PICKLE):
        raise RefusedError(f"{path} cannot be read: {PICKLED}")
    if not start.startswith(_ZIP):
        raise RefusedError(
            f"{path} cannot be read: it is damaged or no .npz archive (write it with numpy.savez)"
        )


def _read(claims: Claims, name: str, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Numbers:
    with archive.open(entry) as member:
        return _array(claims, name, member, entry.compress_size)


def _array(claims: Claims, name: str, member: IO[bytes], packed: int) -> Numbers:
    """The array in a stream, which has so many bytes for it."""
    shape, fortran_order, dtype = _header(member)
    claims.add(name, dtype, shape, packed)
    values = np.empty(shape, dtype, order="F" if fortran_order else "C")
    target = values.reshape(-1, order="A").view(np.uint8).data
    at = 0
    while at < len(target):
        part = member.read(min(_STEP, len(target) - at))
        if not part:
            raise EOFError(f"the array {name} ends too early")
        target[at : at + len(part)] = part
        at += len(part)
    if member.read(1):  # at the end, an archive's checksum is compared
        raise ValueError(f"the array {name} is followed by other data")
    return values


def _header(member: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[np.number[Any]]]:
    """Shape, whether the order is Fortran's, and number type."""
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(member)
    if version not in readers:
        raise ValueError(f"an array has version {version} of the .npy format")
    try:
        shape, fortran_order, dtype = readers[version](member)
    except (RecursionError, MemoryError):
        raise ValueError("the header of an array is nested too deeply") from None
    if any(side < 0 for side in shape):
        raise ValueError(f"an array has the shape {shape}")
    return shape, fortran_order, dtype
