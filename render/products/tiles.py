"""A tile of the contact sheet: one scene from outside, as measured, and in ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap, Image, ImageFileError, amplitude, direct_phasors, read_image
from render.products.rendered_scene import rendered_scene
from render.settings import RenderError
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    RENDER_AGAIN,
    Dataset,
    Scene,
    camera_axes,
    is_recorded,
    recorded_file,
    wall_normal,
)

PICTURE_SIZE = (288, 216)  # width and height of Blender's view, pixels


@dataclass(frozen=True)
class Tile:
    """One scene on a contact sheet; measurement and depth are None if it is not rendered.

    Attributes
    ----------
    title : id, class, split and roughness.
    view : (H, W, 3) uint8, the scene from outside.
    measured : (H, W) amplitude at the first frequency.
    hidden : (H, W) amplitude of the hidden part at the first frequency. If `hidden_is_residual`, it is the
        imaginary part of the measurement relative to the phase of the wall's direct return, which only hidden
        light causes.
    hidden_is_residual : whether the file has no hidden part, so that `hidden` is the residual.
    radial_depth_m : (H, W) ground truth along the ray, metres, NaN on background.
    """

    title: str
    view: NDArray[np.uint8]
    measured: NDArray[np.float64] | None
    hidden: NDArray[np.float64] | None
    hidden_is_residual: bool
    radial_depth_m: NDArray[np.float64] | None


def is_rendered(dataset: Dataset, scene_id: str) -> bool:
    """Whether a scene has a measurement and a ground truth, and a record unless another program made them."""
    folder = dataset.render_folder(scene_id)
    has_files = (folder / MEASUREMENT_FILE).is_file() and (folder / GROUND_TRUTH_FILE).is_file()
    return has_files and is_recorded(dataset, scene_id)


def read_tile(dataset: Dataset, scene_id: str, view: NDArray[np.uint8]) -> Tile:
    """The tile of a scene.

    Parameters
    ----------
    view : (H, W, 3) picture of the scene from outside, made by Blender.

    Raises
    ------
    RenderFileError : a rendered file differs from its record.
    ExportError : the files of the scene are not those that were rendered.
    ImageFileError : a file without a record is truncated or not an EXR file.
    RenderError : a rendered file does not have the channels of a render, or has NaN or infinite pixels.
    """
    has_render = is_rendered(dataset, scene_id)
    scene = rendered_scene(dataset, scene_id) if has_render else dataset.scene(scene_id)
    measured = hidden = depth_m = None
    is_residual = False
    if has_render:
        image = read_image(recorded_file(dataset, scene_id, MEASUREMENT_FILE), advice=RENDER_AGAIN)
        is_residual = not any(name.startswith("hidden.") for name in image.channels)
        measured = checked_pixels(scene_id, MEASUREMENT_FILE, lambda: amplitude(image.phasors()[0][..., 0]))
        hidden = checked_pixels(scene_id, MEASUREMENT_FILE, lambda: _hidden(scene, image, is_residual))
        truth = read_ground_truth(dataset, scene_id)
        depth_m = np.where(truth.mask, truth.radial_depth_m, np.nan)
    return Tile(_title(dataset, scene), view, measured, hidden, is_residual, depth_m)


def read_ground_truth(dataset: Dataset, scene_id: str) -> DepthMap:
    """Ground truth (H, W) of a rendered scene; `RenderFileError`, `ImageFileError` if the file is damaged."""
    return DepthMap.read(recorded_file(dataset, scene_id, GROUND_TRUTH_FILE), advice=RENDER_AGAIN)


def checked_pixels(
    scene_id: str, file: str, values: Callable[[], NDArray[np.floating]]
) -> NDArray[np.float64]:
    """Pixels that `values` returns; `RenderError` names scene and file if they are missing or not finite."""
    try:
        found = np.asarray(values(), np.float64)
    except ImageFileError as error:
        raise RenderError(
            f"scene {scene_id}: {file} is no render of NIGHT ({error}): {RENDER_AGAIN}"
        ) from None
    if not np.isfinite(found).all():
        raise RenderError(f"scene {scene_id}: {file} holds NaN or infinity: {RENDER_AGAIN}")
    return found


def _hidden(scene: Scene, image: Image, is_residual: bool) -> NDArray[np.float64]:
    """(H, W) hidden light in a measurement; see `Tile.hidden`."""
    if not (is_residual and scene.has_flash):
        return amplitude(image.phasors("hidden")[0][..., 0])
    phasor, frequencies_hz = image.phasors()
    height, width = phasor.shape[:2]
    camera, wall = scene.camera, scene.relay_wall
    direct = direct_phasors(
        width,
        height,
        camera.horizontal_fov_deg,
        frequencies_hz[:1],
        camera_axes(camera),
        camera.location_m,
        wall.location_m,
        wall_normal(wall),
    )[..., 0]
    turned: NDArray[np.float64] = (phasor[..., 0] * np.exp(-1j * np.angle(direct))).imag
    return turned


def _title(dataset: Dataset, scene: Scene) -> str:
    entry, roughness = dataset.entry(scene.id), scene.relay_wall.roughness
    wall = "diffuse wall" if roughness is None else f"roughness {roughness:.2f}"
    return f"{scene.id}   {class_name(entry.object_class)}   {entry.split}   {wall}"


def class_name(object_class: str) -> str:
    """An object class as a label in a figure, at most 24 characters."""
    name = object_class.rsplit("/", 1)[-1].replace("_", " ")
    short = name if len(name) <= 24 else name[:23] + "…"
    return short.replace("$", r"\$")  # Matplotlib would read a formula
