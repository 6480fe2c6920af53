"""Where a fit may start: solids whose mirror image is most like the depth map of a network.

The hidden light of a solid has many local minima over its rotations, so a fit needs a start within about 20
degrees. A network's depth map says where the object is to a few centimetres, and little of its far side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from itof import DepthMap
from model.refinement.light.room import Room
from model.refinement.light.solids import Solid

_INWARDS_M = 0.12  # about, from the middle of a visible surface to that of its solid
_ALIGNMENTS = 2  # of the middles of both visible surfaces
_COLUMNS = 20  # of the depth maps that are compared


@dataclass(frozen=True)
class Sketch:
    """A depth map with few pixels: (P, 3) unit rays, (P,) radial depth, 0 beside the object."""

    room: Room
    rays: NDArray[np.float64]
    radial_depth_m: NDArray[np.float64]

    @classmethod
    def of(cls, room: Room, rays: NDArray[np.float64], shown: DepthMap) -> Sketch:
        """A depth map (H, W) with rays (H, W, 3)."""
        step = max(1, rays.shape[1] // _COLUMNS)
        cut = (slice(step // 2, None, step), slice(step // 2, None, step))
        depth_m = np.where(shown.mask, shown.radial_depth_m, 0.0)[cut]
        return cls(room, rays[cut].reshape(-1, 3), depth_m.ravel().astype(np.float64))

    @property
    def is_empty(self) -> bool:
        """Whether no pixel shows an object."""
        return not self.radial_depth_m.any()

    def difference_m(self, solids: Sequence[Solid]) -> float:
        """Mean absolute difference to the mirror image of solids, over all pixels."""
        return float(np.abs(self.room.mirrored_depth_m(solids, self.rays) - self.radial_depth_m).mean())

    def aligned(self, solid: Solid) -> Solid | None:
        """A solid moved so that its visible surface has the right middle; None if no pixel shows it."""
        middle = self._middle_m(self.radial_depth_m)
        for _ in range(_ALIGNMENTS):
            depth_m = self.room.mirrored_depth_m([solid], self.rays)
            if not depth_m.any():
                return None
            solid = solid.moved(middle - self._middle_m(depth_m))
        return solid

    def inner_m(self) -> NDArray[np.float64]:
        """(3,) a point somewhat behind the middle of the visible points."""
        seen = self.radial_depth_m > 0
        towards = self.room.reflected(self.rays[seen]).mean(axis=0)
        inwards: NDArray[np.float64] = towards / np.linalg.norm(towards)
        return self._middle_m(self.radial_depth_m) + _INWARDS_M * inwards

    def _middle_m(self, depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        seen = depth_m > 0
        middle: NDArray[np.float64] = self.room.points_m(depth_m[seen], self.rays[seen]).mean(axis=0)
        return middle


def starts(
    sketch: Sketch, shape: str, size_m: tuple[float, float, float], count: int, rng: np.random.Generator
) -> list[Solid]:
    """Solids in `count` even random rotations, those first whose mirror image is most like the depth map."""
    rotations = Rotation.random(count, random_state=rng).as_matrix()
    drawn = [Solid(shape, size_m, sketch.inner_m(), axes) for axes in rotations]
    if not drawn[0].turns:
        drawn = drawn[:1]
    aligned = [found for solid in drawn if (found := sketch.aligned(solid)) is not None]
    return sorted(aligned, key=lambda solid: sketch.difference_m([solid]))
