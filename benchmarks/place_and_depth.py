"""What a network has learnt of place and depth: correlations of predicted and true objects over test scenes.

A network that draws the same object in every scene has none; one that finds the object, but not its distance,
has those of the place. Run:

    .venv/bin/python benchmarks/place_and_depth.py paper80 both80 --judge data80
"""

import argparse
from pathlib import Path

import numpy as np
from ablations import BATCH
from numpy.typing import NDArray

from model.data.feed import Feed
from model.data.shards import Shards, open_shards
from model.prediction.predictor import Predictor, load
from scenegen import open_dataset

Floats = NDArray[np.float64]


def main() -> None:
    """Print a row for each network."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", help="run folders, or names of networks that come with NIGHT")
    parser.add_argument("--judge", type=Path, required=True, help="dataset whose test scenes judge")
    given = parser.parse_args()
    shards = open_shards(open_dataset(given.judge))
    print(
        "| | scenes | across | down | depth | predicted depths scatter by, cm | true ones, cm |\n"
        "|---|---|---|---|---|---|---|"
    )
    for run in given.runs:
        predicted, true = means(load(run), shards)  # (S, 3) each
        kept = np.isfinite(predicted).all(axis=1) & np.isfinite(true).all(axis=1)
        pairs = zip(predicted[kept].T, true[kept].T, strict=True)
        found = [f"{np.corrcoef(pair)[0, 1]:.2f}" for pair in pairs]
        scatter = [f"{100 * each[kept, 2].std():.1f}" for each in (predicted, true)]
        print("| " + " | ".join([Path(run).name, str(kept.sum()), *found, *scatter]) + " |", flush=True)


def means(predictor: Predictor, shards: Shards) -> tuple[Floats, Floats]:
    """Mean column, row and radial depth in metres of predicted and true objects; NaN without an object."""
    places = predictor.config.inputs.places(shards.manifest.frequencies_hz)
    predicted, true = [], []
    for block in Feed(shards, shards.rows("test"), window_rows=0).in_order(BATCH):
        found = predictor.predict(
            block.phasors[..., places], fields_of_view_deg=shards.fields_of_view_deg(block.rows)
        )
        predicted += [middle(*image) for image in zip(found.radial_depth_m, found.mask, strict=True)]
        true += [middle(*image) for image in zip(block.radial_depth_m, block.mask > 0, strict=True)]
    return np.array(predicted), np.array(true)


def middle(depth_m: Floats, mask: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Mean column, row and depth of the object in one image."""
    if not mask.any():
        return np.nan, np.nan, np.nan
    rows, columns = np.nonzero(mask)
    return float(columns.mean()), float(rows.mean()), float(depth_m[mask].mean())


if __name__ == "__main__":
    main()
