"""Where a fit may start: solids whose mirror image is most like the depth map of a network.

The hidden light of an object has many local minima over its rotations, so a fit needs a start within about 20
degrees. A network's depth map says where the object is to a few centimetres, and little of its far side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from disk.quantities import Extent
from itof import DepthMap
from model.refinement.light.corner_light import CornerLight, Mirror, euler_deg, vector
from scenegen.pose import rotation_matrix
from scenegen.scene import HiddenObject, Scene
from scenegen.shapes import Shape

Floats = NDArray[np.float64]
_INWARDS_M: Final = 0.12  # about, from the middle of a visible surface to that of its solid
_ALIGNMENTS: Final = 2  # of the middles of both visible surfaces
_COLUMNS: Final = 20  # of the depth maps that are compared
_LARGER: Final = 1.5  # what unknown extents are at first, times the given ones, at most; or less by as much


@dataclass(frozen=True)
class Draws:
    """N solids of one shape: (N, 3, 3) axes as columns, (N, 3) places and extents, metres."""

    shape: Shape
    axes: Floats
    centres_m: Floats
    sizes_m: Floats

    @classmethod
    def of(
        cls,
        shape: Shape,
        size_m: Extent,
        at_m: Floats,
        count: int,
        rng: np.random.Generator,
        *,
        fits_sizes: bool,
    ) -> Draws:
        """In even random rotations at one place (3,), and of other sizes if these are not known."""
        axes = Rotation.random(count, random_state=rng).as_matrix()
        factor = rng.uniform(-1, 1, count) if fits_sizes else np.zeros(count)
        sizes_m = _LARGER ** factor[:, None] * np.asarray(size_m)
        return cls(shape, axes, np.tile(at_m, (count, 1)), sizes_m)

    @classmethod
    def of_solid(cls, solid: HiddenObject) -> Draws:
        """One solid."""
        axes, numbers = rotation_matrix(solid.rotation_deg), (solid.location_m, solid.size_m)
        return cls(solid.shape, axes[None], *(np.array([each]) for each in numbers))

    def moved(self, by_m: Floats) -> Draws:
        """Each moved by a vector (N, 3)."""
        return replace(self, centres_m=self.centres_m + by_m)

    def solid(self, place: int) -> HiddenObject:
        """One of them."""
        centre_m, size_m = (vector(each[place]) for each in (self.centres_m, self.sizes_m))
        return HiddenObject(self.shape, size_m, centre_m, euler_deg(self.axes[place]), 1.0)


@dataclass(frozen=True)
class Sketch:
    """A depth map with few pixels: (P, 3) unit rays, (P,) radial depth, 0 beside the object.

    Attributes
    ----------
    corner : whose camera sees the relay wall where the measurement shows it; `plane_per_m` is its plane.
    """

    light: CornerLight
    corner: Scene
    plane_per_m: Floats
    rays: Floats
    radial_depth_m: Floats

    @classmethod
    def of(
        cls,
        light: CornerLight,
        corner: Scene,
        plane_per_m: Floats,
        rays: Floats,
        shown: DepthMap,
        columns: int = _COLUMNS,
    ) -> Sketch:
        """A depth map (H, W) with rays (H, W, 3), of which about so many columns are left."""
        step = max(1, rays.shape[1] // columns)
        cut = (slice(step // 2, None, step), slice(step // 2, None, step))
        depth_m = np.where(shown.mask, shown.radial_depth_m, 0.0)[cut].ravel().astype(np.float64)
        return cls(light, corner, plane_per_m, rays[cut].reshape(-1, 3), depth_m)

    @property
    def is_empty(self) -> bool:
        """Whether no pixel shows an object."""
        return not self.radial_depth_m.any()

    def depths_m(self, candidates: Sequence[Scene]) -> Floats:
        """(N, P) mirror images of the objects of candidates in this corner."""
        wall, camera = self.corner.relay_wall, self.corner.camera
        return self.light.mirrored_depth_m(
            [replace(candidate, relay_wall=wall, camera=camera) for candidate in candidates], self.rays
        )

    def differences_m(self, candidates: Sequence[Scene]) -> Floats:
        """(N,) mean absolute differences to the mirror images of candidates, over all pixels."""
        return self._differences_m(self.depths_m(candidates))

    def starts(
        self,
        shape: Shape,
        size_m: Extent,
        counts: tuple[int, int],
        rng: np.random.Generator,
        *,
        fits_sizes: bool = False,
    ) -> list[Scene]:
        """Of so many solids in random rotations, those most like the depth map, the best first.

        Parameters
        ----------
        counts : how many are drawn, and how many are returned at most.
        fits_sizes : whether the solids are larger or smaller at random.
        """
        drawn = 1 if shape == "sphere" and not fits_sizes else counts[0]
        draws = Draws.of(shape, size_m, self.inner_m, drawn, rng, fits_sizes=fits_sizes)
        depths_m = self.depths_of_m(draws)
        for _ in range(_ALIGNMENTS):
            by_m = self._middles_m(self.radial_depth_m[None]) - self._middles_m(depths_m)
            draws = draws.moved(np.nan_to_num(by_m))
            depths_m = self.depths_of_m(draws)
        order = np.argsort(self._differences_m(depths_m), kind="stable")
        order = order[depths_m[order].any(axis=1)][: counts[1]]
        return [replace(self.corner, hidden_objects=(draws.solid(place),)) for place in order.tolist()]

    def depths_of_m(self, draws: Draws) -> Floats:
        """(N, P) mirror images of solids."""
        arrays = (draws.axes, draws.centres_m, draws.sizes_m)
        return self.light.depths_of_solids_m(self.corner, draws.shape, *arrays, self.rays)

    def _differences_m(self, depths_m: Floats) -> Floats:
        differences: Floats = np.abs(depths_m - self.radial_depth_m).mean(axis=1)
        return differences

    @cached_property
    def inner_m(self) -> Floats:
        """(3,) a point somewhat behind the middle of the visible points, in world axes."""
        inwards = self._mirror.away(self.rays[self.radial_depth_m > 0]).mean(axis=0)
        middle_m = self._middles_m(self.radial_depth_m[None])[0]
        inner: Floats = middle_m + _INWARDS_M * inwards / np.linalg.norm(inwards)
        return inner

    def _middles_m(self, depths_m: Floats) -> Floats:
        """(N, 3) middles of the points of depth maps (N, P), in world axes; NaN where there are none."""
        start, along = self._lines
        with np.errstate(invalid="ignore"):
            middles: Floats = start + depths_m @ along / np.count_nonzero(depths_m, axis=1)[:, None]
        return middles

    @cached_property
    def _lines(self) -> tuple[Floats, Floats]:
        """(3,) where the reflected rays begin, and (P, 3) their directions, in world axes."""
        start = self._mirror.points_m(np.zeros(1), self.rays[:1])[0]
        return start, self._mirror.away(self.rays)

    @property
    def _mirror(self) -> Mirror:
        return Mirror(self.corner.camera, self.plane_per_m)
