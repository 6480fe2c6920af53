"""The one file that knows Blender: plain scene data in, evaluated meshes and Mitsuba files out.

Import it late: `bpy` takes seconds to load, and only ``night-gen`` needs it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import radians
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from scenegen.chatter import silenced
from scenegen.mitsuba_xml import EMITTER_IMAGE, MeshFile, emitter_pfm, scene_xml
from scenegen.preset import Shape, Vector
from scenegen.scene import Scene, Wall, scene_to_json

STDOUT = 1  # Blender prints there from C

# Blender writes settings into the home folder unless told otherwise, and reads this at import.
_SETTINGS = tempfile.TemporaryDirectory(prefix="night-blender-")
os.environ.setdefault("BLENDER_USER_RESOURCES", _SETTINGS.name)
with silenced(STDOUT):
    import bpy
with silenced(STDOUT):  # these exist only once bpy is loaded
    import bmesh
    from mathutils import Matrix
    from mathutils import Vector as BlenderVector
    from mathutils.bvhtree import BVHTree

CLEARANCE_M = 1e-3  # objects keep this far from the relay wall, so that no ray starts inside it
_ARC_SEGMENTS = 64  # around every round primitive: a chord leaves a 0.28 m circle by 0.34 mm


class BlenderMaker:
    """Makes scenes in one Blender process that is reset once and swept after every scene."""

    def __init__(self) -> None:
        with silenced(STDOUT):
            bpy.ops.wm.read_factory_settings(use_empty=True)
        self._primitives = {shape: _primitive(shape) for shape in _BUILDERS}
        self._plane = _plane()

    @property
    def version(self) -> str:
        """Version of Blender, for the record."""
        return str(bpy.app.version_string)

    def refusal(self, scene: Scene) -> str | None:
        """Why a scene cannot be: a vertex through a wall, or one that the camera could see; else None.

        The region the middle wall hides from the camera is convex, so an object whose vertices lie inside
        it is hidden as a whole.
        """
        with self._built(scene) as objects:
            camera = objects["camera"].matrix_world.translation
            relay = objects["relay_wall"].matrix_world
            facing, point = relay.to_3x3() @ BlenderVector((0, 0, 1)), relay.translation
            middle = _world_mesh(objects["middle_wall"])
            blocker = BVHTree.FromPolygons([tuple(v.co) for v in middle.vertices], [[0, 1, 3, 2]])
            for name in _hidden_names(scene):
                for vertex in _world_mesh(objects[name]).vertices:
                    if (vertex.co - point).dot(facing) < CLEARANCE_M:
                        return f"{name} reaches through the relay wall"
                    ray = vertex.co - camera
                    if blocker.ray_cast(camera, ray.normalized(), ray.length)[0] is None:
                        return f"{name} shows beside the middle wall"
        return None

    def write(self, scene: Scene, folder: Path) -> None:
        """Write ``scene.json``, ``scene.xml``, ``mirrored.xml``, the meshes and the projector's image."""
        with self._built(scene) as objects:
            mirror = _reflection(objects["relay_wall"].matrix_world)
            walls = ["relay_wall", "middle_wall"]
            for name in (*walls, *_hidden_names(scene)):
                _write_ply(_world_mesh(objects[name]), folder / f"{name}.ply")
            for name in _hidden_names(scene):
                _write_ply(_world_mesh(objects[name], mirror), folder / f"mirrored_{name}.ply")
            poses = [np.array(objects[name].matrix_world) for name in ("camera", "emitter")]
        hidden = [MeshFile(f"{name}.ply", "hidden_object") for name in _hidden_names(scene)]
        mirrored = [MeshFile(f"mirrored_{mesh.name}", mesh.material) for mesh in hidden]
        relay, middle = (MeshFile(f"{name}.ply", name) for name in walls)
        (folder / "scene.xml").write_text(
            scene_xml(scene, poses[0], poses[1], [relay, middle, *hidden], scene.max_bounces)
        )
        (folder / "mirrored.xml").write_text(scene_xml(scene, poses[0], poses[1], [middle, *mirrored], 1))
        (folder / EMITTER_IMAGE).write_bytes(emitter_pfm(scene.camera))
        (folder / "scene.json").write_text(scene_to_json(scene))

    @contextmanager
    def _built(self, scene: Scene) -> Iterator[dict[str, bpy.types.Object]]:
        """The scene's objects, placed and evaluated; removed again at the end."""
        kept = set(bpy.data.meshes)
        objects = {
            "relay_wall": self._wall("relay_wall", scene.relay_wall),
            "middle_wall": self._wall("middle_wall", scene.middle_wall),
            "camera": _camera(scene),
            "emitter": _emitter(scene),
        }
        for name, part in zip(_hidden_names(scene), scene.hidden_objects, strict=True):
            hidden = _placed(name, self._primitives[part.shape], part.location_m, part.rotation_deg)
            hidden.scale = part.size_m
            objects[name] = hidden
        with silenced(STDOUT):
            bpy.context.view_layer.update()
        try:
            yield objects
        finally:
            data = [o.data for o in objects.values() if o.type in ("CAMERA", "LIGHT")]
            bpy.data.batch_remove([*objects.values(), *data, *(set(bpy.data.meshes) - kept)])

    def _wall(self, name: str, wall: Wall) -> bpy.types.Object:
        placed = _placed(name, self._plane, wall.location_m, wall.rotation_deg)
        placed.scale = (*wall.size_m, 1.0)
        return placed


