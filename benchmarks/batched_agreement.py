"""Compare ``batched`` with the renders of ``many-light``: errors of the hidden phasors, masks, scale, time.

The dataset is rendered by ``many-light`` with a small error. Errors are norms over an image and all
frequencies, over that of the hidden phasors. Run:

    night-gen scenes judged --preset judge-any-corner --count 105 --seed 4242
    night-render judged --product itof --method many-light --error 0.005 --resolution 80x60
    .venv/bin/python benchmarks/batched_agreement.py judged
"""

import argparse
import time
from pathlib import Path

import numpy as np

from itof import DepthMap, read_image
from render.batch.light import BatchedLight, LightImages
from render.batch.scene_meshes import with_own_meshes
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset
from scenegen.scene_folder import read_scene_folder


def main() -> None:
    """Print a line for each wanted error."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--errors", type=float, nargs="+", default=[0.04, 0.01], help="default 0.04 0.01")
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    reference = dataset.rendering.options["error"]
    direct, hidden, masks = renders(dataset)
    size = hidden.shape[2], hidden.shape[1]
    scenes, meshes = [], {}
    for scene_id in dataset.ids():
        files = read_scene_folder(dataset.scene_folder(scene_id))
        scene, own = with_own_meshes(dataset.scene(scene_id), files)
        scenes.append(scene)
        meshes |= own
    print(f"{len(scenes)} scenes, {size[0]}x{size[1]}, many-light at {reference:.1%}")
    print("| wanted | median | 90 % | 95 % | largest | within | bound holds | scale | mask differs | ms |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for wanted in given.errors:
        light = BatchedLight(dataset.preset.itof.frequencies_hz, *size, error=wanted, meshes=meshes)
        light.images(scenes)  # compiles the kernels
        began = time.perf_counter()
        images = light.images(scenes)
        milliseconds = 1e3 * (time.perf_counter() - began) / len(scenes)
        errors, scales = compared(images, hidden)
        edges = np.linalg.norm((images.direct - direct).reshape(len(scenes), -1), axis=1)
        quantiles = " | ".join(f"{value:.2%}" for value in np.quantile(errors, [0.5, 0.9, 0.95, 1]))
        within = (errors <= np.hypot(wanted, reference)).mean()
        holds = (errors <= np.hypot(images.error, reference)).mean()
        differing = np.count_nonzero((images.radial_depth_m > 0) != masks)
        print(
            f"| {wanted:.1%} | {quantiles} | {within:.0%} | {holds:.0%} | {scales.mean():.4f} | {differing} "
            f"| {milliseconds:.1f} |",
            flush=True,
        )
    shares = edges / np.linalg.norm(hidden.reshape(len(scenes), -1), axis=1)
    print(f"direct return, over the hidden part: median {np.median(shares):.2%}, largest {shares.max():.2%}")


def renders(dataset: Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, H, W, F) direct and hidden phasors of all scenes, and (N, H, W) masks of the ground truth."""
    folders = [dataset.render_folder(scene_id) for scene_id in dataset.ids()]
    images = [read_image(folder / MEASUREMENT_FILE) for folder in folders]
    truths = [DepthMap.of_image(read_image(folder / GROUND_TRUTH_FILE)) for folder in folders]
    direct, hidden = (np.stack([image.phasors(part)[0] for image in images]) for part in ("direct", "hidden"))
    return direct, hidden, np.stack([truth.mask for truth in truths])


def compared(images: LightImages, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) errors of the hidden phasors, and the scales that make them most like the reference."""
    found, expected = (each.reshape(len(hidden), -1) for each in (images.hidden, hidden))
    power = (np.abs(expected) ** 2).sum(1)
    errors = np.sqrt((np.abs(found - expected) ** 2).sum(1) / power)
    return errors, (expected.conj() * found).sum(1).real / power


if __name__ == "__main__":
    main()
