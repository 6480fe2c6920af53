"""Compare ``batched`` with the renders of ``many-light``: errors of the hidden phasors, masks, scale, time.

The dataset is rendered by ``many-light`` with a small error. Errors are norms over an image and all
frequencies, over that of the hidden phasors. Run:

    night-gen scenes judged --preset judge-any-corner --count 105 --seed 4242
    night-render judged --product itof --method many-light --error 0.005 --resolution 80x60
    .venv/bin/python benchmarks/batched_agreement.py judged

Of several datasets, all scenes count as one set.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from itof import DepthMap, read_image
from render.batch.light import SceneLight
from render.batch.scene_lights import SceneLights
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset
from scenegen.scene_folder import read_scene_folder

AT_ONCE = 105


def main() -> None:
    """Print a line for each wanted error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("datasets", type=Path, nargs="+", help="with the same size and frequencies")
    parser.add_argument("--errors", type=float, nargs="+", default=[0.04, 0.01], help="default 0.04 0.01")
    given = parser.parse_args()
    datasets = [open_dataset(folder) for folder in given.datasets]
    reference = max(dataset.rendering.options["error"] for dataset in datasets)
    direct, hidden, masks = (np.concatenate(each) for each in zip(*map(renders, datasets), strict=True))
    frequencies_hz, size = datasets[0].preset.itof.frequencies_hz, (hidden.shape[2], hidden.shape[1])
    scenes = [
        (dataset.scene(scene_id), read_scene_folder(dataset.scene_folder(scene_id)))
        for dataset in datasets
        for scene_id in dataset.ids()
    ]
    lit = norms(hidden) > 0  # without empty corners, which have no relative error
    direct, hidden, masks = direct[lit], hidden[lit], masks[lit]
    scenes = [scene for scene, is_lit in zip(scenes, lit, strict=True) if is_lit]
    print(f"{len(scenes)} scenes, {size[0]}x{size[1]}, many-light at {reference:.1%}")
    print("| wanted | median | 90 % | 95 % | largest | within | bound holds | scale | mask differs | ms |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for wanted in given.errors:
        engine = SceneLights(frequencies_hz, *size, error=wanted, device="auto")
        engine.of(scenes[:AT_ONCE])  # compiles the kernels
        began = time.perf_counter()
        lights = [light for part in parts(scenes) for light in rendered(engine, part)]
        milliseconds = 1e3 * (time.perf_counter() - began) / len(scenes)
        errors, scales = compared(np.stack([light.hidden for light in lights]), hidden)
        edges = np.stack([light.direct for light in lights]) - direct
        quantiles = " | ".join(f"{value:.2%}" for value in np.quantile(errors, [0.5, 0.9, 0.95, 1]))
        within = (errors <= np.hypot(wanted, reference)).mean()
        holds = (errors <= np.hypot([light.error for light in lights], reference)).mean()
        differing = np.count_nonzero((np.stack([light.radial_depth_m for light in lights]) > 0) != masks)
        print(
            f"| {wanted:.1%} | {quantiles} | {within:.0%} | {holds:.0%} | {scales.mean():.4f} | {differing} "
            f"| {milliseconds:.1f} |",
            flush=True,
        )
    shares = norms(edges) / norms(hidden)
    print(f"direct return, over the hidden part: median {np.median(shares):.2%}, largest {shares.max():.2%}")


def parts(scenes: list[Any]) -> list[list[Any]]:
    """The scenes as `night-render` takes them."""
    return [scenes[start : start + AT_ONCE] for start in range(0, len(scenes), AT_ONCE)]


def rendered(engine: SceneLights, scenes: list[Any]) -> list[SceneLight]:
    """The light of some scenes, whose ids may be those of scenes of another dataset."""
    numbered = [(replace(scene, index=number), files) for number, (scene, files) in enumerate(scenes)]
    lights = engine.of(numbered)
    return [lights[scene.id] for scene, _ in numbered]


def norms(images: np.ndarray) -> np.ndarray:
    """(N,) norms of images."""
    return np.linalg.norm(images.reshape(len(images), -1), axis=1)


def renders(dataset: Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, H, W, F) direct and hidden phasors of all scenes, and (N, H, W) masks of the ground truth."""
    folders = [dataset.render_folder(scene_id) for scene_id in dataset.ids()]
    images = [read_image(folder / MEASUREMENT_FILE) for folder in folders]
    truths = [DepthMap.of_image(read_image(folder / GROUND_TRUTH_FILE)) for folder in folders]
    direct, hidden = (np.stack([image.phasors(part)[0] for image in images]) for part in ("direct", "hidden"))
    return direct, hidden, np.stack([truth.mask for truth in truths])


def compared(found: np.ndarray, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) errors of the hidden phasors, and the scales that make them most like the reference."""
    found, expected = (each.reshape(len(hidden), -1) for each in (found, hidden))
    power = (np.abs(expected) ** 2).sum(1)
    errors = np.sqrt((np.abs(found - expected) ** 2).sum(1) / power)
    return errors, (expected.conj() * found).sum(1).real / power


if __name__ == "__main__":
    main()
