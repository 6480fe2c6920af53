"""Where a fit may start: objects whose mirror image is most like the depth map of a network.

The hidden light of an object has many local minima over its rotations, so a fit needs a start within about 20
degrees. A network's depth map says where the object is to a few centimetres, and little of its far side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from itof import DepthMap
from model.refinement.light.corner_light import CornerLight, Mirror, euler_deg, vector, with_wall_at
from model.refinement.unknowns import moved
from scenegen.scene import HiddenObject, Scene
from scenegen.shapes import Shape

Floats = NDArray[np.float64]
_INWARDS_M = 0.12  # about, from the middle of a visible surface to that of its solid
_ALIGNMENTS = 2  # of the middles of both visible surfaces
_COLUMNS = 20  # of the depth maps that are compared


@dataclass(frozen=True)
class Sketch:
    """A depth map with few pixels: (P, 3) unit rays, (P,) radial depth, 0 beside the object.

    Attributes
    ----------
    corner : with the relay wall where the measurement shows it; `plane_per_m` is its plane.
    """

    light: CornerLight
    corner: Scene
    plane_per_m: Floats
    rays: Floats
    radial_depth_m: Floats

    @classmethod
    def of(
        cls, light: CornerLight, corner: Scene, plane_per_m: Floats, rays: Floats, shown: DepthMap
    ) -> Sketch:
        """A depth map (H, W) with rays (H, W, 3)."""
        step = max(1, rays.shape[1] // _COLUMNS)
        cut = (slice(step // 2, None, step), slice(step // 2, None, step))
        depth_m = np.where(shown.mask, shown.radial_depth_m, 0.0)[cut].ravel().astype(np.float64)
        corner = with_wall_at(corner, plane_per_m)
        return cls(light, corner, plane_per_m, rays[cut].reshape(-1, 3), depth_m)

    @property
    def is_empty(self) -> bool:
        """Whether no pixel shows an object."""
        return not self.radial_depth_m.any()

    def depths_m(self, candidates: Sequence[Scene]) -> Floats:
        """(N, P) mirror images of the objects of candidates in this corner."""
        wall = self.corner.relay_wall
        return self.light.mirrored_depth_m(
            [replace(candidate, relay_wall=wall) for candidate in candidates], self.rays
        )

    def differences_m(self, candidates: Sequence[Scene]) -> Floats:
        """(N,) mean absolute differences to the mirror images of candidates, over all pixels."""
        differences: Floats = np.abs(self.depths_m(candidates) - self.radial_depth_m).mean(axis=1)
        return differences

    def starts(
        self, shape: Shape, size_m: tuple[float, float, float], count: int, rng: np.random.Generator
    ) -> list[Scene]:
        """Candidates in `count` even random rotations; their `differences_m` ascend."""
        inner = vector(self._inner_m())
        rotations = Rotation.random(count, random_state=rng).as_matrix()[: 1 if shape == "sphere" else count]
        found = [
            replace(
                self.corner, hidden_objects=(HiddenObject(shape, size_m, inner, euler_deg(rotation), 1.0),)
            )
            for rotation in rotations
        ]
        for _ in range(_ALIGNMENTS):
            found = self._aligned(found)
        if not found:
            return []
        return [found[place] for place in np.argsort(self.differences_m(found), kind="stable")]

    def _aligned(self, candidates: Sequence[Scene]) -> list[Scene]:
        """Candidates moved so that their visible surfaces have the right middle, if any pixel shows them."""
        if not candidates:
            return []
        middle = self._middle_m(self.radial_depth_m)
        found = []
        for candidate, depth_m in zip(candidates, self.depths_m(candidates), strict=True):
            if depth_m.any():
                by_m = middle - self._middle_m(depth_m)
                parts = tuple(moved(part, by_m) for part in candidate.hidden_objects)
                found.append(replace(candidate, hidden_objects=parts))
        return found

    def _inner_m(self) -> Floats:
        """(3,) a point somewhat behind the middle of the visible points, in world axes."""
        seen = self.radial_depth_m > 0
        inwards = self._mirror.away(self.rays[seen]).mean(axis=0)
        inner: Floats = self._middle_m(self.radial_depth_m) + _INWARDS_M * inwards / np.linalg.norm(inwards)
        return inner

    def _middle_m(self, depth_m: Floats) -> Floats:
        seen = depth_m > 0
        middle: Floats = self._mirror.points_m(depth_m[seen], self.rays[seen]).mean(axis=0)
        return middle

    @property
    def _mirror(self) -> Mirror:
        return Mirror(self.corner.camera, self.plane_per_m)
