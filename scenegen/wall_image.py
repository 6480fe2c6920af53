"""The image of a relay wall that gets darker towards one side, and where its mesh shows it.

The image has two pixels, the brightest and the darkest reflectance. Mitsuba interpolates linearly between
their centres, and the texture coordinates of the brightest and of the darkest corner are these centres.
"""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from scenegen.scene import RelayWall

WALL_IMAGE = "relay_wall.pfm"


def pfm(pixels: NDArray[np.floating]) -> bytes:
    """A portable float map of one channel from (H, W) pixels."""
    height, width = pixels.shape
    return f"Pf\n{width} {height}\n-1.0\n".encode() + pixels[::-1].astype("<f4").tobytes()


def wall_pfm(wall: RelayWall) -> bytes | None:
    """The image of a wall's reflectance; None where it is the same everywhere."""
    if wall.darkening is None:
        return None
    return pfm(np.array([[wall.reflectance, wall.darkening.least_reflectance]]))


def texture_coordinates(wall: RelayWall, corners: NDArray[np.floating]) -> NDArray[np.float32] | None:
    """(V, 2) texture coordinates; None where the reflectance is the same everywhere.

    Parameters
    ----------
    corners : (V, 2) places on the wall along its own x and y, in its extents: ±0.5 at its edges.
    """
    if wall.darkening is None:
        return None
    angle = radians(wall.darkening.direction_deg)
    step = np.array([cos(angle), sin(angle)]) * wall.size_m
    along = 0.5 + corners @ step / np.abs(step).sum()  # 0 at the brightest corner, 1 at the darkest
    return np.stack([0.25 + along / 2, np.full(len(along), 0.5)], axis=1).astype(np.float32)
