"""Numpy arrays as DrJit arrays. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64  # bytes, as in the arrays that DrJit allocates


def upload(values: NDArray[np.floating]) -> mi.Float:
    """Numpy values as a DrJit array, from aligned memory.

    On the CPU, DrJit uses the memory of the numpy array, and the alignment is part of the kernel: with
    another alignment, the kernel would be compiled again.
    """
    return mi.Float(_aligned(np.ascontiguousarray(values, dtype=np.float32).ravel()))


def upload_indices(values: NDArray[np.integer]) -> mi.UInt32:
    """Numpy integers as a DrJit array, from aligned memory."""
    return mi.UInt32(_aligned(np.ascontiguousarray(values, dtype=np.uint32).ravel()))


def upload_points(values: NDArray[np.floating]) -> mi.Point3f:
    """(N, 3) numpy values as N points."""
    return mi.Point3f(*(upload(column) for column in np.asarray(values).T))


def _aligned(flat: NDArray[Any]) -> NDArray[Any]:
    room = np.empty(flat.nbytes + _ALIGNMENT, np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    aligned = room[start : start + flat.nbytes].view(flat.dtype)
    aligned[:] = flat
    return aligned
