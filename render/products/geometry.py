"""Depth of a scene by ray tracing in numpy, a check of Mitsuba and of the mirrored meshes.

The mirror image is computed here, from the *unmirrored* meshes and the pose of the relay wall.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk.plain_file import read_plain
from itof import pixel_rays
from scenegen import Dataset, camera_axes
from scenegen.pose import mirror_image
from scenegen.scene_folder import MOST_FILE_BYTES
from scenegen.triangles import scene_triangles


def traced_depth_m(
    dataset: Dataset,
    scene_id: str,
    shape: tuple[int, ...],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> NDArray[np.float64]:
    """(N,) radial depth of the mirrored scene at pixel centres, metres, 0 without a hidden object.

    Parameters
    ----------
    shape : height and width of the image, pixels.
    rows, columns : (N,) pixels.
    """
    scene = dataset.scene(scene_id)
    height, width = shape
    rays = pixel_rays(width, height, scene.camera.horizontal_fov_deg)[rows, columns]
    directions = rays @ camera_axes(scene.camera)  # (N, 3)
    origin = np.array(scene.camera.location_m)
    folder = dataset.scene_folder(scene_id)
    nearest = np.full(len(rows), np.inf)
    for number in range(len(scene.hidden_objects)):
        corners = _triangles(folder / f"hidden_object_{number}.ply")
        image = mirror_image(corners, scene.relay_wall)
        nearest = np.minimum(nearest, _first_hits(origin, directions, image))
    walls = _triangles(folder / "middle_wall.ply")
    if scene.mirror_occluders:
        walls = np.concatenate([walls, mirror_image(walls, scene.relay_wall)])
    blocked = _first_hits(origin, directions, walls) < nearest
    return np.where(np.isinf(nearest) | blocked, 0.0, nearest)


def _triangles(file: Path) -> NDArray[np.float64]:
    """(M, 3, 3) corners of a mesh file's triangles."""
    vertices, triangles = scene_triangles(read_plain(file, MOST_FILE_BYTES), str(file))
    return vertices[triangles].astype(np.float64)


def _first_hits(
    origin: NDArray[np.float64], directions: NDArray[np.float64], triangles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N,) distance along each ray to the nearest triangle, infinity if it meets none.

    Source: Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    first, edge_a, edge_b = triangles[:, 0], *(triangles[:, i] - triangles[:, 0] for i in (1, 2))
    to_origin = origin - first  # (M, 3)
    across = np.cross(to_origin, edge_a)  # (M, 3)
    nearest = np.full(len(directions), np.inf)
    for index, direction in enumerate(directions):
        side = np.cross(direction, edge_b)
        determinant = np.einsum("mk,mk->m", side, edge_a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("mk,mk->m", side, to_origin) / determinant
            v = across @ direction / determinant
            t = np.einsum("mk,mk->m", across, edge_b) / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        nearest[index] = t[hit].min(initial=np.inf)
    return nearest
