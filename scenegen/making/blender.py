"""The one file that knows Blender: plain scene data in, evaluated meshes and Mitsuba files out.

Import it late: `bpy` takes seconds to load, and only ``night-gen`` needs it.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from math import radians
from pathlib import Path
from types import MappingProxyType

import numpy as np
import trimesh
from numpy.typing import NDArray

from scenegen.chatter import silenced
from scenegen.making.meshes import UserMesh
from scenegen.making.mitsuba_xml import EMITTER_IMAGE, MeshFile, emitter_pfm, scene_xml
from scenegen.making.outlines import clipped, frustum_edges, frustum_sides, wall_corners
from scenegen.pose import camera_axes, rotation_matrix
from scenegen.preset import Shape, Vector
from scenegen.scene import Scene, Wall, scene_to_json

STDOUT, STDERR = 1, 2  # Blender prints there from C

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
    """Makes scenes in one Blender process that is reset once and swept after every scene.

    `meshes` are those that the scenes' shapes name, from `scenegen.making.meshes.read_meshes`.
    """

    def __init__(self, meshes: Mapping[Shape, UserMesh] = MappingProxyType({})) -> None:
        _empty_blender()
        self._shapes = {shape: _primitive(shape) for shape in _BUILDERS}
        self._shapes |= {shape: _user_mesh(mesh) for shape, mesh in meshes.items()}
        self._outermost = {shape: mesh.outermost.tolist() for shape, mesh in meshes.items()}
        self._plane = _plane()

    @property
    def version(self) -> str:
        """Version of Blender, for the record."""
        return str(bpy.app.version_string)

    def refusal(self, scene: Scene) -> str | None:
        """Why a scene cannot be: a vertex through a wall, or one that the camera could see; else None.

        The region the middle wall hides from the camera is convex, so an object whose vertices lie inside
        it is hidden as a whole; of a user's mesh those of its convex hull are enough.
        """
        with self._built(scene) as objects:
            camera = objects["camera"].matrix_world.translation
            relay = objects["relay_wall"].matrix_world
            facing, point = relay.to_3x3() @ BlenderVector((0, 0, 1)), relay.translation
            middle = _world_mesh(objects["middle_wall"])
            blocker = BVHTree.FromPolygons([tuple(v.co) for v in middle.vertices], [[0, 1, 3, 2]])
            for name, part in zip(_hidden_names(scene), scene.hidden_objects, strict=True):
                vertices = _world_mesh(objects[name]).vertices
                for index in self._outermost.get(part.shape, range(len(vertices))):
                    vertex = vertices[index]
                    if (vertex.co - point).dot(facing) < CLEARANCE_M:
                        return f"{name} reaches through the relay wall"
                    ray = vertex.co - camera
                    if blocker.ray_cast(camera, ray.normalized(), ray.length)[0] is None:
                        return f"{name} shows beside the middle wall"
        return None

    def files(self, scene: Scene) -> dict[str, bytes]:
        """``scene.json``, ``scene.xml``, ``mirrored.xml``, the meshes and the projector's image, by name."""
        made = {}
        with self._built(scene) as objects:
            mirror = _reflection(objects["relay_wall"].matrix_world)
            walls = ["relay_wall", "middle_wall"]
            for name in (*walls, *_hidden_names(scene)):
                made[f"{name}.ply"] = _ply(_world_mesh(objects[name]))
            for name in _hidden_names(scene):
                made[f"mirrored_{name}.ply"] = _ply(_world_mesh(objects[name], mirror))
            poses = [np.array(objects[name].matrix_world) for name in ("camera", "emitter")]
        hidden = [MeshFile(f"{name}.ply", "hidden_object") for name in _hidden_names(scene)]
        mirrored = [MeshFile(f"mirrored_{mesh.name}", mesh.material) for mesh in hidden]
        relay, middle = (MeshFile(f"{name}.ply", name) for name in walls)
        seen = scene_xml(scene, poses[0], poses[1], [relay, middle, *hidden], scene.max_bounces)
        truth = scene_xml(scene, poses[0], poses[1], [middle, *mirrored], 1)
        return made | {
            "scene.xml": seen.encode(),
            "mirrored.xml": truth.encode(),
            EMITTER_IMAGE: emitter_pfm(scene.camera),
            "scene.json": scene_to_json(scene).encode(),
        }

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
            hidden = _placed(name, self._shapes[part.shape], part.location_m, part.rotation_deg)
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

    def picture(self, scene: Scene, width: int, height: int) -> NDArray[np.uint8]:
        """The scene from outside and above, (H, W, 3) sRGB, from a viewpoint that no object moves.

        The relay wall is light grey, what camera and projector cover of it blue, as are their frustum and
        the small pyramid where they stand; the middle wall is glass, the hidden object orange. Nothing of
        the picture stays in Blender.
        """
        with self._built(scene) as objects, _passing_stage() as stage:
            lit = clipped(wall_corners(scene.relay_wall), frustum_sides(scene.camera))
            bodies = [
                (_world_mesh(objects["relay_wall"]), _RELAY_COLOUR, 1.0),
                (_world_mesh(objects["middle_wall"]), _MIDDLE_COLOUR, 0.2),
                *((_world_mesh(objects[n]), _OBJECT_COLOUR, 1.0) for n in _hidden_names(scene)),
                *_picture_extras(scene, lit),
            ]
            for mesh, colour, opacity in bodies:
                _show(stage, mesh, colour, opacity)
            _set_up_view(stage, scene, lit)
            return _rendered(stage, width, height)


