"""Loads a scene into Mitsuba from its data: ``scene.json`` and its meshes.

Mitsuba opens no file of a scene: a scene file can name any plugin and any other file. NIGHT's own plain
readers read the meshes and the projector's image.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from disk import NightError
from scenegen import Dataset
from scenegen.mitsuba_description import ROUGH_WALL, Description, mirrored_description, seen_description
from scenegen.scene_folder import read_scene_folder, scene_of
from scenegen.triangles import MeshError, scene_texture_coordinates, scene_triangles
from scenegen.wall_image import WALL_IMAGE

if TYPE_CHECKING:
    import mitsuba as mi

_KEPT_MESHES = 8  # the walls at least, which are the same in all scenes
_LARGEST_KEPT = 2**20  # bytes of a mesh file
_PFM = re.compile(rb"Pf\n([0-9]{1,6}) ([0-9]{1,6})\n-1\.0\n", re.ASCII)


class SceneLoadingError(NightError):
    """A scene has a file that is missing or damaged, or that Mitsuba cannot use."""


def load_scene(dataset: Dataset, scene_id: str, *, mirrored: bool = False) -> mi.Scene:
    """The scene of a dataset as its files are, or its mirrored scene.

    Raises
    ------
    NightError : a file is missing or damaged.
    """
    folder = dataset.scene_folder(scene_id)
    files = read_scene_folder(folder)
    scene = scene_of(files, folder)
    return scene_from_data((mirrored_description if mirrored else seen_description)(scene), files, folder)


def scene_from_data(
    description: Description, files: Mapping[str, bytes], folder: Path, rough_wall: str = ROUGH_WALL
) -> mi.Scene:
    """Load a description into Mitsuba.

    Parameters
    ----------
    description : scene from `scenegen.mitsuba_description`.
    files : contents of the files that it names.
    folder : where the files are, for the message of an error.
    rough_wall : plugin in place of ``roughplastic`` (see `Method.rough_wall`).

    Raises
    ------
    SceneLoadingError, MeshError : a file is missing or damaged, or Mitsuba cannot use the scene.
    """
    try:
        bsdfs = {
            f"{name}": _loaded(_loadable(_with_rough_wall(part, rough_wall), files, folder))
            for name, part in description.items()
            if isinstance(part, dict) and part["type"] == "twosided"
        }
        parts: dict[str, Any] = {}
        for name, part in description.items():
            if name in bsdfs:
                continue
            if isinstance(part, dict) and part["type"] == "ply":
                contents, origin = _file(files, part["filename"], folder), str(folder / part["filename"])
                material = part["bsdf"]["id"]
                shown = _has_image(description[material])
                texture = scene_texture_coordinates(contents, origin) if shown else None
                parts[name] = _mesh(name, *_triangles(contents, origin), bsdfs[material], texture)
            else:
                parts[name] = _loadable(part, files, folder)
        return _loaded(parts)
    except RuntimeError as error:
        raise SceneLoadingError(f"Mitsuba cannot load {folder}: {' '.join(str(error).split())}") from None


def _loaded(parts: Any) -> Any:
    """What a description stands for, loaded on this thread, so that its kernels are always the same."""
    import mitsuba as mi

    # With optimize=True, meshes of one material are merged and lose the ids by which rays know them.
    return mi.load_dict(parts, parallel=False, optimize=False)


def _has_image(part: Any) -> bool:
    """Whether a material has an image anywhere in its description."""
    return isinstance(part, dict) and (
        part["type"] == "bitmap" or any(_has_image(inner) for inner in part.values())
    )


def _with_rough_wall(part: dict[str, Any], plugin: str) -> dict[str, Any]:
    """A material with `plugin` in place of ``roughplastic``."""
    return {
        key: {**inner, "type": plugin} if isinstance(inner, dict) and inner["type"] == ROUGH_WALL else inner
        for key, inner in part.items()
    }


def _triangles(contents: bytes, origin: str) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """`scene_triangles`, kept for small meshes."""
    if len(contents) > _LARGEST_KEPT:
        return scene_triangles(contents, origin)
    try:
        return _kept_triangles(contents)
    except MeshError:
        return scene_triangles(contents, origin)  # raises it with the name of the file


@lru_cache(_KEPT_MESHES)
def _kept_triangles(contents: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    vertices, triangles = scene_triangles(contents, "")
    for array in (vertices, triangles):
        array.setflags(write=False)
    return vertices, triangles


def _mesh(
    name: str,
    vertices: NDArray[np.float32],
    triangles: NDArray[np.uint32],
    bsdf: mi.BSDF,
    texture: NDArray[np.float32] | None,
) -> mi.Mesh:
    import mitsuba as mi

    properties = mi.Properties()
    properties["face_normals"] = True
    properties["bsdf"] = bsdf
    properties.set_id(name)
    mesh = mi.Mesh(
        name, len(vertices), len(triangles), props=properties, has_vertex_texcoords=texture is not None
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(vertices.ravel())
    parameters["faces"] = mi.UInt32(triangles.ravel())
    if texture is not None:
        parameters["vertex_texcoords"] = mi.Float(texture.ravel())
    parameters.update()
    return mesh


def _loadable(part: Any, files: Mapping[str, bytes], folder: Path) -> Any:
    """A part of a description with Mitsuba's own objects for poses and images."""
    import mitsuba as mi

    if isinstance(part, list):
        return mi.ScalarTransform4f(np.array(part))
    if not isinstance(part, dict):
        return part
    if part["type"] == "bitmap":
        name = part["filename"]
        pixels = _pixels(_file(files, name, folder), folder / name)
        if name == WALL_IMAGE and not ((pixels >= 0) & (pixels <= 1)).all():
            raise SceneLoadingError(
                f"{folder / name} has a reflectance outside 0 to 1: run night-gen scenes again"
            )
        image = mi.Bitmap(pixels)
        part = {key: value for key, value in part.items() if key != "filename"} | {"bitmap": image}
    return {key: _loadable(value, files, folder) for key, value in part.items()}


def _pixels(contents: bytes, file: Path) -> NDArray[np.float32]:
    """(H, W, 1) a portable float map of one channel, in the form of `emitter_pfm`."""
    header = _PFM.match(contents)
    size = (int(header[2]), int(header[1])) if header else (0, 0)
    if header is None or len(contents) != header.end() + 4 * size[0] * size[1] or 0 in size:
        raise SceneLoadingError(f"{file} is damaged: run night-gen scenes again")
    rows = np.frombuffer(contents, "<f4", offset=header.end()).reshape(*size, 1)
    return np.array(rows[::-1], np.float32, order="C")  # a copy; the last row comes first


def _file(files: Mapping[str, bytes], name: str, folder: Path) -> bytes:
    if name not in files:
        raise SceneLoadingError(f"{folder / name} is missing: run night-gen scenes again")
    return files[name]
