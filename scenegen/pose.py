"""Rotations and directions in Blender's conventions, computed without Blender."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenegen.contract import Vector
from scenegen.scene import Camera, Wall


def rotation_matrix(rotation_deg: Vector) -> NDArray[np.float64]:
    """(3, 3) matrix of XYZ Euler angles in degrees: first about x, then y, then z (world axes)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(rotation_deg)), np.cos(np.radians(rotation_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    matrix: NDArray[np.float64] = about_z @ about_y @ about_x
    return matrix


def camera_axes(camera: Camera) -> NDArray[np.float64]:
    """(3, 3) unit vectors as rows: the camera's right, down and forward in world space."""
    right, up, backward = rotation_matrix(camera.rotation_deg).T  # a Blender camera looks along its own -z
    return np.stack([right, -up, -backward])


def wall_normal(wall: Wall) -> NDArray[np.float64]:
    """(3,) unit normal of a wall's front in world space: +z before the rotation."""
    normal: NDArray[np.float64] = rotation_matrix(wall.rotation_deg)[:, 2]
    return normal
