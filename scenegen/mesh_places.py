"""Whether the meshes of a scene are where its ``scene.json`` says, so that renders have the right label."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from scenegen.corner_geometry import Points, corners_of
from scenegen.mitsuba_description import hidden_names, mirrored_names, wall_names
from scenegen.pose import mirror_image
from scenegen.scene import HiddenObject, Scene
from scenegen.shapes import PRIMITIVES
from scenegen.triangles import scene_triangles
from scenegen.unit_meshes import UnitMesh, unit_mesh, unit_mesh_of_part

_TOLERANCE: Final = 0.01  # of the longest side: twice what finer meshes of round primitives change


def misplaced(scene: Scene, files: Mapping[str, bytes], folder: Path) -> str | None:
    """A sentence about the first mesh that is not where the scene says; None if all are.

    An object fills the box of its pose, and a primitive has its area and centroid; a mirror image is that of
    the object's mesh. Meshes that are missing are left to those who read them.

    Raises
    ------
    MeshError : a mesh is damaged.
    """
    for name, distance_m, size_m in _errors(scene, files, folder):
        if distance_m > _TOLERANCE * size_m:
            return (
                f"{folder / name} is up to {distance_m:.2g} m from what scene.json has, so that its label "
                "would be wrong: change both, or neither"
            )
    return None


def _errors(scene: Scene, files: Mapping[str, bytes], folder: Path) -> Iterator[tuple[str, float, float]]:
    """Name of each mesh, how far it is from where it should be, and its longest side; metres."""

    def vertices(name: str) -> Points:
        return scene_triangles(files[name], str(folder / name))[0].astype(np.float64)

    walls = (scene.relay_wall, scene.middle_wall, *scene.room)
    for wall, wall_name in zip(walls, wall_names(scene), strict=True):
        name = f"{wall_name}.ply"
        if name in files:
            yield name, _farthest_m(corners_of(wall), vertices(name)), max(wall.size_m)
    for object_name, part in zip(hidden_names(scene), scene.hidden_objects, strict=True):
        name = f"{object_name}.ply"
        if name in files:
            yield name, _box_error_m(part, files[name], str(folder / name)), max(part.size_m)
    for image, name in mirrored_names(scene).items():
        if {f"{image}.ply", f"{name}.ply"} <= files.keys():
            seen = vertices(f"{name}.ply")
            flipped = mirror_image(seen, scene.relay_wall)
            yield f"{image}.ply", _farthest_m(flipped, vertices(f"{image}.ply")), float(np.ptp(seen, 0).max())


def _box_error_m(part: HiddenObject, contents: bytes, origin: str) -> float:
    """How far the sides of a mesh are from those of its object's box, or its centroid is off, metres."""
    found = unit_mesh_of_part(part, contents, origin)
    low, high = found.vertices.min(axis=0).astype(np.float64), found.vertices.max(axis=0).astype(np.float64)
    size = np.array(part.size_m)
    if part.shape not in PRIMITIVES:  # whose longest side alone is known
        off = max(float(np.linalg.norm(low + high)) / 2, abs(float((high - low).max()) - 1))
        return off * float(size.max())
    off_m = np.linalg.norm(np.abs([(low + 0.5) * size, (high - 0.5) * size]).max(axis=0))
    area, centroid = _surface(found)
    known_area, known_centroid = _surface(unit_mesh(part.shape))
    grown = abs(np.sqrt(area / known_area) - 1)
    return float(max(off_m, np.linalg.norm((centroid - known_centroid) * size), grown * size.max()))


def _surface(mesh: UnitMesh) -> tuple[float, Points]:
    """Area and centroid (3,) of a surface."""
    corners = mesh.vertices[mesh.triangles].astype(np.float64)  # (T, 3, 3)
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    return areas.sum(), areas @ corners.mean(axis=1) / max(areas.sum(), 1e-300)


def _farthest_m(points: Points, others: Points) -> float:
    """Largest distance of a point of one set from the other set, both ways, metres."""
    from scipy.spatial import KDTree

    there, back = KDTree(others).query(points)[0], KDTree(points).query(others)[0]
    return float(max(there.max(), back.max()))
