"""What a measurement file claims about its arrays, checked before an array is read.

A header of a few bytes can claim an array of any type and any size.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from itof.machine_memory import binary_size, memory_shortage

ARRAYS: Final[tuple[str, ...]] = ("phasors", "frequencies_hz", "reference")
_COPIES = 2  # of an array: one in the process that reads the file, and one in the process that uses it
_MOST_EXPANSION = 1032  # unpacked by packed bytes: the limit of deflate, which other methods do not reach


class RefusedError(ValueError):
    """A file is not read; the message is one sentence that names it."""


def check_claim(path: Path, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], packed: int) -> None:
    """Refuse an array that is not of numbers, or larger than its file or this machine can hold.

    Parameters
    ----------
    dtype, shape : of the array, as the file's header says.
    packed : bytes that the file has for the array, perhaps compressed.

    Raises
    ------
    RefusedError : the array is not read.
    """
    if dtype.hasobject:
        raise RefusedError(
            f"{path} cannot be read: it holds pickled Python objects, which could run any program; save "
            "plain arrays"
        )
    if dtype.kind not in "iufc" or dtype.itemsize > np.dtype(np.clongdouble).itemsize:
        kind = "complex, Re + j Im" if name != "frequencies_hz" else "a list of numbers"
        raise RefusedError(f"{path}: {name} must be {kind}, got {dtype} of shape {shape}")
    count = math.prod(shape) * dtype.itemsize
    if count > packed * _MOST_EXPANSION:
        raise RefusedError(
            f"{path}: {name} of shape {shape} claims {binary_size(count)}, but the file holds only "
            f"{binary_size(packed)} for it: the file is damaged; write it again"
        )
    if shortage := memory_shortage(count, copies=_COPIES):
        raise RefusedError(f"{path}: {name} of shape {shape} {shortage}: write fewer images into a file")
