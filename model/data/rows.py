"""Rows of the shards: measurement and ground truth, one row for each scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import DTypeLike, NDArray

ARRAYS = ("phasors", "target", "radial_depth_m", "mask")


@dataclass(frozen=True)
class RowLayout:
    """Image size and number of frequencies of a row; they determine its arrays."""

    width: int
    height: int
    frequency_count: int

    @property
    def arrays(self) -> dict[str, tuple[DTypeLike, tuple[int, ...]]]:
        """Number type and shape of a row in each array."""
        image = (self.height, self.width)
        return {
            "phasors": (np.complex64, (*image, self.frequency_count)),
            "target": (np.complex64, image),
            "radial_depth_m": (np.float32, image),
            "mask": (np.uint8, image),
        }

    @property
    def row_bytes(self) -> int:
        """Size of a row in all arrays together, bytes."""
        return sum(np.dtype(t).itemsize * math.prod(shape) for t, shape in self.arrays.values())

    def empty(self, rows: Sequence[int]) -> RowBlock:
        """An uninitialised block for `rows`."""
        arrays = {name: np.empty((len(rows), *shape), dtype) for name, (dtype, shape) in self.arrays.items()}
        return RowBlock(tuple(rows), **arrays)


@dataclass(frozen=True)
class RowBlock:
    """n rows of the shards, as numpy arrays in memory or as tensors on a device.

    Attributes
    ----------
    rows : n row numbers, in the order of the arrays.
    phasors : (n, H, W, F) complex64.
    target : (n, H, W) complex64, phasor of the mirrored scene at the first frequency.
    radial_depth_m : (n, H, W) float32, metres, 0 on background.
    mask : (n, H, W) uint8, 0 or 1.
    reference : (n, H, W, F or F + 1) complex64, `InputSpec.reference_of_image` of every image
        (`model.network.channels`), which `model.data.batches` adds; None as read from the shards.
    fields_of_view_deg : (n,) full horizontal field of view of each scene, numpy; None if all have that of the
        dataset.
    """

    rows: tuple[int, ...]
    phasors: Any
    target: Any
    radial_depth_m: Any
    mask: Any
    reference: Any = None
    fields_of_view_deg: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: Sequence[int]) -> RowBlock:
        """A copy of some rows, in the order of `rows`."""
        chosen = [self._places[row] for row in rows]
        arrays = {name: getattr(self, name)[chosen] for name in self._held}
        return RowBlock(tuple(rows), **arrays, fields_of_view_deg=self._views(chosen))

    def joined(self, other: RowBlock) -> RowBlock:
        """A block with these rows, followed by the rows of `other`."""
        xp = array_namespace(self.phasors)
        arrays = {name: xp.concat([getattr(self, name), getattr(other, name)]) for name in self._held}
        one, two = self.fields_of_view_deg, other.fields_of_view_deg
        views_deg = None if one is None or two is None else np.concatenate([one, two])
        return RowBlock(self.rows + other.rows, **arrays, fields_of_view_deg=views_deg)

    def _views(self, chosen: list[int]) -> NDArray[np.float64] | None:
        return None if self.fields_of_view_deg is None else self.fields_of_view_deg[chosen]

    @property
    def _held(self) -> tuple[str, ...]:
        return ARRAYS if self.reference is None else (*ARRAYS, "reference")

    @cached_property
    def _places(self) -> dict[int, int]:
        return {row: place for place, row in enumerate(self.rows)}
