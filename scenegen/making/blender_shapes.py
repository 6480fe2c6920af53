"""Meshes in Blender: the primitives, the user's meshes, meshes in world space, and PLY files of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

from scenegen.making.blender_start import BlenderVector, Matrix, bmesh, bpy
from scenegen.making.meshes import UserMesh
from scenegen.shapes import Shape
from scenegen.unit_meshes import ARC_SEGMENTS, concave_arc

SQUARE_CORNERS = ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5))  # of `unit_square`, in its order


def primitive(shape: Shape) -> bpy.types.Mesh:
    """A primitive that fills the unit box around the origin, with vertices and faces in a fixed order.

    The order matters because Blender's sphere has another order of vertices and faces in each run.
    """
    working = bmesh.new()
    _BUILDERS[shape](working)
    bmesh.ops.remove_doubles(working, verts=working.verts, dist=1e-6)
    vertices = np.array([vertex.co for vertex in working.verts])
    order = np.lexsort(np.round(vertices, 5).T)
    rank = np.argsort(order)
    working.verts.index_update()
    faces = [[int(rank[vertex.index]) for vertex in face.verts] for face in working.faces]
    working.free()
    mesh = bpy.data.meshes.new(shape)
    # A face starts at its smallest vertex, so that Blender cuts the same quad along the same diagonal.
    faces = sorted(face[face.index(min(face)) :] + face[: face.index(min(face))] for face in faces)
    mesh.from_pydata(vertices[order].tolist(), [], faces)
    return mesh


def user_mesh(mesh: UserMesh) -> bpy.types.Mesh:
    """Blender's mesh of a mesh file; its longest side is 1."""
    made = bpy.data.meshes.new("mesh")
    made.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    return made


def unit_square() -> bpy.types.Mesh:
    """A square of side 1 around the origin that faces +z: the mesh of both walls."""
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(x, y, 0.0) for x, y in SQUARE_CORNERS], [], [(0, 1, 3, 2)])
    return mesh


def world_mesh(placed: bpy.types.Object, mirror: Matrix | None = None) -> bpy.types.Mesh:
    """A new mesh of the evaluated object in world space, metres.

    With the reflection `mirror`, the mesh is reflected and its faces still point outwards.
    """
    evaluated = placed.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = bpy.data.meshes.new_from_object(evaluated)
    mesh.transform(evaluated.matrix_world if mirror is None else mirror @ evaluated.matrix_world)
    if mirror is not None:
        mesh.flip_normals()  # a reflection reverses the winding of every face
    return mesh


def reflection(relay_wall: Matrix) -> Matrix:
    """Reflection through the plane of the relay wall (x = 0 in the paper's scene), from the wall's pose."""
    normal = (relay_wall.to_3x3() @ BlenderVector((0, 0, 1))).normalized()
    point = relay_wall.translation
    return Matrix.Translation(point) @ Matrix.Scale(-1, 4, normal) @ Matrix.Translation(-point)


def ply_bytes(mesh: bpy.types.Mesh, texture: NDArray[np.float32] | None = None) -> bytes:
    """Contents of a binary PLY file of the triangulated mesh, float32, without normals.

    Parameters
    ----------
    texture : (V, 2) texture coordinates of the vertices, if they have any.
    """
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    solid = trimesh.Trimesh(
        vertices.reshape(-1, 3), _ordered(triangles.reshape(-1, 3)), process=False, validate=False
    )
    if texture is not None:
        solid.vertex_attributes |= {"u": texture[:, 0], "v": texture[:, 1]}
    contents: bytes = solid.export(file_type="ply", encoding="binary", vertex_normal=False)
    return contents


def _ordered(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """(T, 3) triangles in a fixed order: each starts at its smallest index, then all are sorted."""
    first = triangles.argmin(axis=1)
    rolled = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    return rolled[np.lexsort(rolled.T[::-1])]


def _build_cube(working: bmesh.types.BMesh) -> None:
    bmesh.ops.create_cube(working, size=1.0)


def _build_cylinder(working: bmesh.types.BMesh) -> None:
    _build_frustum(working, top_radius=0.5)


def _build_cone(working: bmesh.types.BMesh) -> None:
    _build_frustum(working, top_radius=0.0)


def _build_frustum(working: bmesh.types.BMesh, top_radius: float) -> None:
    bmesh.ops.create_cone(
        working,
        cap_ends=True,
        cap_tris=True,
        segments=ARC_SEGMENTS,
        radius1=0.5,
        radius2=top_radius,
        depth=1.0,
    )


def _build_sphere(working: bmesh.types.BMesh) -> None:
    half_turn = ARC_SEGMENTS // 2
    bmesh.ops.create_uvsphere(working, u_segments=ARC_SEGMENTS, v_segments=half_turn, radius=0.5)


def _build_concave_plane(working: bmesh.types.BMesh) -> None:
    """An open sheet bent to an arc of ±1 rad about z, concave on its +x side."""
    bmesh.ops.create_grid(working, x_segments=ARC_SEGMENTS, y_segments=1, size=1.0)
    for vertex in working.verts:
        angle, height = float(vertex.co.x), float(vertex.co.y)
        vertex.co = (*concave_arc(angle), 0.5 * height)


_BUILDERS: dict[Shape, Callable[[bmesh.types.BMesh], None]] = {
    "cube": _build_cube,
    "cylinder": _build_cylinder,
    "sphere": _build_sphere,
    "cone": _build_cone,
    "concave_plane": _build_concave_plane,
    "parallelepiped": _build_cube,
}
