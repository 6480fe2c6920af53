r"""Every network judged on the test scenes of every dataset.

The fit of the wall starts at the wall of the dataset, or, where each scene has its camera elsewhere, at that
of the camera in the middle. Run:

    .venv/bin/python benchmarks/compare_networks.py one phases-0 wall-0 --judge judge judge-any outside

With --over-seeds, runs whose names differ only in the number after the last hyphen are one row:

    .venv/bin/python benchmarks/compare_networks.py images-0 images-1 none-0 none-1 --judge judge --over-seeds
"""

import argparse
import re
from itertools import groupby
from pathlib import Path

from ablations import cells, judged

from itof.metrics import no_object_metrics, summarise
from model.data.corner import wall_view
from model.data.shards import Shards, open_shards
from model.prediction.predictor import load
from scenegen import open_dataset


def main() -> None:
    """Judge each network on each dataset."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="run folders")
    parser.add_argument(
        "--judge", type=Path, nargs="+", required=True, help="datasets whose test scenes judge"
    )
    parser.add_argument("--over-seeds", action="store_true", help="one row for the runs of several seeds")
    given = parser.parse_args()
    predictors = {run: load(run) for run in given.runs}
    print("| network | judged on | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|")
    for folder in given.judge:
        dataset = open_dataset(folder)
        shards, corner = open_shards(dataset), wall_view(dataset)
        rows = shards.rows("test")
        for name, runs in groupby(given.runs, without_seed if given.over_seeds else str):
            found = [judged(predictors[run].at(corner), shards, rows) for run in runs]
            count = f", mean of {len(found)}" if given.over_seeds else ""
            print(f"| {name}{count} | {folder.name} | {cells(*found)} |", flush=True)
        print(f"| no object | {folder.name} | {nothing(shards)} |", flush=True)


def without_seed(run: Path) -> str:
    """Its path without the seed, the number after the last hyphen."""
    return re.sub(r"-\d+$", "", str(run))


def nothing(shards: Shards) -> str:
    """The cells of the prediction that there is no object."""
    block = shards.read(shards.rows("test"))
    pairs = zip(block.radial_depth_m, block.mask, strict=True)
    return cells(summarise([no_object_metrics(*pair) for pair in pairs]))


if __name__ == "__main__":
    main()
