"""The expected walls of scenes, where the scenes have different fields of view."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from itof.wall.expected_wall import ExpectedWall
from model.data.shards import Shards
from model.network.wall_view import WallView


@dataclass(frozen=True)
class SceneWalls:
    """Makes the expected walls of scenes from their fields of view.

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

    def of(self, rows: Sequence[int]) -> ExpectedWall:
        """The walls of rows, one each, with their direct return in complex64."""
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # numpy lets other threads work
            return ExpectedWall.stacked(list(pool.map(self._of_row, rows)))

    def _of_row(self, row: int) -> ExpectedWall:
        view = self.view.with_fov(self.fields_of_view_deg[row])
        direct = view.direct_phasors(self.width, self.height, self.frequencies_hz)
        return view.expected_wall(direct.astype(np.complex64), self.frequencies_hz)
