"""Blocks of pixels: the few values of an image that a measurement and a model are compared by.

A value of a smooth image in the middle of a block differs from the mean by 1/24 of the second differences
between blocks. A model with many nodes has the light of several rays in each block. So its means are those
of the measurement also where a shadow ends in a block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_PARTS: Final = (4, 3, 2)  # of a block along each side, the first that fits


@dataclass(frozen=True)
class Blocks:
    """Square blocks of `size` pixels in the middle of an image."""

    size: int

    @classmethod
    def of(cls, height: int, rows: int) -> Blocks:
        """About so many rows of blocks in an image of this height."""
        size = max(1, height // rows)
        return cls(size if size < 2 * _PARTS[0] else size // _PARTS[0] * _PARTS[0])

    @property
    def parts(self) -> int:
        """Of a block along each side: those for which a model with many nodes has a ray."""
        return next(parts for parts in (*_PARTS, self.size) if self.size % parts == 0)

    def middles(self, image: NDArray[Any]) -> NDArray[Any]:
        """(R, C, ...) values of an image (H, W, ...) in the middles of blocks; NaN if one of a block is."""
        return _sharpened(_means(image, self.size), self.size)

    def middles_of_parts(self, values: NDArray[Any], where: NDArray[np.bool_]) -> NDArray[Any]:
        """(P, ...) values in the middles of P blocks `where` (R, C), from those of parts (P, n, ...)."""
        means = np.full((*where.shape, *values.shape[2:]), np.nan, values.dtype)
        means[where] = values.mean(axis=1)
        found: NDArray[Any] = _sharpened(means, self.parts)[where]
        return found

    def rays_of_parts(self, rays: Floats, where: NDArray[np.bool_]) -> Floats:
        """(P, n, 3) unit rays through the middles of the parts, from those of the pixels (H, W, 3)."""
        count = self.size // self.parts
        means = _means(_cut(rays / rays[..., 2:], self.size), count)  # of places at z = 1
        rows, columns = where.shape
        parts = means.reshape(rows, self.parts, columns, self.parts, 3).swapaxes(1, 2)[where]
        parts = parts.reshape(len(parts), -1, 3)
        found: Floats = parts / np.linalg.norm(parts, axis=-1, keepdims=True)
        return found

    @property
    def gain_of_noise(self) -> float:
        """Standard deviation of white noise in the middles over that in pixels."""
        share = _sharpening(self.size)  # of each of four neighbours, less four times that of the block itself
        return math.sqrt((1 + 4 * share) ** 2 + 4 * share**2) / self.size


def _cut(image: NDArray[Any], size: int) -> NDArray[Any]:
    """The middle of an image that blocks fill."""
    rows, columns = image.shape[0] // size, image.shape[1] // size
    top, left = (image.shape[0] - rows * size) // 2, (image.shape[1] - columns * size) // 2
    return image[top : top + rows * size, left : left + columns * size]


def _means(image: NDArray[Any], size: int) -> NDArray[Any]:
    """(R, C, ...) means of an image (H, W, ...) over its blocks."""
    cut = _cut(image, size)
    rows, columns = cut.shape[0] // size, cut.shape[1] // size
    means: NDArray[Any] = cut.reshape(rows, size, columns, size, *cut.shape[2:]).mean(axis=(1, 3))
    return means


def _sharpened(means: NDArray[Any], size: int) -> NDArray[Any]:
    """Values in the middles of blocks (R, C, ...), from means over them."""
    if size == 1 or min(means.shape[:2]) <= 2:
        return means
    return means - _sharpening(size) * sum(_second_differences(means, axis) for axis in (0, 1))


def _sharpening(size: int) -> float:
    """Share of the second differences between blocks that makes their means the values in the middle."""
    return (1 - size**-2) / 24


def _second_differences(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Of (R, C, ...) along an axis; at both ends, and beside NaN, those of the nearest neighbour with any."""
    inner = np.moveaxis(np.diff(values, 2, axis=axis), axis, 0)  # (n, m, ...)
    known = np.isfinite(inner).reshape(*inner.shape[:2], -1).all(axis=-1)
    place = np.arange(len(inner))[:, None, None]
    away = np.where(known.T[None], np.abs(place - place.T), np.iinfo(int).max)  # (n, m, n)
    nearest = away.argmin(axis=2)
    found = inner[nearest, np.arange(inner.shape[1])]
    found[:, ~known.any(axis=0)] = 0
    return np.moveaxis(np.concatenate([found[:1], found, found[-1:]]), 0, axis)