def _hidden_names(scene: Scene) -> list[str]:
    return [f"hidden_object_{number}" for number in range(len(scene.hidden_objects))]


def _placed(name: str, data: bpy.types.ID, location_m: Vector, rotation_deg: Vector) -> bpy.types.Object:
    placed = bpy.data.objects.new(name, data)
    placed.location = location_m
    placed.rotation_mode = "XYZ"
    placed.rotation_euler = [radians(angle) for angle in rotation_deg]
    bpy.context.scene.collection.objects.link(placed)
    return placed


def _camera(scene: Scene) -> bpy.types.Object:
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.angle = radians(scene.camera.horizontal_fov_deg)
    return _placed("camera", data, scene.camera.location_m, scene.camera.rotation_deg)


def _emitter(scene: Scene) -> bpy.types.Object:
    data = bpy.data.lights.new("emitter", "SPOT")
    return _placed("emitter", data, scene.emitter.location_m, scene.emitter.rotation_deg)


def _world_mesh(placed: bpy.types.Object, mirror: Matrix | None = None) -> bpy.types.Mesh:
    """The object's evaluated mesh in world space, reflected by `mirror` with its faces kept outside out."""
    evaluated = placed.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = bpy.data.meshes.new_from_object(evaluated)
    mesh.transform(evaluated.matrix_world if mirror is None else mirror @ evaluated.matrix_world)
    if mirror is not None:
        mesh.flip_normals()  # a reflection turns the winding of every face round
    return mesh


def _reflection(relay_wall: Matrix) -> Matrix:
    """Reflection through the plane of the relay wall (x = 0 in the paper's scene)."""
    normal = (relay_wall.to_3x3() @ BlenderVector((0, 0, 1))).normalized()
    point = relay_wall.translation
    return Matrix.Translation(point) @ Matrix.Scale(-1, 4, normal) @ Matrix.Translation(-point)


def _write_ply(mesh: bpy.types.Mesh, path: Path) -> None:
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    solid = trimesh.Trimesh(
        vertices.reshape(-1, 3), _ordered(triangles.reshape(-1, 3)), process=False, validate=False
    )
    path.write_bytes(solid.export(file_type="ply", encoding="binary", vertex_normal=False))


def _ordered(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Triangles in one fixed order: smallest index first in each, then sorted."""
    first = triangles.argmin(axis=1)
    rolled = np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, axis=1)
    return rolled[np.lexsort(rolled.T[::-1])]


def _primitive(shape: Shape) -> bpy.types.Mesh:
    """A primitive that fills the unit box around the origin, with vertices in one fixed order.

    Blender's sphere comes with its vertices and faces in an order that differs from run to run.
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


def _plane() -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new("plane")
    corners = [(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, 0.5, 0.0), (0.5, 0.5, 0.0)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2)])
    return mesh


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
        segments=_ARC_SEGMENTS,
        radius1=0.5,
        radius2=top_radius,
        depth=1.0,
    )


def _build_sphere(working: bmesh.types.BMesh) -> None:
    half_turn = _ARC_SEGMENTS // 2
    bmesh.ops.create_uvsphere(working, u_segments=_ARC_SEGMENTS, v_segments=half_turn, radius=0.5)


def _build_concave_plane(working: bmesh.types.BMesh) -> None:
    """An open sheet bent to an arc of ±1 rad about z, hollow towards +x."""
    bmesh.ops.create_grid(working, x_segments=_ARC_SEGMENTS, y_segments=1, size=1.0)
    for vertex in working.verts:
        angle, height = float(vertex.co.x), float(vertex.co.y)
        sagitta = (1 - np.cos(angle)) / (1 - np.cos(1.0))
        chord = np.sin(angle) / np.sin(1.0)
        vertex.co = (sagitta - 0.5, 0.5 * chord, 0.5 * height)


_BUILDERS: dict[Shape, Callable[[bmesh.types.BMesh], None]] = {
    "cube": _build_cube,
    "cylinder": _build_cylinder,
    "sphere": _build_sphere,
    "cone": _build_cone,
    "concave_plane": _build_concave_plane,
    "parallelepiped": _build_cube,
}
