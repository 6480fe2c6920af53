"""How much of the hidden light the depth maps of a network explain, of good measurements and of spoilt ones.

A spoilt one has the phasors of another scene at one frequency, or rows of its lower half shifted by a pixel,
or is an empty corner with noise. Run:

    .venv/bin/python benchmarks/explained_light.py night-80x60 DATASET
"""

import argparse
from pathlib import Path

import numpy as np

from model.data.corner import wall_view
from model.data.feed import Feed
from model.data.shards import open_shards
from model.prediction.predictor import load
from scenegen import open_dataset

QUANTILES = (0.01, 0.05, 0.5)
NOISES = (3e-4, 1e-3, 3e-3)  # of each pixel's amplitude


def main() -> None:
    """Print quantiles of the explained share for each kind of measurement."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=100, help="test scenes, default 100")
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    predictor, shards = load(given.run).at(wall_view(dataset)), open_shards(dataset)
    rows = shards.rows("test")[: given.scenes]
    (block,) = Feed(shards, rows, window_rows=0).in_order(len(rows))
    z = block.phasors[..., predictor.config.inputs.places(shards.manifest.frequencies_hz)]
    other, half, rng = np.roll(z, 1, axis=0), z.shape[1] // 2, np.random.default_rng(0)
    kinds = {
        "good": z,
        "the first frequency of another scene": np.concatenate([other[..., :1], z[..., 1:]], axis=-1),
        "the last frequency of another scene": np.concatenate([z[..., :-1], other[..., -1:]], axis=-1),
        "lower half shifted": np.concatenate([z[:, :half], np.roll(z[:, half:], 1, axis=2)], axis=1),
    }
    for noise in NOISES:
        re, im = rng.standard_normal((2, *z.shape)) / np.sqrt(2)
        grain = 1 + noise * (re + 1j * im)
        kinds[f"good, noise {noise:g}"] = z * grain
        kinds[f"empty, noise {noise:g}"] = predictor.wall.direct * grain
    print(
        "| measurement | with an object | hidden by noise | explained: 1 %, 5 %, median | light, per mille |"
    )
    print("|---|---|---|---|---|")
    for name, images in kinds.items():
        found = predictor.predict(images)
        lights = predictor.explained_light(images, found)
        shares = [light.share for light in lights if light is not None and light.share is not None]
        told = ", ".join(f"{each:.2f}" for each in np.quantile(shares, QUANTILES)) if shares else ""
        has = int(found.mask.any(axis=(1, 2)).sum())
        strength = 1e3 * np.median([light.strength for light in lights if light is not None])
        print(f"| {name} | {has} | {len(images) - len(shares)} | {told} | {strength:.2g} |", flush=True)


if __name__ == "__main__":
    main()