@cache
def _empty_blender() -> None:
    """Empty Blender of what it starts with; once, since it would empty it of another maker's meshes too."""
    with silenced(STDOUT):
        bpy.ops.wm.read_factory_settings(use_empty=True)


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


def _ply(mesh: bpy.types.Mesh) -> bytes:
    """Contents of a binary PLY file."""
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    solid = trimesh.Trimesh(
        vertices.reshape(-1, 3), _ordered(triangles.reshape(-1, 3)), process=False, validate=False
    )
    contents: bytes = solid.export(file_type="ply", encoding="binary", vertex_normal=False)
    return contents


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


def _user_mesh(mesh: UserMesh) -> bpy.types.Mesh:
    made = bpy.data.meshes.new("mesh")
    made.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    return made


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


# Linear RGB. No other thing in a picture is orange.
_OBJECT_COLOUR = (0.9, 0.16, 0.01)
_RELAY_COLOUR = (0.7, 0.7, 0.7)
_MIDDLE_COLOUR = (0.02, 0.02, 0.03)
_FLOOR_COLOUR = (0.45, 0.45, 0.45)
_LIGHT_COLOUR = (0.08, 0.4, 0.9)
_CAMERA_COLOUR = (0.01, 0.04, 0.2)
_FOOT_M = 0.3  # of the middle wall is drawn opaque
_PICTURE_SAMPLES = 8  # paths a pixel, then denoised: 0.7 s for 288 x 216 on two cores


@contextmanager
def _passing_stage() -> Iterator[bpy.types.Scene]:
    """A Blender scene of its own; removed at the end with all else that appeared meanwhile."""
    kept = set(_everything())
    try:
        yield bpy.data.scenes.new("picture")
    finally:
        bpy.data.batch_remove([block for block in _everything() if block not in kept])


def _everything() -> Iterator[bpy.types.ID]:
    for name in ("scenes", "worlds", "objects", "cameras", "lights", "materials", "images", "meshes"):
        yield from getattr(bpy.data, name)


def _picture_extras(
    scene: Scene, lit: NDArray[np.float64]
) -> Iterator[tuple[bpy.types.Mesh, tuple[float, float, float], float]]:
    """What a picture shows beside walls and objects: mesh, colour and opacity of each."""
    camera, wall = np.array(scene.camera.location_m), scene.relay_wall
    yield _pyramid(camera, camera + 0.22 * frustum_edges(scene.camera), base=True), _CAMERA_COLOUR, 1.0
    if len(lit):
        yield _pyramid(camera, lit, base=False), _LIGHT_COLOUR, 0.1
        above = lit + 4e-3 * rotation_matrix(wall.rotation_deg)[:, 2]  # in front of the wall, not in it
        yield _mesh(above, [tuple(range(len(lit)))]), _LIGHT_COLOUR, 0.55
    middle = wall_corners(scene.middle_wall)
    upwards = np.array([0.0, 0.0, 1.0])
    foot = clipped(middle, [(middle.min(axis=0) + _FOOT_M * upwards, -upwards)])
    yield _mesh(foot, [tuple(range(len(foot)))]), _MIDDLE_COLOUR, 1.0
    corners = np.concatenate([wall_corners(wall), middle])
    low, high = corners.min(axis=0), corners.max(axis=0)
    floor = [
        (x, y, low[2] - 0.01) for x, y in ((low[0], low[1]), (high[0], low[1]), high[:2], (low[0], high[1]))
    ]
    yield _mesh(np.array(floor), [(0, 1, 2, 3)]), _FLOOR_COLOUR, 1.0


