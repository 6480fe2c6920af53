"""The two walls of a loaded scene as rectangles, if the camera sees nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.transport.lights.hidden_surface import hidden_shapes
from render.walls.corners import Corners, Rectangles

if TYPE_CHECKING:
    import mitsuba as mi

_RELAY, _MIDDLE = "relay_wall", "middle_wall"
_ROUNDING = 1e-5  # of a side of a rectangle
_TURNED = np.diag([-1.0, -1.0, 1.0])  # Mitsuba's camera has x left and y up


def seen_walls(scene: mi.Scene) -> Corners | None:
    """The corner of a scene of two rectangular walls and hidden objects; None of any other scene."""
    import mitsuba as mi

    shapes = {shape.id(): shape for shape in scene.shapes()}
    if set(shapes) - {shape.id() for shape in hidden_shapes(scene)} != {_RELAY, _MIDDLE}:
        return None
    sensor = scene.sensors()[0]
    parameters = mi.traverse(sensor)
    if "x_fov" not in parameters:
        return None
    pose = np.array(sensor.world_transform().matrix, dtype=float)[:, :, 0]
    axes, origin = _TURNED @ pose[:3, :3].T, pose[:3, 3]
    found = [_rectangle(shapes[name], axes, origin) for name in (_RELAY, _MIDDLE)]
    relay, middle = found
    if relay is None or middle is None:
        return None
    width, height = sensor.film().size()
    half = np.tan(np.radians(np.array(parameters["x_fov"], dtype=float).reshape(1)) / 2)
    return Corners(axes[None], origin[None], half, np.array([width / height]), relay, middle)


def _rectangle(shape: mi.Shape, axes: NDArray[np.float64], origin: NDArray[np.float64]) -> Rectangles | None:
    """A mesh in the axes of a camera; None if it is no rectangle of two triangles."""
    import mitsuba as mi

    if not shape.is_mesh() or shape.vertex_count() != 4 or shape.face_count() != 2:
        return None
    parameters = mi.traverse(shape)
    if "vertex_positions" not in parameters:
        return None
    first, *others = (np.array(parameters["vertex_positions"], dtype=float).reshape(4, 3) - origin) @ axes.T
    one, two, across = sorted((other - first for other in others), key=np.linalg.norm)  # the diagonal last
    size = np.linalg.norm(across)
    if np.linalg.norm(one + two - across) > _ROUNDING * size or abs(one @ two) > _ROUNDING * size**2:
        return None
    return Rectangles(first[None], one[None], two[None])
