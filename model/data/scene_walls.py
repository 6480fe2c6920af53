"""The expected walls of scenes that have different fields of view."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import torch
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from model.data.shards import Shards

# Fields of view at which the direct return is computed, for the interpolation: as many of these as it needs
# for an error of 1e-9; complex64 rounds to 6e-8. Views that differ by 10 degrees need 16.
_NODES: Final = (16, 32)
_ERROR: Final = 1e-9
_MOST_BYTES: Final = 2**28  # of what is interpolated


@dataclass(frozen=True)
class SceneWalls:
    """Makes the expected walls of scenes from their fields of view.

    The direct return takes a tenth of a second at 80 x 60 pixels. It varies smoothly with the field of view,
    so it is computed for a few of them and interpolated between them by Chebyshev polynomials.

    Attributes
    ----------
    view : camera and wall of the dataset; its own field of view is not used.
    range_deg : smallest and largest horizontal field of view of the scenes, degrees.
    width, height : image size, pixels.
    frequencies_hz : F modulation frequencies, Hz.
    """

    view: WallView
    range_deg: tuple[float, float]
    width: int
    height: int
    frequencies_hz: tuple[float, ...]

    @classmethod
    def of_shards(cls, view: WallView, shards: Shards, frequencies_hz: Sequence[float]) -> SceneWalls | None:
        """For the rows of shards; None if all scenes have the field of view of the dataset."""
        manifest = shards.manifest
        views_deg = manifest.fields_of_view_deg
        if not views_deg:
            return None
        size = manifest.width, manifest.height
        return cls(view, (min(views_deg), max(views_deg)), *size, tuple(frequencies_hz))

    def of(self, views_deg: Sequence[float]) -> ExpectedWall:
        """The walls of scenes with these fields of view, with their direct return in complex64."""
        series = self._series  # once, before the threads
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # numpy lets other threads work
            return ExpectedWall.stacked(list(pool.map(lambda deg: self._of_view(deg, series), views_deg)))

    def _of_view(self, view_deg: float, series: NDArray[np.complex128] | None) -> ExpectedWall:
        view = self.view.with_fov(view_deg)
        if series is None:
            direct = self._direct(view.horizontal_fov_deg)
        else:
            direct = chebyshev.chebval(self._place(view.horizontal_fov_deg), series)
        return view.expected_wall(direct.astype(np.complex64), self.frequencies_hz)

    def _direct(self, fov_deg: float) -> NDArray[np.complex128]:
        return self.view.with_fov(fov_deg).direct_phasors(self.width, self.height, self.frequencies_hz)

    def _place(self, fov_deg: float) -> float:
        """A field of view as a number from -1 to 1."""
        low, high = self.range_deg
        return (2 * fov_deg - low - high) / (high - low)

    @cached_property
    def _series(self) -> NDArray[np.complex128] | None:
        """(K, H, W, F) Chebyshev coefficients of the direct return; None if it is computed for each scene.

        There is no series for a few scenes, for large images, and where it does not converge, such as where
        rays miss the wall.

        Source: Gauss-Chebyshev quadrature, which is exact for polynomials of degree below K.
        """
        low, high = self.range_deg
        for count in _NODES:
            size = 16 * count * self.width * self.height * len(self.frequencies_hz)
            if low == high or size > _MOST_BYTES:
                break
            nodes = chebyshev.chebpts1(count)
            values = np.stack([self._direct((low + high + (high - low) * node) / 2) for node in nodes])
            shares = chebyshev.chebvander(nodes, count - 1).T * (2 - (np.arange(count) == 0))[:, None] / count
            series = np.tensordot(shares, values, axes=1)
            if np.all(np.abs(series[-2:]).max(axis=0) <= _ERROR * np.abs(values).min(axis=0)):
                return series
        return None
