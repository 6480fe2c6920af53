"""The mirror trick in three ordinary pictures: the corner, the corner with a mirror as its wall, the result.

The pictures are what a camera with ordinary light sees, rendered by Mitsuba's path tracer. Time of flight and
the projector have no part in them. A test compares where the second and the third show the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from disk import PathLike
from itof import pixel_rays
from itof.pictures.png import save_png
from render.backend import Device, select_variant
from render.products.conversion import ExportError, exported_file
from render.products.panels_figure import panels_figure
from render.settings import RenderError
from render.transport.scene_loading import scene_from_data
from scenegen import Dataset, Scene, camera_axes, wall_normal
from scenegen.mitsuba_description import Description, mirrored_description, seen_description
from scenegen.scene_folder import read_scene_folder, scene_of

if TYPE_CHECKING:
    import mitsuba as mi

_TITLES = ("scene", "relay wall as a perfect mirror", "after the mirror trick")
_DOTS_PER_INCH = 110
WIDTH = 320  # pixels; the height follows from the camera
_MOST_HEIGHT = 1920  # pixels
_PATHS = 256  # per pixel
_MOST_VERTICES = 8  # of a path; light that is seen in the mirror has one more than without
_SKY = (512, 256)  # pixels of the map of the light; it is smooth over one pixel, 0.7 degrees
_SKY_NAME = "sky"
_STRAIGHT = 1e-3  # part of the direction of view along the wall, below which it is rounding


@dataclass(frozen=True)
class MirrorPanels:
    """Three pictures (H, W) of the same camera, in radiance; the light has radiance 1.

    Attributes
    ----------
    corner : the scene as it is. The object is hidden.
    mirror : the same with a perfect mirror in the place of the relay wall, which shows the object.
    trick : after the mirror trick: without relay wall, with the object reflected at its plane.
    """

    corner: NDArray[np.float64]
    mirror: NDArray[np.float64]
    trick: NDArray[np.float64]


def render_mirror_panels(
    dataset: Dataset, scene_id: str, *, device: Device = "auto", paths: int = _PATHS, width: int = WIDTH
) -> MirrorPanels:
    """Render the three pictures of a scene; it need not be rendered otherwise.

    The light is one half of the sky, of radiance 1: all directions behind the camera, along the relay wall.
    Neither the camera nor its mirror image looks into it, so what has no surface is black.

    Parameters
    ----------
    paths : paths per pixel.
    width : of the pictures, pixels.

    Raises
    ------
    RenderError : the camera looks so straight at the wall that some pixels see the light, or it is much
        higher than wide.
    NightError : a file of the scene is missing or damaged.
    BackendError : this machine cannot render on the device.
    """
    folder = dataset.scene_folder(scene_id)
    files = read_scene_folder(folder)
    scene = scene_of(files, folder)
    size = (width, round(width * scene.camera.height / scene.camera.width))
    if not 1 <= size[1] <= _MOST_HEIGHT:
        raise RenderError(
            f"scene {scene_id}: pictures of {size[0]} x {size[1]} pixels cannot be drawn: the camera has "
            f"{scene.camera.width} x {scene.camera.height}"
        )
    select_variant(device)
    seen = seen_description(scene)
    mirror = {**seen, "relay_wall_bsdf": {"type": "twosided", "bsdf": {"type": "conductor"}}}
    pictures = (
        _picture(scene_from_data(_lit_by_the_sky(part, scene, size), files, folder), scene.seed, paths)
        for part in (seen, mirror, mirrored_description(scene))
    )
    return MirrorPanels(*pictures)


def write_mirror_panels(
    dataset: Dataset, scene_id: str, out: PathLike, *, device: Device = "auto", width: int = WIDTH
) -> None:
    """Draw the three pictures of `render_mirror_panels` side by side into a PNG file.

    Raises
    ------
    ExportError : `out` is not a .png file or cannot be written.
    RenderError, NightError, BackendError : as `render_mirror_panels`.
    """
    if Path(out).suffix.lower() != ".png":
        raise ExportError(f"the panels are a .png file: cannot write {out}")
    with exported_file(out) as partial:
        try:
            found = render_mirror_panels(dataset, scene_id, device=device, width=width)
        except OSError as error:  # of reading, not of `out`
            raise RenderError(f"scene {scene_id}: {error.filename}: {error.strerror}") from None
        figure = panels_figure(dict(zip(_TITLES, (found.corner, found.mirror, found.trick), strict=True)))
        save_png(figure, partial, _DOTS_PER_INCH)


def _lit_by_the_sky(description: Description, scene: Scene, size: tuple[int, int]) -> dict[str, Any]:
    """A description with ordinary light instead of the projector, and an ordinary picture of `size`."""
    import mitsuba as mi

    sensor = dict(description["sensor"])
    sensor["film"] = {**sensor["film"], "width": size[0], "height": size[1]}
    sky = {"type": "envmap", "bitmap": mi.Bitmap(_half_sky(_along_the_wall(scene, size)))}
    parts = {name: part for name, part in description.items() if name not in ("emitter", "integrator")}
    return {**parts, "sensor": sensor, _SKY_NAME: sky}


def _along_the_wall(scene: Scene, size: tuple[int, int]) -> NDArray[np.float64]:
    """(3,) the camera's direction of view, projected on the relay wall; its mirror image has the same.

    `size` is that of the picture, pixels.
    """
    axes, normal = camera_axes(scene.camera), wall_normal(scene.relay_wall)
    along = axes[2] - (axes[2] @ normal) * normal
    length = float(np.linalg.norm(along))
    rays = pixel_rays(*size, scene.camera.horizontal_fov_deg) @ axes
    if length < _STRAIGHT or (rays @ along).min() <= 0:
        raise RenderError(
            f"scene {scene.id}: the camera looks straight at the relay wall, or nearly so, and would see its "
            "own light in the mirror, so there is no picture of the mirror trick"
        )
    return np.asarray(along / length)


def _half_sky(ahead: NDArray[np.float64]) -> NDArray[np.float32]:
    """(H, W, 1) map of the light: 1 in all directions with a negative component along `ahead`.

    In Mitsuba's ``envmap``, y is up, u = atan2(x, -z) / 2π and v = acos(y) / π; a test checks it.
    """
    width, height = _SKY
    azimuth = (np.arange(width) + 0.5) / width * 2 * np.pi
    polar = (np.arange(height) + 0.5)[:, None] / height * np.pi
    directions = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)),
        axis=-1,
    )
    return (directions @ ahead < 0)[..., None].astype(np.float32)


def _picture(scene: mi.Scene, seed: int, paths: int) -> NDArray[np.float64]:
    """(H, W) radiance by Mitsuba's path tracer."""
    import drjit as dr
    import mitsuba as mi

    integrator = mi.load_dict({"type": "path", "max_depth": _MOST_VERTICES})
    image = mi.render(scene, integrator=integrator, seed=dr.opaque(mi.UInt32, seed), spp=paths)
    return np.array(image, np.float64)[..., 0]
