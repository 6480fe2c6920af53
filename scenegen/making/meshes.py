"""The user's mesh files: read, checked, scaled to a common size, with vertices in a fixed order."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from disk.inner_paths import inside
from disk.plain_file import read_plain
from disk.preset_files import PresetError
from scenegen.making.mesh_units import default_unit, default_up, doubts, mesh_size_m
from scenegen.object_settings import RotationRanges
from scenegen.object_tables import ListedObject, Thing, UpAxis
from scenegen.preset import Preset
from scenegen.shapes import MESH_PREFIX, Shape
from scenegen.triangles import MeshError, read_triangles
from scenegen.unit_meshes import UnitMesh

FORMATS = ("ply", "stl", "obj", "off", "glb")  # trimesh also reads archives, which unpack to any size
MAX_FILE_BYTES = 2**30  # two million triangles as text take about half of it
_EXTENT_RANGE = (1e-30, 1e30)  # float64 holds the squares and products of such lengths
AnyThing = TypeVar("AnyThing", bound=Thing)
_log = logging.getLogger(__name__)
_FLOAT32_STEP = float(np.finfo(np.float32).eps)  # accuracy of coordinates in the unit box


@dataclass(frozen=True, eq=False)
class UserMesh(UnitMesh):
    """Triangles of a mesh file, centred and scaled.

    Attributes
    ----------
    vertices : (V, 3) float32. The bounding box has its centre at the origin and its longest side is 1. No
        position occurs twice; the order is ascending in x, then y, then z.
    triangles : (T, 3) int32 indices, with the winding and in the order of the file. Each has an area, and no
        set of three vertices occurs twice.
    outermost : (N,) int64 indices of the vertices of the convex hull; for a flat mesh, of all vertices.
    sha256 : hash of the file's bytes.
    sides : of the bounding box along x, y and z, in the unit of the file.
    """

    sha256: str
    sides: tuple[float, float, float] = (1.0, 1.0, 1.0)


def with_meshes(preset: Preset, folder: Path) -> tuple[Preset, dict[Shape, UserMesh]]:
    """Read the meshes that a preset names, by shape; `folder` is the preset's folder.

    The preset comes back with the sizes of meshes that have a unit. What looks wrong of a mesh is logged.

    Raises
    ------
    MeshError : a file that `read_mesh` refuses; the message names it.
    OutsideError : a file is not inside `folder`.
    PresetError : a mesh is too large or too small in its unit.
    """
    ups = {thing.name: thing.up for each in preset.object for thing in each.things}
    shapes = [shape for shape in preset.shapes if shape.startswith(MESH_PREFIX)]
    files = {shape: inside(folder, shape.removeprefix(MESH_PREFIX)) for shape in shapes}
    meshes = {
        shape: read_mesh(file, (ups[shape] or default_up(file.name)) if ups else "z")
        for shape, file in files.items()
    }
    try:
        turns = preset.hidden_object.rotation_deg
        listed = tuple(_measured(each, meshes, turns) for each in preset.object)
        return replace(preset, object=listed), meshes
    except ValueError as error:
        raise PresetError(f"a mesh of [[object]] in its unit: {' '.join(str(error).split())}") from None


def _measured(listed: ListedObject, meshes: Mapping[Shape, UserMesh], turns: RotationRanges) -> ListedObject:
    """The object, and those beside it, with the sizes and axes of their meshes."""
    beside = tuple(_sized(each, meshes[each.name], turns) if each.file else each for each in listed.beside)
    own = _sized(listed, meshes[listed.name], turns) if listed.file else listed
    return replace(own, beside=beside)


def _sized(thing: AnyThing, mesh: UserMesh, turns: RotationRanges) -> AnyThing:
    unit = thing.unit or default_unit(str(thing.file)) if thing.size_m is None else None
    for doubt in doubts(thing, unit, mesh.sides, thing.rotation_deg or turns):
        _log.warning("warning: %s", doubt)
    size_m = mesh_size_m(unit, mesh.sides) if unit else thing.size_m
    return replace(thing, unit=None, size_m=size_m, up=thing.up or default_up(str(thing.file)))


def read_mesh(file: Path, up: UpAxis = "z") -> UserMesh:
    """Read a mesh file, PLY, STL, OBJ, OFF or GLB, whose axis `up` becomes z.

    All objects of the file become one mesh. Polygons become triangles that meet in their first corner, which
    is right for convex ones only. Vertices at the same position are merged. Triangles without area are
    removed. Of triangles with the same vertices only the first is kept, whichever way it faces: a hidden
    object reflects on both sides, so a surface that is modelled with two sides would count twice. The result
    depends only on the bytes of the file.

    Raises
    ------
    MeshError : the file is missing, is not a mesh, has no surface, has coordinates that are not finite, or
        has more than two million triangles.
    """
    contents = _contents(file)
    kind = file.suffix.lower().removeprefix(".")
    if not contents:
        raise MeshError(f"mesh {file} is empty")
    if kind not in FORMATS:
        raise MeshError(f"mesh {file} is in no known format: convert it to .ply, .stl, .obj, .off or .glb")
    vertices, triangles = read_triangles(contents, kind, str(file))
    if up == "y":
        vertices = vertices[:, [0, 2, 1]] * [1, -1, 1]
    unit, kept, sides = _in_unit_box(file, vertices, triangles)
    return UserMesh(unit, kept, _outermost(unit), hashlib.sha256(contents).hexdigest(), sides)


def _contents(file: Path) -> bytes:
    try:
        return read_plain(file, MAX_FILE_BYTES)
    except FileNotFoundError:
        raise MeshError(
            f"mesh {file} is missing: a file is named relative to the preset's folder, which --preset gives"
        ) from None
    except OSError as error:
        raise MeshError(f"mesh {file} cannot be read: {error.strerror}") from None


def _in_unit_box(
    file: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.int32], tuple[float, float, float]]:
    """Vertices, triangles and sides as in `UserMesh`. Triangles without area do not count for the box."""
    while len(triangles):
        used = vertices[np.unique(triangles)]
        low, high = used.min(axis=0), used.max(axis=0)
        extent = float(np.max(high / 2 - low / 2)) * 2  # halved first: the difference may overflow
        if not _EXTENT_RANGE[0] <= extent <= _EXTENT_RANGE[1]:
            raise MeshError(f"mesh {file} is {extent:g} units across and cannot be scaled")
        centred = (vertices - (low / 2 + high / 2)) / extent
        unit, merged = _merged(
            centred[np.unique(triangles)], np.searchsorted(np.unique(triangles), triangles)
        )
        kept = _has_area(unit, merged)
        if kept.all():
            x, y, z = (high - low).tolist()
            return unit, merged[_first_of_each(merged)].astype(np.int32), (x, y, z)
        triangles = triangles[kept]
    raise MeshError(f"mesh {file} has no area: all its triangles are lines or points")


def _merged(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """One vertex for each float32 place, ascending in x, then y, then z; triangles of these vertices."""
    rounded = vertices.astype(np.float32) + np.float32(0)  # adding 0 makes -0 and 0 the same
    places, place_of = np.unique(rounded, axis=0, return_inverse=True)  # (U, 3), (V,)
    return places, place_of[triangles]


def _has_area(vertices: NDArray[np.float32], triangles: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(T,) whether a triangle's height over its longest side differs from 0 in float32."""
    corners = vertices[triangles].astype(np.float64)  # (T, 3, 3)
    sides = np.roll(corners, -1, axis=1) - corners  # (T, 3, 3)
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    has_area: NDArray[np.bool_] = twice_area > _FLOAT32_STEP * np.linalg.norm(sides, axis=2).max(axis=1)
    return has_area


def _first_of_each(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Ascending indices of the first triangle of each set of three vertices."""
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return np.sort(first)


def _outermost(vertices: NDArray[np.float32]) -> NDArray[np.int64]:
    try:
        return np.sort(ConvexHull(vertices.astype(np.float64)).vertices).astype(np.int64)
    except QhullError:  # flat
        return np.arange(len(vertices))
