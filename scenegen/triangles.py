"""The triangles of a mesh file, read without running anything that the file names, and checked."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from disk.night_error import NightError
from disk.plain_file import MOST_BYTES

MAX_TRIANGLES = 2_000_000  # a PLY file of 26 MB; Blender needs seconds for it
_MOST_CORNERS = 3 * MAX_TRIANGLES
_MOST_NUMBERS = 64 * MAX_TRIANGLES  # places, normals, colours, ... of all corners, and their indices
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FARTHEST_M = 1e6  # of a vertex of a scene: positions are within 1000 m of the origin


class MeshError(NightError):
    """A mesh file that is missing, cannot be read, or contains no surface."""


def read_triangles(contents: bytes, kind: str, origin: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (T, 3) of a mesh file, in the order of the file.

    Parameters
    ----------
    kind : format, a name of trimesh such as ``ply``.
    origin : name of the file, for the message of an error.

    Raises
    ------
    MeshError : the file is damaged, has no triangles, more than two million, triangles of vertices that it
        does not have, or coordinates that are not finite.
    """
    import trimesh

    # A comment of a PLY file may name a picture; pictures in a GLB file may take all memory.
    options = {"skip_materials": True} if kind in ("ply", "glb") else {}
    try:
        if kind == "glb":
            _refuse_claims(contents, origin)
        scene = trimesh.load_scene(io.BytesIO(contents), file_type=kind, process=False, **options)
        _refuse_many(_count(scene), origin)  # before they are made: nodes may repeat one mesh
        mesh = scene.to_mesh()
        vertices = np.asarray(mesh.vertices, np.float64).reshape(-1, 3)
        triangles = np.asarray(mesh.faces, np.int64).reshape(-1, 3)
    except (MemoryError, MeshError):
        raise
    except Exception as error:  # trimesh's parsers raise errors of any class on damaged files
        why = error if isinstance(error, ValueError) else "it is damaged, or of another format"
        raise MeshError(f"mesh {origin} cannot be read as {kind.upper()}: {why}") from None
    if len(triangles) == 0:
        raise MeshError(f"mesh {origin} has no triangles")
    _refuse_many(len(triangles), origin)
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise MeshError(f"mesh {origin} is damaged: its faces name vertices that it does not have")
    if not np.isfinite(vertices).all():
        raise MeshError(f"mesh {origin} has vertices that are infinite or not a number")
    return vertices, triangles


def _refuse_claims(contents: bytes, origin: str) -> None:
    """Refuse a GLB file whose header declares more than a mesh may have, which may be more than its bytes."""
    length = int.from_bytes(contents[12:16], "little")
    if length > MOST_BYTES:
        raise MeshError(f"mesh {origin} has a header of {length} bytes, more than {MOST_BYTES}: simplify it")
    tree = json.loads(contents[20 : 20 + length])
    arrays = tree.get("accessors", [])
    parts = [part for mesh in tree.get("meshes", []) for part in mesh["primitives"]]
    used = [{"indices": part.get("indices"), **part.get("attributes", {})} for part in parts]
    counts = [[abs(arrays[i]["count"]) for i in places.values() if i is not None] for places in used]
    corners = sum(max(each, default=0) for each in counts)
    numbers = sum(abs(array["count"]) * _COMPONENTS[array["type"]] for array in arrays)
    if corners > _MOST_CORNERS or numbers > _MOST_NUMBERS:
        raise MeshError(
            f"mesh {origin} declares {corners} corners and {numbers} numbers: simplify it to at most "
            f"{MAX_TRIANGLES} triangles"
        )


def _count(scene: Any) -> int:
    """Number of the triangles of all nodes."""
    names = (scene.graph[node][1] for node in scene.graph.nodes_geometry)
    return sum(len(getattr(scene.geometry[name], "faces", ())) for name in names)


def _refuse_many(count: int, origin: str) -> None:
    if count > MAX_TRIANGLES:
        raise MeshError(f"mesh {origin} has {count} triangles: simplify it to at most {MAX_TRIANGLES}")


def scene_triangles(contents: bytes, origin: str) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices (V, 3), metres, and triangles (T, 3) of the PLY file of a scene.

    Raises
    ------
    MeshError : as `read_triangles`, or a vertex is farther than 1000 km from the origin.
    """
    vertices, triangles = read_triangles(contents, "ply", origin)
    if np.abs(vertices).max() > _FARTHEST_M:
        raise MeshError(f"mesh {origin} has vertices farther than {_FARTHEST_M:g} m from the origin")
    return vertices.astype(np.float32), triangles.astype(np.uint32)


def scene_texture_coordinates(contents: bytes, origin: str) -> NDArray[np.float32]:
    """(V, 2) texture coordinates u and v of the vertices in the PLY file of a scene.

    Raises
    ------
    MeshError : the file is no mesh, or a vertex has no finite texture coordinates.
    """
    import trimesh

    vertices, _ = scene_triangles(contents, origin)
    mesh = trimesh.load_mesh(io.BytesIO(contents), file_type="ply", process=False, skip_materials=True)
    found = np.asarray(getattr(mesh.visual, "uv", None), np.float32)
    if found.shape != (len(vertices), 2) or not np.isfinite(found).all():
        raise MeshError(f"mesh {origin} has no texture coordinates, which the image of the wall needs")
    return found
