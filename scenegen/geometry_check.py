"""Whether a scene is possible: its objects stand free, and neither camera nor projector sees them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from disk.quantities import Vector
from scenegen.mitsuba_description import hidden_names
from scenegen.pose import blender_matrix
from scenegen.scene import Scene, Wall
from scenegen.shapes import MESH_PREFIX, Shape
from scenegen.unit_meshes import UnitMesh, unit_mesh

CLEARANCE_M = 1e-3  # objects keep this distance to the relay wall, so that no ray starts inside it


def refusal(scene: Scene, meshes: Mapping[Shape, UnitMesh] = MappingProxyType({})) -> str | None:
    """Why a scene is impossible, or None: an object reaches through a wall, or is not hidden.

    The region of possible points is convex. An object is therefore possible as a whole where its outermost
    vertices are. The sentence is about the first of them that is not.

    Parameters
    ----------
    meshes : the mesh files that the scene's shapes name, by shape; see `scenegen.making.meshes.with_meshes`.
    """
    eyes = dict.fromkeys([scene.camera.location_m, scene.emitter.location_m])
    walls = (scene.relay_wall, scene.middle_wall)
    around = [in_front_of(wall) for wall in scene.room]
    region = np.vstack([*(possible_region(*walls, eye) for eye in eyes), *around])  # (K, 4), K 6 to 15
    for name, part in zip(hidden_names(scene), scene.hidden_objects, strict=True):
        mesh = meshes[part.shape] if part.shape in meshes else unit_mesh(part.shape)
        local = region @ blender_matrix(part.location_m, part.rotation_deg)
        inwards = (local[:, :3] * part.size_m) @ mesh.hull.T + local[:, 3:]  # (K, N)
        outside = inwards <= 0
        if outside.any():
            first = outside[:, outside.any(axis=0).argmax()]  # (K,)
            solid = {0: "relay wall"} | {6 * len(eyes) + n: wall.name for n, wall in enumerate(scene.room)}
            through = [wall for row, wall in solid.items() if first[row]]
            what = f"reaches through the {through[0]}" if through else "shows beside the middle wall"
            return f"{part.shape.removeprefix(MESH_PREFIX)} ({name}) {what}"
    return None


def in_front_of(wall: Wall) -> list[float]:
    """Half-space (n, d) of the points x with n·x + d > 0: in front of a wall, at some distance."""
    pose = blender_matrix(wall.location_m, wall.rotation_deg)
    facing = pose[:3, 2]
    return [*facing, -facing @ pose[:3, 3] - CLEARANCE_M]


def possible_region(relay_wall: Wall, middle_wall: Wall, eye: Vector) -> NDArray[np.float64]:
    """(6, 4) half-spaces (n, d) of the points x with n·x + d > 0: in front of the relay wall, and hidden
    from an eye.

    In a frame with the middle wall's centre as origin and its normal as third axis, the eye is at
    (a, b, c), and the sight line to a point (x, y, z) meets the wall's plane at ((cx - az), (cy - bz)) /
    (c - z). Where c > 0, the point is hidden if z < 0 and this place is on the wall, of half size h:
    |cx - az| < h_x (c - z), |cy - bz| < h_y (c - z). Where c < 0, the signs of c, z and c - z change.
    """
    middle = blender_matrix(middle_wall.location_m, middle_wall.rotation_deg)
    free = in_front_of(relay_wall)
    frame = middle[:3, :3].T @ np.hstack([np.eye(3), -middle[:3, 3:]])  # (3, 4)
    camera = frame[:, :3] @ np.array(eye, np.float32) + frame[:, 3]  # (3,)
    side = np.sign(camera[2])
    depth = side * ([0.0, 0.0, 0.0, camera[2]] - frame[2])  # (4,) c - z
    across = side * (camera[2] * frame[:2] - np.outer(camera[:2], frame[2]))  # (2, 4)
    reach = np.outer(middle_wall.size_m, depth) / 2
    return np.vstack([free, -side * frame[2], reach - across, reach + across])
