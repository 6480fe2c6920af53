"""Rotations and directions in Blender's conventions, computed without Blender."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from disk.quantities import Vector
from scenegen.preset import CameraSettings
from scenegen.scene import Wall


def rotation_matrix(rotation_deg: Vector) -> NDArray[np.float64]:
    """(3, 3) matrix of XYZ Euler angles in degrees: first about x, then y, then z (world axes)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(rotation_deg)), np.cos(np.radians(rotation_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    matrix: NDArray[np.float64] = about_z @ about_y @ about_x
    return matrix


def camera_axes(camera: CameraSettings) -> NDArray[np.float64]:
    """(3, 3) unit vectors as rows: the camera's right, down and forward in world space."""
    right, up, backward = rotation_matrix(camera.rotation_deg).T  # a Blender camera looks along its own -z
    return np.stack([right, -up, -backward])


def wall_normal(wall: Wall) -> NDArray[np.float64]:
    """(3,) unit normal of a wall's front in world space: +z before the rotation."""
    normal: NDArray[np.float64] = rotation_matrix(wall.rotation_deg)[:, 2]
    return normal


def mirror_image(points: NDArray[np.float64], wall: Wall) -> NDArray[np.float64]:
    """Points (..., 3) of world space where a mirror in a wall's plane shows them."""
    normal = wall_normal(wall)
    image: NDArray[np.float64] = (
        points - 2 * ((points - np.array(wall.location_m)) @ normal)[..., None] * normal
    )
    return image


def wall_geometry(camera: CameraSettings, wall: Wall) -> dict[str, Any]:
    """Camera and plane of a wall in world axes, as the fields of `itof.wall.wall_view.WallView`."""
    right, down, forward = (_vector(axis) for axis in camera_axes(camera))
    return {
        "horizontal_fov_deg": camera.horizontal_fov_deg,
        "camera_axes": (right, down, forward),
        "camera_location_m": camera.location_m,
        "wall_point_m": wall.location_m,
        "wall_normal": _vector(wall_normal(wall)),
    }


def blender_matrix(location_m: Vector, rotation_deg: Vector) -> NDArray[np.float64]:
    """(4, 4) pose of an object without scale: the numbers of Blender's `matrix_world`, which are float32.

    Blender keeps locations and angles in radians as float32, multiplies sines and cosines in float64, and
    rounds the result to float32.

    Source: `eulO_to_mat3` in Blender's math_rotation_c.cc.
    """
    x, y, z = (float(np.float32(radians(angle))) for angle in rotation_deg)
    cc, cs, sc, ss = cos(x) * cos(z), cos(x) * sin(z), sin(x) * cos(z), sin(x) * sin(z)
    matrix = [
        [cos(y) * cos(z), sin(y) * sc - cs, sin(y) * cc + ss, location_m[0]],
        [cos(y) * sin(z), sin(y) * ss + cc, sin(y) * cs - sc, location_m[1]],
        [-sin(y), cos(y) * sin(x), cos(y) * cos(x), location_m[2]],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return np.array(matrix, np.float32).astype(np.float64)


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
