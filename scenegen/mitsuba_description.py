"""A scene in Mitsuba's terms, as plain data: nested dictionaries in the form of Mitsuba's `load_dict`.

They differ from it in two ways: a pose is a list of four rows, and file names are relative to the scene's
folder. ``night-render`` loads this description (`render.transport.scene_loading`); ``scene.xml`` and
``mirrored.xml`` are the same description as text for plain Mitsuba (`scenegen.mitsuba_xml`).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import gcd
from typing import Any

import numpy as np

from disk.quantities import Vector
from scenegen.pose import blender_matrix
from scenegen.projector import dots_image
from scenegen.scene import Camera, RelayWall, Scene
from scenegen.wall_image import WALL_IMAGE, pfm

Description = Mapping[str, Any]
ROUGH_WALL = "roughplastic"  # Mitsuba's plugin for the material of a rough relay wall
ROUGH_WALL_INDEX = 1.49 / 1.000277  # its refractive index: polypropylene in air
EMITTER_IMAGE = "emitter.pfm"  # Mitsuba takes the projector's aspect ratio from this image
# The projector's field of view is wider than the camera's by this angle. With equal angles, rounding loses
# about one path in a thousand at the image border, and that is half of the hidden signal there.
_FRUSTUM_MARGIN_DEG = 1e-3
_TO_MITSUBA_CAMERA = np.diag([-1.0, 1.0, -1.0, 1.0])  # Blender looks along -z, Mitsuba along +z with x left


def hidden_names(scene: Scene) -> list[str]:
    """Names of the hidden objects, and of their mesh files without ``.ply``."""
    return [f"hidden_object_{number}" for number in range(len(scene.hidden_objects))]


def mirrored_names(scene: Scene) -> dict[str, str]:
    """Names of the meshes that are mirrored at the relay wall's plane, by those of their mirror images."""
    names = hidden_names(scene) + ["middle_wall"] * scene.mirror_occluders
    return {f"mirrored_{name}": name for name in names}


def wall_names(scene: Scene) -> list[str]:
    """Names of all walls and of their mesh files without ``.ply``: both walls, and those of the room."""
    return ["relay_wall", "middle_wall", *(wall.name for wall in scene.room)]


def seen_description(scene: Scene) -> Description:
    """What the camera measures: the walls and the hidden objects."""
    hidden = {name: _material_name(name, scene) for name in hidden_names(scene)}
    meshes = {name: name for name in wall_names(scene)} | hidden
    return _description(scene, meshes, scene.max_bounces)


def room_description(scene: Scene) -> Description:
    """The scene without relay wall: all that the camera sees of it, light has met in the room alone."""
    described = seen_description(scene)
    return {name: part for name, part in described.items() if not name.startswith("relay_wall")}


def mirrored_description(scene: Scene) -> Description:
    """The scene of the ground truth: without relay wall, the hidden objects mirrored at its plane.

    Like a real mirror, a scene with `mirror_occluders` also has the mirror image of the middle wall. Nothing
    but the objects reflects light.
    """
    scene = scene.in_black_room()
    mirrored = {
        image: "middle_wall" if name == "middle_wall" else _material_name(name, scene)
        for image, name in mirrored_names(scene).items()
    }
    return _description(scene, {"middle_wall": "middle_wall", **mirrored}, 1)


def emitter_pfm(scene: Scene) -> bytes:
    """The projector's image: its dots, or ones in the smallest size that has the camera's aspect ratio."""
    if scene.emitter.dots is not None:
        return pfm(dots_image(scene.emitter.dots, scene.emitter.spacing))
    width, height = _emitter_size(scene.camera)
    return pfm(np.ones((height, width)))


def is_emitter_pfm(contents: bytes, scene: Scene) -> bool:
    """Whether `contents` are `emitter_pfm` of a scene, which need not be made for that if it is huge."""
    width, height = _emitter_size(scene.camera)
    is_huge = scene.emitter.dots is None and len(contents) <= 4 * width * height
    return not is_huge and contents == emitter_pfm(scene)


