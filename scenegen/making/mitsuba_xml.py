"""Mitsuba 3 scene files. Paths in them are relative to the file.

Mitsuba takes the projector's aspect ratio from an image; `emitter_pfm` makes the smallest one.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd

import numpy as np
from numpy.typing import NDArray

from scenegen.scene import Camera, RelayWall, Scene

EMITTER_IMAGE = "emitter.pfm"
# The projector's field of view is wider than the camera's by this angle. With equal angles, rounding loses
# about one path in a thousand at the image border, and that is half of the hidden signal there.
_FRUSTUM_MARGIN_DEG = 1e-3
_TO_MITSUBA_CAMERA = np.diag([-1.0, 1.0, -1.0, 1.0])  # Blender looks along -z, Mitsuba along +z with x left


@dataclass(frozen=True)
class MeshFile:
    """Name of a PLY file, and its material: ``relay_wall``, ``middle_wall`` or ``hidden_object``."""

    name: str
    material: str


def scene_xml(
    scene: Scene,
    camera_to_world: NDArray[np.float64],
    emitter_to_world: NDArray[np.float64],
    meshes: Sequence[MeshFile],
    max_bounces: int,
) -> str:
    """Text of a ``scene.xml`` or ``mirrored.xml``.

    Parameters
    ----------
    camera_to_world, emitter_to_world : (4, 4) poses in Blender's camera convention (looking along -z).
    meshes : the meshes of the scene.
    max_bounces : number of surfaces that light may meet; Mitsuba's `max_depth` is larger by 1.
    """
    root = ET.Element("scene", version="3.0.0")
    integrator = _plugin(root, "integrator", "path")
    _value(integrator, "integer", "max_depth", max_bounces + 1)  # counts the edges after the first one
    _add_sensor(root, scene.camera, camera_to_world)
    _add_emitter(root, scene, emitter_to_world)
    for material in sorted({mesh.material for mesh in meshes}):
        _add_material(root, material, scene)
    for mesh in meshes:
        shape = _plugin(root, "shape", "ply", id=mesh.name.removesuffix(".ply"))
        _value(shape, "string", "filename", mesh.name)
        _value(shape, "boolean", "face_normals", "true")  # no smooth shading
        ET.SubElement(shape, "ref", id=f"{mesh.material}_bsdf", name="bsdf")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def emitter_pfm(camera: Camera) -> bytes:
    """A portable float map of ones, of the smallest size that has the camera's aspect ratio."""
    divisor = gcd(camera.width, camera.height)
    width, height = camera.width // divisor, camera.height // divisor
    return f"Pf\n{width} {height}\n-1.0\n".encode() + np.ones((height, width), "<f4").tobytes()


def _add_sensor(root: ET.Element, camera: Camera, to_world: NDArray[np.float64]) -> None:
    sensor = _plugin(root, "sensor", "perspective")
    _value(sensor, "string", "fov_axis", "x")
    _value(sensor, "float", "fov", repr(camera.horizontal_fov_deg))
    _pose(sensor, to_world)
    film = _plugin(sensor, "film", "hdrfilm")
    _value(film, "integer", "width", camera.width)
    _value(film, "integer", "height", camera.height)
    _value(film, "string", "pixel_format", "luminance")
    _plugin(film, "rfilter", "box")
    sampler = _plugin(sensor, "sampler", "independent")
    _value(sampler, "integer", "sample_count", 64)


def _add_emitter(root: ET.Element, scene: Scene, to_world: NDArray[np.float64]) -> None:
    emitter = _plugin(root, "emitter", "projector")
    _value(emitter, "string", "fov_axis", "x")
    _value(emitter, "float", "fov", repr(scene.emitter.horizontal_fov_deg + _FRUSTUM_MARGIN_DEG))
    _value(emitter, "float", "scale", repr(scene.emitter.irradiance))
    _pose(emitter, to_world)
    texture = _plugin(emitter, "texture", "bitmap", name="irradiance")
    _value(texture, "string", "filename", EMITTER_IMAGE)
    _value(texture, "boolean", "raw", "true")
    _value(texture, "string", "filter_type", "nearest")
    _value(texture, "string", "wrap_mode", "clamp")


def _add_material(root: ET.Element, material: str, scene: Scene) -> None:
    outer = _plugin(root, "bsdf", "twosided", id=f"{material}_bsdf")
    if material == "relay_wall":
        _add_relay_bsdf(outer, scene.relay_wall)
    else:
        # All hidden objects of a scene share one reflectance; the middle wall is black.
        reflectance = scene.hidden_objects[0].reflectance if material == "hidden_object" else 0.0
        _value(_plugin(outer, "bsdf", "diffuse"), "spectrum", "reflectance", repr(reflectance))


def _add_relay_bsdf(outer: ET.Element, wall: RelayWall) -> None:
    if wall.roughness is None:
        _value(_plugin(outer, "bsdf", "diffuse"), "spectrum", "reflectance", repr(wall.reflectance))
        return
    bsdf = _plugin(outer, "bsdf", "roughplastic")
    _value(bsdf, "float", "alpha", repr(wall.roughness))
    _value(bsdf, "spectrum", "diffuse_reflectance", repr(wall.reflectance))


def _plugin(parent: ET.Element, tag: str, kind: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, tag, {"type": kind, **attributes})


def _value(parent: ET.Element, tag: str, name: str, value: object) -> None:
    ET.SubElement(parent, tag, {"name": name, "value": str(value)})


def _pose(parent: ET.Element, to_world: NDArray[np.float64]) -> None:
    matrix = to_world @ _TO_MITSUBA_CAMERA
    transform = ET.SubElement(parent, "transform", name="to_world")
    ET.SubElement(transform, "matrix", value=" ".join(f"{value:.9g}" for value in matrix.ravel()))
