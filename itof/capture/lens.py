"""From the image of a lens with distortion to that of a pinhole camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from itof import pixel_rays
from itof.capture.sidecar import Lens
from itof.radial_distortion import radial_factor, turning_square

_WHOLE = 1 - 1e-9  # weight of good pixels that a value needs

Floats = NDArray[np.float64]


def seen_at(lens: Lens, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Column and row of the pixel that sees the rays (x, y) at z = 1; `Lens` has the equation."""
    square = x**2 + y**2
    radial = radial_factor(square, (lens.k1, lens.k2, lens.k3))
    across = x * radial + 2 * lens.p1 * x * y + lens.p2 * (square + 2 * x**2)
    down = y * radial + lens.p1 * (square + 2 * y**2) + 2 * lens.p2 * x * y
    return lens.cx + lens.fx * across, lens.cy + lens.fy * down


def turning_point(lens: Lens) -> float:
    """Smallest r² at z = 1 where the distorted radius r (1 + k1 r² + k2 r⁴ + k3 r⁶) stops growing with r.

    It is infinite if the radius always grows. Rays beyond it are folded back: calibrations do not hold there.
    """
    return turning_square((lens.k1, lens.k2, lens.k3))


@dataclass(frozen=True)
class Undistortion:
    """Takes images of a lens to the pinhole camera of the same size with a field of view.

    Values are linear between pixels. Phasors are interpolated, not phases.

    Attributes
    ----------
    places, weights : flat indices and weights (H, W) of the four pixels around the place that sees the ray of
        each pixel; the weight outside of the image, and of rays that the distortion folds back, is 0.
    """

    places: tuple[NDArray[np.intp], ...]
    weights: tuple[Floats, ...]

    @classmethod
    def of(cls, lens: Lens, width: int, height: int, horizontal_fov_deg: float) -> Undistortion:
        """For a lens and a field of view of the pinhole camera, degrees."""
        rays = pixel_rays(width, height, horizontal_fov_deg)
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        column, row = seen_at(lens, x, y)
        folded = x**2 + y**2 >= turning_point(lens)
        left, top = np.floor(column), np.floor(row)
        places, weights = [], []
        for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
            at_column, at_row = left + right, top + below
            weight = (1 - np.abs(column - at_column)) * (1 - np.abs(row - at_row))
            outside = (at_column < 0) | (at_column >= width) | (at_row < 0) | (at_row >= height)
            at_column, at_row = np.clip(at_column, 0, width - 1), np.clip(at_row, 0, height - 1)
            places.append((at_row * width + at_column).astype(np.intp))
            weights.append(np.where(outside | folded, 0.0, weight))
        return cls(tuple(places), tuple(weights))

    def good(self, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(H, W) pixels that are made of good ones in the image alone."""
        known = good.reshape(-1).astype(np.float64)
        sure = sum(weight * known[place] for place, weight in self._corners())
        return np.asarray(sure >= _WHOLE)

    def resampled(self, image: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Phasors (H, W, F) of the pinhole camera."""
        flat = image.reshape(-1, image.shape[-1])
        return np.asarray(sum(weight[..., None] * flat[place] for place, weight in self._corners()))

    def _corners(self) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        return zip(self.places, self.weights, strict=True)
