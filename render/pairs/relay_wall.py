"""The relay wall of a scene where captures of the empty corner show it."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from itof.wall.wall_view import WallView
from scenegen import wall_normal
from scenegen.scene import RelayWall


def relay_wall_at(plane_per_m: NDArray[np.float64], preset: RelayWall, view: WallView) -> RelayWall:
    """The preset's wall, moved and turned by the smallest angle to a plane.

    Parameters
    ----------
    plane_per_m : (3,) plane m in camera axes, 1/m: its points p have m · p = 1.
    view : of the camera and the preset's wall.
    """
    inverse_m = np.linalg.norm(plane_per_m)
    normal = -plane_per_m @ np.asarray(view.camera_axes) / inverse_m  # towards the camera
    before = np.asarray(wall_normal(preset))
    axis = np.cross(before, normal)
    sine = float(np.linalg.norm(axis))
    turn = Rotation.from_rotvec(axis / max(sine, 1e-300) * np.arctan2(sine, before @ normal))
    own = Rotation.from_euler("xyz", preset.rotation_deg, degrees=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of walls about 90 degrees, one of whose angles is free
        rotation_deg = (turn * own).as_euler("xyz", degrees=True).tolist()
    point = np.asarray(preset.location_m)
    beyond_m = (point - np.asarray(view.camera_location_m)) @ normal + 1 / inverse_m
    location_m = (point - beyond_m * normal).tolist()
    return replace(preset, location_m=tuple(location_m), rotation_deg=tuple(rotation_deg))
