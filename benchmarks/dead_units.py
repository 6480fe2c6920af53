"""How many units of a network are dead: 0 in every pixel of every image, so that they learn nothing.

Counts the units of each level of the U-Net, on the first test scenes of a dataset. Run:

    .venv/bin/python benchmarks/dead_units.py night-80x60 --judge new80
"""

import argparse
from pathlib import Path

import torch

from model.data.shards import Shards, open_shards
from model.network.dead_units import dead_units
from model.network.unet import LEVELS
from model.run_folder.run_config import read_config
from model.run_folder.shipped import run_folder
from model.run_folder.weights import load_weights
from model.training.rendered_channels import rendered_channels
from scenegen import open_dataset


def main() -> None:
    """Print a table with a row for each network."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", help="run folders, or names of networks that come with NIGHT")
    parser.add_argument("--judge", type=Path, required=True, help="dataset whose test scenes are looked at")
    parser.add_argument("--scenes", type=int, default=256, help="number of scenes (default: 256)")
    given = parser.parse_args()
    shards = open_shards(open_dataset(given.judge))
    rows = shards.rows("test")[: given.scenes]
    parts = [f"encoder {level}" for level in range(LEVELS)] + [f"decoder {n}" for n in range(LEVELS - 1)]
    print(f"| dead units of {len(rows)} scenes | {' | '.join(parts)} | all |\n{'|---' * (len(parts) + 2)}|")
    for run in given.runs:
        dead = dead_of(run, shards, rows)
        levels = [torch.cat([dead[f"{part.replace(' ', '.')}.{n}"] for n in (0, 2)]) for part in parts]
        counts = [f"{int(each.sum())} of {len(each)}" for each in (*levels, torch.cat(levels))]
        print(f"| {Path(run).name} | {' | '.join(counts)} |", flush=True)


def dead_of(run: str, shards: Shards, rows: list[int]) -> dict[str, torch.Tensor]:
    """The dead units of the layers of a run."""
    folder = run_folder(Path(run))
    config = read_config(folder)
    network = config.network()
    load_weights(folder, network, config)
    return dead_units(network, rendered_channels(config, shards, rows))


if __name__ == "__main__":
    main()
