"""``.npy`` files whose number type and shape are known before they are read.

The header of such a file is known to the byte, so it is compared and not parsed: what a damaged or foreign
header claims is never believed.
"""

from __future__ import annotations

import hashlib
import io
import math
import stat
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray


def header_of(dtype: DTypeLike, shape: tuple[int, ...]) -> bytes:
    """The header of a ``.npy`` file with an array of this type and shape."""
    header = io.BytesIO()
    description = np.lib.format.dtype_to_descr(np.dtype(dtype))
    np.lib.format.write_array_header_1_0(
        header, {"descr": description, "fortran_order": False, "shape": shape}
    )
    return header.getvalue()


def is_array_file(file: Path, dtype: DTypeLike, shape: tuple[int, ...]) -> bool:
    """Whether a file has this header and as many bytes of values as it needs."""
    header = header_of(dtype, shape)
    size = len(header) + math.prod(shape) * np.dtype(dtype).itemsize
    try:
        state = file.stat()
        if not stat.S_ISREG(state.st_mode) or state.st_size != size:
            return False
        with file.open("rb") as stream:
            return stream.read(len(header)) == header
    except OSError:
        return False


def read_array(file: Path, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """The array of a file; `ValueError` if the file has another type, shape or size."""
    if not is_array_file(file, dtype, shape):
        raise ValueError(f"{file} does not hold {np.dtype(dtype)} of shape {shape}")
    values = np.fromfile(file, dtype, math.prod(shape), offset=len(header_of(dtype, shape)))
    return values.reshape(shape)


class ArrayFile:
    """A ``.npy`` file that is written row by row, and its SHA-256."""

    def __init__(self, stream: BinaryIO, dtype: DTypeLike, shape: tuple[int, ...]) -> None:
        self._stream, self._dtype, self._hash = stream, np.dtype(dtype), hashlib.sha256()
        self._write(header_of(dtype, shape))

    def append(self, row: NDArray[np.generic]) -> None:
        """Write one row or more."""
        self._write(np.ascontiguousarray(row, self._dtype).tobytes())

    def sha256(self) -> str:
        """Hash of all that was written."""
        return self._hash.hexdigest()

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._hash.update(data)
