"""What an ensemble of networks would gain: the mean of their mirrored phasors, judged as a single network is.

The amplitude of a mirrored phasor is the probability of the object, so that a network that is sure of a pixel
has more say in its depth. All runs must have been trained for the same image size. Run:

    .venv/bin/python benchmarks/ensemble.py run-0 run-1 run-2 --judge data40
"""

import argparse
from pathlib import Path

import numpy as np
from ablations import BATCH, cells, judged

from itof import depth_from_phase, phase
from itof.metrics import Summary, image_metrics, summarise
from model.data.corner import wall_view
from model.data.feed import Feed
from model.data.shards import Shards, open_shards
from model.prediction.predictor import Predictor, load
from scenegen import open_dataset


def main() -> None:
    """Judge each network and all of them together."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", help="run folders, or names of networks that come with NIGHT")
    parser.add_argument(
        "--judge", type=Path, nargs="+", required=True, help="datasets whose test scenes judge"
    )
    given = parser.parse_args()
    print("| | judged on | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|")
    for folder in given.judge:
        dataset = open_dataset(folder)
        shards, corner = open_shards(dataset), wall_view(dataset)
        predictors = [load(run).at(corner) for run in given.runs]
        rows = shards.rows("test")
        for run, predictor in zip(given.runs, predictors, strict=True):
            found = judged(predictor, shards, rows)
            print(f"| {Path(run).name} | {folder.name} | {cells(found)} |", flush=True)
        print(f"| all {len(predictors)} | {folder.name} | {cells(together(predictors, shards, rows))} |")


def together(predictors: list[Predictor], shards: Shards, rows: list[int]) -> Summary:
    """Metrics of the mean of the networks' phasors."""
    metrics = []
    for block in Feed(shards, rows, window_rows=0).in_order(BATCH):
        found = [
            predictor.predict(
                block.phasors[..., predictor.config.inputs.places(shards.manifest.frequencies_hz)],
                fields_of_view_deg=shards.fields_of_view_deg(block.rows),
            )
            for predictor in predictors
        ]
        mean = np.mean([each.phasor for each in found], axis=0)  # (n, H, W)
        mask = np.abs(mean) >= predictors[0].config.readout.mask_threshold
        depth_m = np.where(mask, depth_from_phase(phase(mean), found[0].frequency_hz), 0.0)
        metrics += [
            image_metrics(*image)
            for image in zip(depth_m, mask, block.radial_depth_m, block.mask, strict=True)
        ]
    return summarise(metrics)


if __name__ == "__main__":
    main()
