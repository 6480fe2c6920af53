"""What a measurement file claims about its arrays, checked before an array is read.

A header of a few bytes can claim an array of any type and any size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from disk.byte_size import binary_size
from disk.machine_memory import memory_shortage

ARRAYS: Final[tuple[str, ...]] = ("phasors", "frequencies_hz", "reference", "horizontal_fov_deg")
PICKLED: Final = (
    "it holds pickled Python objects, which could run any program; save plain arrays: where it was made, "
    "numpy.savez('frames.npz', raw=...) with an array of numbers for each name"
)
_KINDS: Final = {
    "phasors": "complex, Re + j Im",
    "reference": "complex, Re + j Im",
    "frequencies_hz": "a list of numbers",
}
_COPIES = 2  # of an array: one in the process that reads the file, and one in the process that uses it
_MOST_EXPANSION = 1032  # unpacked by packed bytes: the limit of deflate, which other methods do not reach


class RefusedError(ValueError):
    """A file is not read; the message is one sentence that names it."""


@dataclass
class Claims:
    """What the arrays of a file claim together.

    Attributes
    ----------
    path : the file.
    taken : bytes of the arrays that were read before, also from other files.
    """

    path: Path
    taken: int = 0

    def add(self, name: str, dtype: np.dtype[np.generic], shape: tuple[int, ...], packed: int) -> None:
        """Check the claim of an array (`check_claim`) that is read beside those before it."""
        check_claim(self.path, name, dtype, shape, packed, taken=self.taken)
        self.taken += math.prod(shape) * dtype.itemsize


def check_claim(
    path: Path, name: str, dtype: np.dtype[np.generic], shape: tuple[int, ...], packed: int, *, taken: int = 0
) -> None:
    """Refuse an array that is not of numbers, or larger than its file or this machine can hold.

    Parameters
    ----------
    dtype, shape : of the array, as the file's header says.
    packed : bytes that the file has for the array, perhaps compressed.
    taken : bytes of the arrays that are in memory already.

    Raises
    ------
    RefusedError : the array is not read.
    """
    if dtype.hasobject:
        raise RefusedError(f"{path} cannot be read: {PICKLED}")
    if dtype.kind not in "iufc" or dtype.itemsize > np.dtype(np.clongdouble).itemsize:
        kind = _KINDS.get(name, "numbers")
        raise RefusedError(f"{path}: {name} must be {kind}, got {dtype} of shape {shape}")
    count = math.prod(shape) * dtype.itemsize
    if count > packed * _MOST_EXPANSION:
        raise RefusedError(
            f"{path}: {name} of shape {shape} claims {binary_size(count)}, but the file holds only "
            f"{binary_size(packed)} for it: the file is damaged; write it again"
        )
    if shortage := memory_shortage(taken + count, copies=_COPIES):
        others = " with the arrays before it" if taken else ""
        advice = "give fewer images at a time" if taken else "write fewer images into a file"
        raise RefusedError(f"{path}: {name} of shape {shape}{others} {shortage}: {advice}")
