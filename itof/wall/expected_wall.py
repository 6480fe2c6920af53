"""Where a flat relay wall should be, as the camera sees it: its direct return, and its plane."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any, Generic, TypeAlias

import numpy as np
from array_api_compat import array_namespace
from numpy.typing import ArrayLike, NDArray

from itof.arrays import A, B, Floats, Phasors, PhasorsOf, PixelsOf
from itof.direct import direct_phasors
from itof.frequency_images import LARGEST_LOG_STEP, FrequencyImages, Slopes, frequencies_first, slopes
from itof.light import phase_per_metre
from itof.pinhole import pixel_rays

_FARTHEST_M = 1e9  # whose square is far from overflow
_NEAREST = 2.0  # of the expected distance over the distance


@dataclass(frozen=True)
class ExpectedWall(Generic[A]):
    """Relay wall and camera as they should be, in camera axes (x right, y down, z forward).

    Its arrays are of numpy; `converted` makes them those of another library. For N cameras that differ in
    their field of view, `direct`, `rays` and `strength` begin with an axis of N (`stacked`).

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    direct : (H, W, F) complex direct return of the wall, in any unit; 0 where a ray misses the wall.
    rays : (H, W, 3) unit vectors through the pixel centres.
    plane_per_m : (3,) the plane m, 1/m: the wall's distance along a ray r is 1 / (m · r).
    strength : (H, W) square root of the weight of a pixel in fits of a wall in this plane, in any unit; None
        for the amplitude of `direct` at the first frequency.
    """

    frequencies_hz: tuple[float, ...]
    direct: PhasorsOf[A]
    rays: A
    plane_per_m: A
    strength: PixelsOf[A] | None = None

    @classmethod
    def of_camera(
        cls,
        direct: Phasors,
        frequencies_hz: Sequence[float],
        horizontal_fov_deg: float,
        camera_axes: ArrayLike,
        camera_location_m: ArrayLike,
        wall_point_m: ArrayLike,
        wall_normal: ArrayLike,
    ) -> NumpyWall:
        """The wall with the return `direct` (H, W, F); the other parameters as in `itof.direct_phasors`.

        Raises
        ------
        ValueError : the camera is in the plane of the wall.
        """
        plane_per_m = plane_of(camera_axes, camera_location_m, wall_point_m, wall_normal)
        height, width = direct.shape[:2]
        rays = pixel_rays(width, height, horizontal_fov_deg)
        return ExpectedWall(tuple(frequencies_hz), direct, rays, plane_per_m)

    @classmethod
    def of_plane(
        cls,
        plane_per_m: ArrayLike,
        width: int,
        height: int,
        frequencies_hz: Sequence[float],
        horizontal_fov_deg: float,
    ) -> NumpyWall:
        """The wall in the plane m (3,), 1/m in camera axes, with its computed return.

        Raises
        ------
        ValueError : the plane is not finite, or at infinity (m = 0).
        """
        plane = np.asarray(plane_per_m, dtype=np.float64)
        square = float(plane @ plane)
        if not (np.isfinite(square) and square > 0):
            raise ValueError(
                f"{plane.tolist()} is no plane: expected three finite numbers that are not all 0"
            )
        camera = (np.eye(3), np.zeros(3))
        size = (width, height, horizontal_fov_deg)
        direct = direct_phasors(*size, frequencies_hz, *camera, plane / square, plane)
        return ExpectedWall(tuple(frequencies_hz), direct, pixel_rays(*size), plane)

    @classmethod
    def stacked(cls, walls: Sequence[NumpyWall]) -> NumpyWall:
        """Walls of numpy arrays at the same frequencies and in the same plane, for one image each.

        Raises
        ------
        ValueError : there are none, or they differ in plane or frequencies.
        """
        first = walls[0] if walls else None
        if first is None:
            raise ValueError("there are no walls to stack")
        if any(
            each.frequencies_hz != first.frequencies_hz or (each.plane_per_m != first.plane_per_m).any()
            for each in walls
        ):
            raise ValueError("walls of other planes or frequencies cannot be stacked")
        direct, rays, strength = (
            np.stack([getattr(each, name) for each in walls]) for name in ("direct", "rays", "fit_strength")
        )
        return ExpectedWall(first.frequencies_hz, direct, rays, first.plane_per_m, strength)

    def converted(self, convert: Callable[[A], B]) -> ExpectedWall[B]:
        """The same with the arrays that `convert` makes of its arrays, for another library or device."""
        strength = None if self.strength is None else convert(self.strength)
        arrays = (convert(self.direct), convert(self.rays), convert(self.plane_per_m))
        return ExpectedWall(self.frequencies_hz, *arrays, strength)

    def captured(self, direct: PhasorsOf[A]) -> ExpectedWall[A]:
        """The wall with the return of a capture of the empty corner (H, W, F), in the same place.

        Its pixels keep their weights, which do not depend on the brightness of the capture.
        `itof.wall.empty_corner.captured_wall` moves the wall to where the capture shows it.
        """
        return replace(self, direct=direct, strength=self.fit_strength)

    @property
    def fit_strength(self) -> PixelsOf[A]:
        """(H, W) square root of the weight of a pixel in fits of a wall in this plane."""
        xp = array_namespace(self.direct)
        return xp.abs(self.direct[..., 0]) if self.strength is None else self.strength

    def at(self, places: Sequence[int]) -> ExpectedWall[A]:
        """The wall at some of the frequencies, given by their indices."""
        frequencies_hz = tuple(self.frequencies_hz[place] for place in places)
        return replace(self, frequencies_hz=frequencies_hz, direct=self.direct[..., list(places)])

    @cached_property
    def radial_depth_m(self) -> PixelsOf[A]:
        """(H, W) L_0, metres along the ray; infinite where a ray misses the wall."""
        xp = array_namespace(self.rays)
        return radial_depth_of_plane(xp.moveaxis(self.rays_by_axis, -3, -1), self.plane_per_m)

    @cached_property
    def rays_by_axis(self) -> A:
        """(3, H, W) `rays`, contiguous, which makes arithmetic on them faster."""
        return frequencies_first(array_namespace(self.rays), self.rays)

    @cached_property
    def images(self) -> FrequencyImages[A]:
        """`direct`, each frequency as an image of its own."""
        return FrequencyImages.of(self.direct)

    @cached_property
    def meets(self) -> PixelsOf[A]:
        """(H, W) whether a ray meets the wall."""
        xp = array_namespace(self.rays)
        return xp.isfinite(self.radial_depth_m)

    @cached_property
    def slopes(self) -> tuple[Slopes[A], Slopes[A]]:
        """Gradients per pixel of log amplitude, at the first frequency, and of L_0; arrays (1, H, W)."""
        first = self.images.first
        xp, depth_m = first.xp, self.radial_depth_m[..., None, :, :]
        depth_m = xp.astype(xp.clip(depth_m, max=3 * _FARTHEST_M), first.real.dtype)
        return slopes(xp, first.log_amplitude, LARGEST_LOG_STEP), slopes(xp, depth_m, _FARTHEST_M)

    @cached_property
    def slope(self) -> Floats:
        """(F,) k_f, phase per metre of depth, rad/m."""
        return 2 * phase_per_metre(self.frequencies_hz)  # out and back


NumpyWall: TypeAlias = ExpectedWall[NDArray[Any]]


def strength_elsewhere(expected_depth_m: A, depth_m: A) -> A:
    """Brightness of a diffuse wall along a ray over that of the expected wall: (L_0 / L)³, as cos / L² goes.

    Arrays of numpy or of another library of the array API, metres, finite. A wall at less than half of the
    expected distance counts as being there.
    """
    xp = array_namespace(depth_m)
    share = xp.clip(expected_depth_m / depth_m, max=_NEAREST)
    return share * share * share


def plane_of(
    camera_axes: ArrayLike, camera_location_m: ArrayLike, wall_point_m: ArrayLike, wall_normal: ArrayLike
) -> Floats:
    """(3,) the plane m of a wall, 1/m in camera axes; the parameters as in `itof.direct_phasors`.

    Raises
    ------
    ValueError : the camera is in the plane.
    """
    normal = np.asarray(wall_normal, dtype=np.float64)
    gap = (np.asarray(wall_point_m, dtype=np.float64) - np.asarray(camera_location_m)) @ normal
    if gap == 0:
        raise ValueError("the camera is in the plane of the wall")
    plane: Floats = np.asarray(camera_axes, dtype=np.float64) @ normal / gap  # m · r = 1 / L
    return plane


def radial_depth_of_plane(rays: A, plane_per_m: A) -> A:
    """Distance of planes (..., 3) along rays (n, 3) or (H, W, 3), metres; infinite where a ray misses one.

    Arrays of numpy or of another library of the array API. For several planes the result is (..., n), and the
    rays must be (n, 3), or (..., n, 3) with rays of its own for each plane.
    """
    xp = array_namespace(rays, plane_per_m)
    return depth_or_else(xp, inverse_depth_of_plane(rays, plane_per_m), xp.inf)[0]


def depth_or_else(xp: ModuleType, inverse_per_m: A, other_m: A | float) -> tuple[A, A]:
    """Distance of a plane, metres, or `other_m` where a ray misses it; and whether a ray meets it."""
    meets = inverse_per_m > 1 / _FARTHEST_M
    return xp.where(meets, 1 / xp.where(meets, inverse_per_m, 1.0), other_m), meets


def inverse_depth_of_plane(rays: A, plane_per_m: A) -> A:
    """m · r, as in `radial_depth_of_plane`, 1/m; elementwise, so with the same bits beside other planes."""
    x, y, z = (rays[..., axis] * plane_per_m[..., axis, None] for axis in range(3))
    return x + y + z


def distance_m(plane_per_m: Floats) -> float:
    """Distance of a plane (3,) from the camera, metres along its normal."""
    return float(1 / np.linalg.norm(plane_per_m))


def angle_deg(plane_per_m: Floats, other_per_m: Floats) -> float:
    """Angle between two planes (3,), degrees."""
    # by its tangent: the cosine of a small angle has no digits left
    sine = np.linalg.norm(np.cross(plane_per_m, other_per_m))
    return float(np.degrees(np.arctan2(sine, plane_per_m @ other_per_m)))