def _description(scene: Scene, meshes: Mapping[str, str], max_bounces: int) -> Description:
    """The scene with `meshes`: the material of each, by the name of its file without ``.ply``."""
    materials = {name: _material(name, scene) for name in sorted(set(meshes.values()))}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_bounces + 1},  # counts the edges after the first one
        "sensor": _sensor(scene.camera),
        "emitter": _projector(scene),
        **{f"{name}_bsdf": {"type": "twosided", "bsdf": inner} for name, inner in materials.items()},
        **{name: _mesh(name, material) for name, material in meshes.items()},
    }


def _emitter_size(camera: Camera) -> tuple[int, int]:
    divisor = gcd(camera.width, camera.height)
    return camera.width // divisor, camera.height // divisor


def _mesh(name: str, material: str) -> Description:
    return {
        "type": "ply",
        "filename": f"{name}.ply",
        "face_normals": True,  # no smooth shading
        "bsdf": {"type": "ref", "id": f"{material}_bsdf"},
    }


def _sensor(camera: Camera) -> Description:
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "pixel_format": "luminance"}
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": camera.horizontal_fov_deg,
        "to_world": _pose(camera.location_m, camera.rotation_deg),
        "film": {**film, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 64},
    }


def _projector(scene: Scene) -> Description:
    emitter = scene.emitter
    return {
        "type": "projector",
        "fov_axis": "x",
        "fov": emitter.horizontal_fov_deg + _FRUSTUM_MARGIN_DEG * scene.has_flash,
        "scale": emitter.irradiance,
        "to_world": _pose(emitter.location_m, emitter.rotation_deg),
        "irradiance": _image(EMITTER_IMAGE, "nearest"),
    }


def _material(name: str, scene: Scene) -> Description:
    if name == "relay_wall":
        return _relay_wall(scene.relay_wall)
    names = [_material_name(each, scene) for each in hidden_names(scene)]
    parts = dict(zip(names, scene.hidden_objects, strict=True))
    walls = {str(wall.name): wall.reflectance for wall in scene.room}
    objects = {each: part.reflectance for each, part in parts.items()}
    return _diffuse((walls | objects).get(name, scene.middle_wall.reflectance))


def _material_name(name: str, scene: Scene) -> str:
    """Material of a hidden object: one for all, or its own where their reflectances differ."""
    return "hidden_object" if len({part.reflectance for part in scene.hidden_objects}) == 1 else name


def _relay_wall(wall: RelayWall) -> Description:
    reflectance = _spectrum(wall.reflectance)
    if wall.darkening is not None:
        # Without "accel": False, a GPU interpolates with 8 bits.
        reflectance = {**_image(WALL_IMAGE, "bilinear"), "accel": False}
    if wall.roughness is None:
        return {"type": "diffuse", "reflectance": reflectance}
    return {"type": ROUGH_WALL, "alpha": wall.roughness, "diffuse_reflectance": reflectance}


def _diffuse(reflectance: float) -> Description:
    return {"type": "diffuse", "reflectance": _spectrum(reflectance)}


def _spectrum(reflectance: float) -> Description:
    return {"type": "spectrum", "value": reflectance}


def _image(name: str, filter_type: str) -> Description:
    described = {"type": "bitmap", "filename": name, "raw": True, "filter_type": filter_type}
    return {**described, "wrap_mode": "clamp"}


def _pose(location_m: Vector, rotation_deg: Vector) -> list[list[float]]:
    """Four rows, rounded to the nine digits of the text form, so that both forms are the same numbers."""
    matrix = blender_matrix(location_m, rotation_deg) @ _TO_MITSUBA_CAMERA + 0.0  # no -0
    return [[float(f"{value:.9g}") for value in row] for row in matrix]
