"""A picture of a scene from outside, rendered in Blender with Cycles."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from processes.silence import silenced
from scenegen.making.blender_start import STDERR, STDOUT, BlenderVector, bpy
from scenegen.making.outlines import clipped, frustum_edges, frustum_sides, wall_corners
from scenegen.pose import camera_axes, rotation_matrix
from scenegen.scene import Scene

# Linear RGB. Only hidden objects are orange.
_OBJECT_COLOUR = (0.9, 0.16, 0.01)
_RELAY_COLOUR = (0.7, 0.7, 0.7)
_MIDDLE_COLOUR = (0.02, 0.02, 0.03)
_FLOOR_COLOUR = (0.45, 0.45, 0.45)
_LIGHT_COLOUR = (0.08, 0.4, 0.9)
_CAMERA_COLOUR = (0.01, 0.04, 0.2)
_FOOT_M = 0.3  # height of the lowest part of the middle wall, which is drawn opaque
_PICTURE_SAMPLES = 8  # paths per pixel; then denoised. 288 x 216 pixels take 0.7 s on two cores


def outside_view(
    scene: Scene,
    relay_wall: bpy.types.Mesh,
    middle_wall: bpy.types.Mesh,
    hidden_objects: Sequence[bpy.types.Mesh],
    width: int,
    height: int,
) -> NDArray[np.uint8]:
    """The scene from outside and above, from a viewpoint that depends only on walls and camera.

    The relay wall is light grey. The part of it that camera and projector cover is blue, and so are their
    frustum and the small pyramid at their place. The middle wall is glass, the hidden object orange.
    Everything that is made for the picture is removed from Blender again.

    Parameters
    ----------
    relay_wall, middle_wall, hidden_objects : meshes in world space; they get materials.
    width, height : size of the picture, pixels.

    Returns
    -------
    (H, W, 3) sRGB.
    """
    with _temporary_stage() as stage:
        lit = clipped(wall_corners(scene.relay_wall), frustum_sides(scene.camera))
        bodies = [
            (relay_wall, _RELAY_COLOUR, 1.0),
            (middle_wall, _MIDDLE_COLOUR, 0.2),
            *((mesh, _OBJECT_COLOUR, 1.0) for mesh in hidden_objects),
            *_picture_extras(scene, lit),
        ]
        for mesh, colour, opacity in bodies:
            _show(stage, mesh, colour, opacity)
        _set_up_view(stage, scene, lit)
        return _rendered(stage, width, height)


@contextmanager
def _temporary_stage() -> Iterator[bpy.types.Scene]:
    """A new Blender scene; at the end it is removed, with everything else that was made meanwhile."""
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
    """Camera, frustum, lit area, foot of the middle wall and floor: mesh, linear RGB and opacity of each."""
    camera, wall = np.array(scene.camera.location_m), scene.relay_wall
    yield _pyramid(camera, camera + 0.22 * frustum_edges(scene.camera), base=True), _CAMERA_COLOUR, 1.0
    if len(lit):
        yield _pyramid(camera, lit, base=False), _LIGHT_COLOUR, 0.1
        above = lit + 4e-3 * rotation_matrix(wall.rotation_deg)[:, 2]  # in front of the wall
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
    """Add a mesh in world space to the stage; `colour` is linear RGB."""
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
    """Place the viewer and the sun; they depend only on walls and camera, so that all scenes look alike.

    The viewer looks along the middle wall towards the relay wall, slightly from the object's side, at the
    camera's projection on the middle wall. Camera and object are then on different sides of the picture, and
    no wall covers either of them.
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
    """(H, W, 3) sRGB picture of the stage by Cycles; Blender's other engines need a display."""
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
        image = _written(settings.filepath)
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)  # sRGB as in the file, lowest row first
    flipped = pixels.reshape(height, width, -1)[::-1, :, :3]
    return np.round(255 * flipped).astype(np.uint8)


def _written(file: str) -> bpy.types.Image:
    """The picture that Blender wrote; `OSError` if there is none, which Blender does not report."""
    with suppress(RuntimeError):  # no such file
        image = bpy.data.images.load(file)
        if image.channels > 0:
            return image
    raise OSError(f"Blender could not write {file}: is the disk full?")
