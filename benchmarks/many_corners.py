r"""One corner or many: every network judged on the test scenes of every dataset.

The fit of a network starts at the wall of the dataset, or, where each scene has its camera elsewhere, at that
of the camera in the middle. Run:

    .venv/bin/python benchmarks/many_corners.py one many many-wall --judge judge judge-any outside
"""

import argparse
from pathlib import Path

from ablations import cells, judged

from model.data.shards import Shards, open_shards
from model.network.metrics import no_object_metrics, summarise
from model.network.wall_view import wall_view
from model.prediction.predictor import load
from scenegen import open_dataset


def main() -> None:
    """Judge each network on each dataset."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, nargs="+", help="run folders")
    parser.add_argument(
        "--judge", type=Path, nargs="+", required=True, help="datasets whose test scenes judge"
    )
    given = parser.parse_args()
    predictors = [load(run) for run in given.runs]
    print("| network | judged on | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|")
    for folder in given.judge:
        dataset = open_dataset(folder)
        shards, corner = open_shards(dataset), wall_view(dataset)
        rows = shards.rows("test")
        for run, predictor in zip(given.runs, predictors, strict=True):
            found = judged(predictor.at(corner), shards, rows)
            print(f"| {run.name} | {folder.name} | {cells(found)} |", flush=True)
        print(f"| no object | {folder.name} | {nothing(shards)} |", flush=True)


def nothing(shards: Shards) -> str:
    """The cells of the prediction that there is no object."""
    block = shards.read(shards.rows("test"))
    pairs = zip(block.radial_depth_m, block.mask, strict=True)
    return cells(summarise([no_object_metrics(*pair) for pair in pairs]))


if __name__ == "__main__":
    main()
