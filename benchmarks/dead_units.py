"""How many units of a network are dead: 0 in every pixel of every image, so that they learn nothing.

Counts the units of each level of the U-Net, on the first test scenes of a dataset. Run:

    .venv/bin/python benchmarks/dead_units.py night-80x60 --judge new80
"""

import argparse
from pathlib import Path

import torch

from model.data.shards import Shards, open_shards
from model.network.dead_units import dead_units
from model.run_folder.run_config import read_config
from model.run_folder.shipped import run_folder
from model.run_folder.weights import trained_network
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
    every = [dead_of(run, shards, rows) for run in given.runs]
    parts = sorted({layer.rpartition(".")[0] for dead in every for layer in dead}, key=_place)
    names = (part.replace(".", " ") for part in parts)
    print(f"| dead units of {len(rows)} scenes | {' | '.join(names)} | all |\n{'|---' * (len(parts) + 2)}|")
    for run, dead in zip(given.runs, every, strict=True):
        groups = [[dead[layer] for layer in dead if layer.startswith(f"{part}.")] for part in parts]
        counts = [_count(group) for group in (*groups, list(dead.values()))]
        print(f"| {Path(run).name} | {' | '.join(counts)} |")


def _place(part: str) -> tuple[bool, int]:
    """Sort key of a part, as encoder.3: the encoder comes first."""
    name, _, number = part.partition(".")
    return name != "encoder", int(number)


def _count(dead: list[torch.Tensor]) -> str:
    """Dead units of some layers; a network with fewer levels has none of them."""
    return f"{sum(int(each.sum()) for each in dead)} of {sum(map(len, dead))}" if dead else "-"


def dead_of(run: str, shards: Shards, rows: list[int]) -> dict[str, torch.Tensor]:
    """The dead units of the layers of a run."""
    folder = run_folder(Path(run))
    config = read_config(folder)
    network, _ = trained_network(folder, config)
    return dead_units(network, rendered_channels(config, shards, rows))


if __name__ == "__main__":
    main()
