"""Floor, ceiling and back wall: with relay wall and middle wall they make the room of a corner."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from disk.quantities import Vector
from scenegen.corner_geometry import corners_of, distances_m
from scenegen.pose import rotation_matrix
from scenegen.scene import RoomWallName, Wall

_DIGITS = 9  # of metres and degrees


@cache
def walls_around(relay: Wall, middle: Wall) -> dict[RoomWallName, Wall]:
    """Floor, ceiling and back wall of a room.

    Floor and ceiling begin at the lowest and the highest side of the relay wall, at right angles to it. They
    are as long as this side and end where the middle wall ends; the back wall faces the relay wall there.
    """
    axes = rotation_matrix(relay.rotation_deg)
    into = axes[:, 2]
    upright = int(np.abs(axes[2, :2]).argmax())  # which of the wall's own axes is the height
    up = axes[:, upright] * np.copysign(1, axes[2, upright])
    height_m, width_m = relay.size_m[upright], relay.size_m[1 - upright]
    depth_m = float(distances_m(relay, corners_of(middle)).max())
    centre = np.array(relay.location_m)
    half_way = centre + into * depth_m / 2
    floor, ceiling = (half_way + side * up * height_m / 2 for side in (-1, 1))
    return {
        "floor": _wall((depth_m, width_m), floor, into, up),
        "ceiling": _wall((depth_m, width_m), ceiling, into, -up),
        "back_wall": _wall((height_m, width_m), centre + into * depth_m, up, -into),
    }


def _wall(
    size_m: tuple[float, float], centre: NDArray[np.float64], x: NDArray[np.float64], z: NDArray[np.float64]
) -> Wall:
    """A wall with these own axes."""
    turn = Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of walls about 90 degrees, one of whose angles is free
        rotation_deg = turn.as_euler("xyz", degrees=True)
    width_m, height_m = (round(side, _DIGITS) for side in size_m)
    return Wall((width_m, height_m), _rounded(centre), _rounded(rotation_deg))


def _rounded(values: NDArray[np.float64]) -> Vector:
    x, y, z = (round(float(value), _DIGITS) + 0.0 for value in values)  # without a negative zero
    return (x, y, z)
