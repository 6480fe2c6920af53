"""How bright a relay wall is from one side to the other, as the amplitude of its direct light shows it.

The light of the first bounce comes more from where the wall is bright. The amplitude at a place q of the wall
is s (ρ(q) D(q) + G(q)), with the reflectance ρ, which falls linearly, and what a white wall and its gloss
return, D and G. The scale s is that for which ρ at the brightest corner is the known one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.refinement.light.corner_light import CornerLight
from scenegen.pose import camera_axes, rotation_matrix
from scenegen.scene import Darkening, RelayWall, Scene

Floats = NDArray[np.float64]
_DARKEST: Final = 0.02  # reflectance of a corner of a wall
_ROUGHNESS: Final = tuple(round(0.05 * step, 2) for step in range(1, 21))
_ROUNDS: Final = 4  # of the scale, which the small gloss has in it


@dataclass(frozen=True)
class WallBrightness:
    """The darkening of a relay wall that an amplitude shows, by the roughness that the wall may have.

    Attributes
    ----------
    reflectance : of the brightest corner.
    falls : (R, 2) difference to that of the darkest one, along the direction of the fall.
    """

    reflectance: float
    falls: Floats

    @classmethod
    def of(cls, corner: Scene, rays: Floats, amplitude: Floats, light: CornerLight) -> WallBrightness:
        """Of the relay wall of a corner, by the amplitude (P,) along (P, 3) rays."""
        wall = corner.relay_wall
        rough = _ROUGHNESS if wall.roughness is not None else (None,)
        corners = [replace(corner, relay_wall=replace(wall, roughness=each)) for each in rough]
        found = walls_as_bright(corners, rays, amplitude, light)
        return cls(wall.reflectance, np.array([_fall(each) for each in found]))

    def darkening(self, roughness: float | None) -> Darkening | None:
        """That of a wall with a roughness."""
        x, y = self.falls.T
        if roughness is None:
            return _darkened(self.reflectance, float(x[0]), float(y[0]))
        fall = (float(np.interp(roughness, _ROUGHNESS, each)) for each in (x, y))
        return _darkened(self.reflectance, *fall)


def _fall(wall: RelayWall) -> tuple[float, float]:
    if wall.darkening is None:
        return 0.0, 0.0
    fallen, angle = (
        wall.reflectance - wall.darkening.least_reflectance,
        math.radians(wall.darkening.direction_deg),
    )
    return fallen * math.cos(angle), fallen * math.sin(angle)


def _darkened(reflectance: float, x: float, y: float) -> Darkening | None:
    fallen = math.hypot(x, y)
    if fallen == 0:
        return None
    return Darkening(reflectance - fallen, math.degrees(math.atan2(y, x)) % 360)


def walls_as_bright(
    corners: Sequence[Scene], rays: Floats, amplitude: Floats, light: CornerLight
) -> list[RelayWall]:
    """The relay wall of each corner, with the darkening that the amplitude (P,) along (P, 3) rays shows."""
    seen = np.isfinite(amplitude) & (amplitude > 0)
    rays, amplitude = rays[seen], amplitude[seen]
    even = [_with_reflectance(corner, share) for corner in corners for share in (1.0, 0.5)]
    white, grey = np.moveaxis(light.direct(even, rays).reshape(len(corners), 2, -1), 1, 0)
    return [
        replace(corner.relay_wall, darkening=_darkening(corner, rays, amplitude, 2 * (w - g), 2 * g - w))
        for corner, w, g in zip(corners, white, grey, strict=True)
    ]


def _with_reflectance(corner: Scene, share: float) -> Scene:
    wall = corner.relay_wall
    return replace(corner, relay_wall=replace(wall, reflectance=share * wall.reflectance, darkening=None))


def _darkening(
    corner: Scene, rays: Floats, amplitude: Floats, diffuse: Floats, gloss: Floats
) -> Darkening | None:
    """The fall of the reflectance; None if the wall is even, or its light cannot be told."""
    wall = corner.relay_wall
    q = _places(corner, rays)
    columns = np.column_stack([diffuse, q * diffuse[:, None]]) / amplitude[:, None]
    usable = np.isfinite(columns).all(1) & (diffuse > 0)
    if np.count_nonzero(usable) < 3:
        return None
    scale = fallen = 0.0
    for _ in range(_ROUNDS):
        left = 1 - scale * gloss[usable] / amplitude[usable]
        (middle, *slope), *_ = np.linalg.lstsq(columns[usable], left, rcond=None)
        fallen = float(np.abs(slope) @ wall.size_m)
        scale = middle + fallen / 2
    if not scale > 0 or fallen == 0:
        return None
    least = min(max(wall.reflectance * (1 - fallen / scale), _DARKEST), wall.reflectance)
    direction_deg = math.degrees(math.atan2(-slope[1], -slope[0])) % 360
    return Darkening(least, direction_deg)


def _places(corner: Scene, rays: Floats) -> Floats:
    """(P, 2) where rays (P, 3) meet the wall, from its centre along its own x and y, metres."""
    wall, camera = corner.relay_wall, corner.camera
    own = rotation_matrix(wall.rotation_deg)
    towards = rays @ camera_axes(camera)
    centre = np.asarray(wall.location_m) - camera.location_m
    reach = (centre @ own[:, 2]) / (towards @ own[:, 2])
    places: Floats = (reach[:, None] * towards - centre) @ own[:, :2]
    return places
