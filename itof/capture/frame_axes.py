"""Arrays of frames with any order of axes, in the order (frame, frequency, step, tap, row, column)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from itof.arrays import S
from itof.capture.sidecar import AXES, CaptureError


def ordered(values: NDArray[S], axes: Sequence[str], sizes: Mapping[str, int], what: str) -> NDArray[S]:
    """A view, if possible, of an array with all six axes; those that it does not have get the size 1.

    Parameters
    ----------
    axes : names of the array's axes; ``frequency*step`` is one axis for two. Axes of size one may be missing
        in the array or in the names.
    sizes : sizes that axes must have, by name.
    what : the array and its file, for messages.

    Raises
    ------
    CaptureError : the array has another number of axes, or one of another size.
    """
    if values.ndim != len(axes):
        values = values.squeeze()
        long = [axis for axis in axes if math.prod(sizes.get(part, 2) for part in axis.split("*")) > 1]
        axes = long if values.ndim != len(axes) else axes
        if values.ndim != len(axes):  # an axis of unknown size, such as the frames, may have the size 1
            axes = [axis for axis in axes if axis != "frame"]
    if values.ndim != len(axes):
        raise CaptureError(
            f"{what} has the shape {values.shape}, which does not fit the axes {', '.join(axes)}: correct "
            "axes"
        )
    names: list[str] = []
    shape: list[int] = []
    for axis, size in zip(axes, values.shape, strict=True):
        parts = axis.split("*")
        names += parts
        shape += _split(parts, size, sizes, what)
    split = values.reshape(shape)
    present = [axis for axis in AXES if axis in names]
    inner = split.transpose([names.index(axis) for axis in present])
    return inner.reshape([inner.shape[present.index(axis)] if axis in present else 1 for axis in AXES])


def _split(parts: list[str], size: int, sizes: Mapping[str, int], what: str) -> list[int]:
    """Sizes of the axes that one axis of an array holds."""
    known = math.prod(sizes.get(part, 1) for part in parts)
    free = [part for part in parts if part not in sizes]
    if len(free) > 1 or (size % known if free else size != known):
        name = "*".join(parts)
        raise CaptureError(
            f"{what} has {size} values on the axis {name}, and the sidecar says {known}"
            f"{' or a multiple' if free else ''}: a missing frequency, step or tap, or wrong axes?"
        )
    return [sizes.get(part, size // known) for part in parts]


def stacked(arrays: Sequence[NDArray[S]], along: str | None, what: str) -> NDArray[S]:
    """Arrays of six axes as one, side by side along one of them.

    Raises
    ------
    CaptureError : their other axes have different sizes.
    """
    if len(arrays) == 1:
        return arrays[0]
    place = AXES.index(along or "frame")
    shapes = [each.shape for each in arrays]
    if len({(*shape[:place], *shape[place + 1 :]) for shape in shapes}) > 1:
        raise CaptureError(f"{what}: arrays of the shapes {shapes[0]} and {shapes[-1]} do not fit each other")
    return np.concatenate(arrays, axis=place)
