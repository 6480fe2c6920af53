"""A dataset folder made from closed forms, for tests that need renders but neither Blender nor Mitsuba.

The hidden object is a point that scatters: the wall's direct return is exact (`itof.direct_phasors`), the
hidden return is one three-bounce path a pixel, about 0.2 % of it, and the truth is a disc at the
mirrored point.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import write_text
from itof import (
    direct_phasors,
    phase_per_metre,
    phasor_channels,
    phasor_of_return,
    pixel_rays,
    read_image,
    write_image,
)
from scenegen import (
    Dataset,
    Scene,
    build_index,
    camera_axes,
    open_dataset,
    preset_from_dict,
    sample_scene,
    scene_entry,
    scene_to_json,
    wall_normal,
    write_index,
)

DISC_RADIUS_M = 0.3
HIDDEN_FRACTION = 2e-3  # docs/science/design.md, Hidden signal is small


def write_synthetic_dataset(
    root: Path,
    *,
    count: int = 12,
    width: int = 24,
    height: int = 14,
    parts: bool = True,
    **preset: dict[str, object],
) -> Dataset:
    """Scenes and their renders under `root`; `preset` tables replace the defaults.

    With `parts`, measurements have direct and hidden light apart, as those of night-render.
    """
    tables = {
        "dataset": {"count": count, "test_fraction": 0.25, "validation_fraction": 0.25},
        "camera": {"width": width, "height": height},
        **preset,
    }
    resolved = preset_from_dict(tables, "test")
    scenes = [sample_scene(resolved, index) for index in range(count)]
    for scene in scenes:
        write_text(root / "scenes" / scene.id / "scene.json", scene_to_json(scene))
    entries = [scene_entry(scene, {"scene.json": scene_to_json(scene).encode()}) for scene in scenes]
    write_index(root, build_index(resolved, entries, "none"))
    dataset = open_dataset(root)
    for scene in scenes:
        write_synthetic_render(dataset, scene, width, height, parts=parts)
    return dataset


def write_synthetic_render(
    dataset: Dataset, scene: Scene, width: int, height: int, *, parts: bool = True
) -> None:
    """``itof.exr`` and ``mirrored.exr`` of one scene."""
    frequencies_hz = dataset.preset.itof.frequencies_hz
    phasor, radial_depth_m, direct = closed_form(scene, frequencies_hz, width, height)
    mask = (radial_depth_m > 0).astype(np.float32)
    mirrored = mask * phasor_of_return(radial_depth_m, frequencies_hz[0])
    folder = dataset.render_folder(scene.id)
    folder.mkdir(parents=True, exist_ok=True)
    images = {"itof": phasor} | ({"direct": direct, "hidden": phasor - direct} if parts else {})
    channels = [phasor_channels(image, frequencies_hz, name) for name, image in images.items()]
    write_image(folder / "itof.exr", {name: values for each in channels for name, values in each.items()}, {})
    truth = {"depth.R": radial_depth_m, "mask.M": mask}
    write_image(folder / "mirrored.exr", truth | phasor_channels(mirrored[..., None], frequencies_hz[:1]), {})


def closed_form(
    scene: Scene, frequencies_hz: tuple[float, ...], width: int, height: int
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.complex128]]:
    """Phasors (H, W, F), radial depth (H, W, 0 on background) and direct return (H, W, F).

    The scene's first object is a point; an empty corner has none.
    """
    camera, wall = scene.camera, scene.relay_wall
    axes, origin = camera_axes(camera), np.array(camera.location_m)
    normal, point = wall_normal(wall), np.array(wall.location_m)
    direct = direct_phasors(
        *(width, height, camera.horizontal_fov_deg, frequencies_hz, axes, origin, point, normal)
    )
    if not scene.hidden_objects:
        return direct, np.zeros((height, width)), direct
    rays = pixel_rays(width, height, camera.horizontal_fov_deg) @ axes  # (H, W, 3) in the world
    to_wall_m = ((point - origin) @ normal) / (rays @ normal)  # (H, W)
    on_wall = origin + rays * to_wall_m[..., None]  # (H, W, 3)
    hidden_point = np.array(scene.hidden_objects[0].location_m)
    leg_m = np.linalg.norm(on_wall - hidden_point, axis=-1)  # (H, W)
    outward_m = 2 * np.linalg.norm(origin - hidden_point)  # the same for all pixels
    opl_m = outward_m + leg_m + to_wall_m  # (H, W) to the object and back by the wall
    strength = HIDDEN_FRACTION * np.abs(direct[..., :1]) / leg_m[..., None] ** 2
    phasor = direct + strength * np.exp(1j * opl_m[..., None] * phase_per_metre(frequencies_hz))

    mirrored_point = hidden_point - 2 * ((hidden_point - point) @ normal) * normal
    towards = mirrored_point - origin
    distance_m = np.linalg.norm(towards)
    radius_m = DISC_RADIUS_M
    on_disc = rays @ (towards / distance_m) > distance_m / np.hypot(distance_m, radius_m)
    return phasor, np.where(on_disc, distance_m, 0.0), direct


def edit_image(path, **changes) -> None:
    """Rewrite some channels of an EXR image; names with dots are given with underscores."""
    image = read_image(path)
    channels = dict(image.channels)
    for name, change in changes.items():
        channels[name.replace("_", ".")] = change(channels[name.replace("_", ".")].copy())
    write_image(path, channels, {})