def _pyramid(apex: NDArray[np.float64], rim: NDArray[np.float64], *, base: bool) -> bpy.types.Mesh:
    count = len(rim)
    faces: list[tuple[int, ...]] = [(count, index, (index + 1) % count) for index in range(count)]
    return _mesh(np.vstack([rim, apex]), [*faces, *([tuple(range(count))] if base else [])])


def _mesh(vertices: NDArray[np.float64], faces: list[tuple[int, ...]]) -> bpy.types.Mesh:
    made = bpy.data.meshes.new("picture")
    made.from_pydata(vertices.tolist(), [], faces)
    return made


def _show(
    stage: bpy.types.Scene, mesh: bpy.types.Mesh, colour: tuple[float, float, float], opacity: float
) -> None:
    """Put a mesh that lies in world space on the stage."""
    material = bpy.data.materials.new("picture")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output, mix = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeMixShader")
    surface = nodes.new("ShaderNodeBsdfDiffuse")
    surface.inputs["Color"].default_value = (*colour, 1.0)
    mix.inputs["Fac"].default_value = opacity
    links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
    links.new(surface.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    mesh.materials.clear()
    mesh.materials.append(material)
    shown = bpy.data.objects.new("picture", mesh)
    shown.visible_shadow = opacity == 1.0
    stage.collection.objects.link(shown)


def _set_up_view(stage: bpy.types.Scene, scene: Scene, lit: NDArray[np.float64]) -> None:
    """Place viewer and light by walls and camera alone, so that all scenes of a dataset look alike.

    The viewer looks at the foot of the camera on the middle wall, along that wall towards the relay wall and
    a little from the object's side: camera and object then stand to both sides, and no wall before either.
    """
    camera = np.array(scene.camera.location_m)
    across = rotation_matrix(scene.middle_wall.rotation_deg)[:, 2]
    facing = rotation_matrix(scene.relay_wall.rotation_deg)[:, 2]
    target = camera - (camera - scene.middle_wall.location_m) @ across * across
    reach = max(np.linalg.norm(point - target) for point in (camera, *lit))
    up = -camera_axes(scene.camera)[1]
    beyond = -across * np.sign((camera - target) @ across)  # to the object's side of the middle wall
    away = facing + 0.7 * up + 0.42 * beyond
    data = bpy.data.cameras.new("picture")
    data.angle = radians(42)
    data.clip_start, data.clip_end = 0.01 * reach, 100 * reach
    viewer = bpy.data.objects.new("picture", data)
    viewer.location = target + reach * (0.12 * beyond + 2.3 * away / np.linalg.norm(away))
    viewer.rotation_euler = BlenderVector(-away).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("picture", bpy.data.lights.new("picture", "SUN"))
    sun.data.energy, sun.data.angle = 2.2, radians(4)
    shining = -(facing + 1.6 * up + 0.6 * beyond)
    sun.rotation_euler = BlenderVector(shining).to_track_quat("-Z", "Y").to_euler()
    for placed in (viewer, sun):
        stage.collection.objects.link(placed)
    stage.camera = viewer
    stage.world = bpy.data.worlds.new("picture")
    stage.world.use_nodes = True
    stage.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    stage.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.55


def _rendered(stage: bpy.types.Scene, width: int, height: int) -> NDArray[np.uint8]:
    """(H, W, 3) the stage as Cycles sees it; Blender's other engines need a display."""
    settings = stage.render
    settings.engine = "CYCLES"
    stage.cycles.device, stage.cycles.samples, stage.cycles.seed = "CPU", _PICTURE_SAMPLES, 0
    stage.cycles.use_denoising = True
    stage.cycles.max_bounces, stage.cycles.transparent_max_bounces = 2, 16
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = width, height, 100
    stage.view_settings.view_transform = "Standard"
    settings.image_settings.file_format = "PNG"
    with tempfile.TemporaryDirectory() as folder, silenced(STDOUT), silenced(STDERR):
        settings.filepath = str(Path(folder) / "picture.png")
        bpy.ops.render.render(write_still=True, scene=stage.name)
        image = bpy.data.images.load(settings.filepath)
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)  # rows from the bottom, as they stand in the file: sRGB
    flipped = pixels.reshape(height, width, -1)[::-1, :, :3]
    return np.round(255 * flipped).astype(np.uint8)
