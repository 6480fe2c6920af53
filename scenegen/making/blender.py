"""Makes the files of a scene in Blender: scene data in; meshes, Mitsuba scene files and pictures out.

Import this module late: `bpy` takes seconds to load, and only ``night-gen`` needs it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import radians
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from disk.quantities import Vector
from processes.silence import silenced
from scenegen.making.blender_picture import outside_view
from scenegen.making.blender_shapes import (
    SQUARE_CORNERS,
    ply_bytes,
    primitive,
    reflection,
    unit_square,
    user_mesh,
    world_mesh,
)
from scenegen.making.blender_start import STDOUT, bpy, empty_blender
from scenegen.making.meshes import UserMesh
from scenegen.mitsuba_description import EMITTER_IMAGE, emitter_pfm, hidden_names, mirrored_names, wall_names
from scenegen.mitsuba_xml import scene_files_for_mitsuba
from scenegen.scene import Scene, Wall, scene_to_json
from scenegen.scene_folder import SCENE_FILE, WALLS
from scenegen.shapes import PRIMITIVES, Shape
from scenegen.wall_image import WALL_IMAGE, texture_coordinates, wall_pfm


class BlenderMaker:
    """Makes scenes in the Blender of this process.

    Blender is emptied once, and the objects of a scene are removed after it: memory stays constant.

    Parameters
    ----------
    meshes : the mesh files that the scenes' shapes name, by shape; see `scenegen.making.meshes.with_meshes`.
    """

    def __init__(self, meshes: Mapping[Shape, UserMesh] = MappingProxyType({})) -> None:
        empty_blender()
        self.meshes = meshes
        self._shapes = {shape: primitive(shape) for shape in PRIMITIVES}
        self._shapes |= {shape: user_mesh(mesh) for shape, mesh in meshes.items()}
        self._square = unit_square()

    @property
    def version(self) -> str:
        """Version of Blender."""
        return str(bpy.app.version_string)

    def files(self, scene: Scene) -> dict[str, bytes]:
        """``scene.json``, ``scene.xml``, ``mirrored.xml``, the meshes and the projector's image, by name."""
        made = {}
        with self._built(scene) as objects:
            mirror = reflection(objects["relay_wall"].matrix_world)
            shown = {"relay_wall": texture_coordinates(scene.relay_wall, np.array(SQUARE_CORNERS))}
            for name in (*wall_names(scene), *hidden_names(scene)):
                made[f"{name}.ply"] = ply_bytes(world_mesh(objects[name]), shown.get(name))
            for mirrored, name in mirrored_names(scene).items():
                made[f"{mirrored}.ply"] = ply_bytes(world_mesh(objects[name], mirror))
        exported = {name: text.encode() for name, text in scene_files_for_mitsuba(scene).items()}
        image = wall_pfm(scene.relay_wall)
        images = {EMITTER_IMAGE: emitter_pfm(scene)} | ({} if image is None else {WALL_IMAGE: image})
        return made | exported | images | {SCENE_FILE: scene_to_json(scene).encode()}

    def picture(self, scene: Scene, width: int, height: int) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB picture of the scene from outside; see `scenegen.making.blender_picture`."""
        with self._built(scene) as objects:
            relay, middle = (world_mesh(objects[name]) for name in WALLS)
            hidden = [world_mesh(objects[name]) for name in hidden_names(scene)]
            return outside_view(scene, relay, middle, hidden, width, height)

    @contextmanager
    def _built(self, scene: Scene) -> Iterator[dict[str, bpy.types.Object]]:
        """The scene's objects, placed and evaluated; they and all new meshes are removed at the end."""
        kept = set(bpy.data.meshes)
        objects = {
            "relay_wall": self._wall("relay_wall", scene.relay_wall),
            "middle_wall": self._wall("middle_wall", scene.middle_wall),
            "camera": _camera(scene),
            "emitter": _emitter(scene),
        }
        objects |= {str(wall.name): self._wall(wall.name, wall) for wall in scene.room}
        for name, part in zip(hidden_names(scene), scene.hidden_objects, strict=True):
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
        placed = _placed(name, self._square, wall.location_m, wall.rotation_deg)
        placed.scale = (*wall.size_m, 1.0)
        return placed


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
