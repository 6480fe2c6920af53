"""The expected wall of each scene, where the scenes have different fields of view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from itof.wall.expected_wall import ExpectedWall
from model.data.shards import Shards
from model.network.wall_view import WallView


@dataclass(frozen=True)
class SceneWalls:
    """Makes the expected wall of a scene from its field of view.

    Attributes
    ----------
    view : camera and wall of the dataset; its own field of view is not used.
    fields_of_view_deg : full horizontal field of view of each row of the shards, degrees.
    width, height : image size, pixels.
    frequencies_hz : F modulation frequencies, Hz.
    """

    view: WallView
    fields_of_view_deg: tuple[float, ...]
    width: int
    height: int
    frequencies_hz: tuple[float, ...]

    @classmethod
    def of_shards(cls, view: WallView, shards: Shards, frequencies_hz: Sequence[float]) -> SceneWalls | None:
        """For the rows of shards; None if all scenes have the field of view of the dataset."""
        manifest = shards.manifest
        if not manifest.fields_of_view_deg:
            return None
        size = manifest.width, manifest.height
        return cls(view, manifest.fields_of_view_deg, *size, tuple(frequencies_hz))

    def of(self, row: int) -> ExpectedWall:
        """The wall of a row, with its direct return in complex64."""
        size = self.width, self.height
        return _expected_wall(self.view.with_fov(self.fields_of_view_deg[row]), *size, self.frequencies_hz)


@lru_cache(maxsize=64)
def _expected_wall(
    view: WallView, width: int, height: int, frequencies_hz: tuple[float, ...]
) -> ExpectedWall:
    direct = view.direct_phasors(width, height, frequencies_hz)
    return view.expected_wall(direct.astype(np.complex64), frequencies_hz)
