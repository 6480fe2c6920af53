"""A baseline without a network: the depth map of the most similar scene in a library of rendered scenes.

The scenes for training are the library. For each test scene, the scene of the library whose self-calibrated
residual channels are nearest (least squares over all pixels, channels of unit variance) gives its depth map
as the prediction. With --neighbours K, a pixel shows the object if at least half of the K nearest scenes do,
at the median of their depths. What is found is a scene of the library, so its error says how densely the
library samples shapes and poses.

Run:

    .venv/bin/python benchmarks/library_baseline.py mydata --judge newdata --counts 1000 4000
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from ablations import cells
from torch import Tensor

from itof.metrics import image_metrics, summarise
from itof.wall.wall_view import WallView
from model.data.batches import BatchMaker
from model.data.channel_scaling import fit_input_spec
from model.data.corner import wall_view
from model.data.shards import Shards, open_shards
from model.network.channels import InputSpec
from scenegen import open_dataset

READ_AT_ONCE = 64


def main() -> None:
    """Print a table with one line for each size of the library and number of neighbours."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, help="its training scenes are the library")
    parser.add_argument("--judge", type=Path, required=True, help="dataset whose test scenes judge")
    parser.add_argument("--counts", type=int, nargs="+", required=True, help="sizes of the library")
    parser.add_argument("--neighbours", type=int, nargs="+", default=[1, 5], help="default: 1 and 5")
    given = parser.parse_args()
    dataset, judge_data = open_dataset(given.dataset), open_dataset(given.judge)
    if not (dataset.preset.is_one_corner and judge_data.preset.is_one_corner):
        raise SystemExit("the library is that of one corner, and a dataset has many (camera_spread)")
    unseen = open_shards(judge_data)
    shards, view = open_shards(dataset), wall_view(dataset)
    library = shards.rows("train")[: max(given.counts)]
    spec = fit_input_spec("residual", shards, library[:READ_AT_ONCE], reference="self", view=view)
    maker, judge = (_maker(spec, each, view) for each in (shards, unseen))
    known = _channels(maker, shards, library)  # (N, values)
    rows = unseen.rows("test")
    wanted = _channels(judge, unseen, rows)  # (n, values)
    distances = torch.cdist(wanted, known)  # (n, N)
    truth, candidates = unseen.read(rows), shards.read(library)
    print("| scenes in the library | neighbours | MAE cm | mIoU | object MAE cm |\n|---|---|---|---|---|")
    for count in given.counts:
        for neighbours in given.neighbours:
            nearest = distances[:, :count].topk(neighbours, largest=False).indices.numpy()  # (n, K)
            depths_m, masks = candidates.radial_depth_m[nearest], candidates.mask[nearest] > 0
            mask = masks.mean(axis=1) >= 0.5  # (n, H, W)
            some_m = np.ma.median(np.ma.array(depths_m, mask=~masks), axis=1).filled(0)
            metrics = [
                image_metrics(*image)
                for image in zip(mask * some_m, mask, truth.radial_depth_m, truth.mask, strict=True)
            ]
            print(f"| {count} | {neighbours} | {cells(summarise(metrics))} |", flush=True)


def _maker(spec: InputSpec, shards: Shards, view: WallView) -> BatchMaker:
    frequencies_hz = shards.manifest.frequencies_hz
    wall = view.expected_wall(shards.reference, frequencies_hz)
    return BatchMaker.for_shards(spec, frequencies_hz, wall, torch.device("cpu"))


def _channels(maker: BatchMaker, shards: Shards, rows: Sequence[int]) -> Tensor:
    """(n, values) residual channels of rows, all pixels in one row."""
    parts = []
    for start in range(0, len(rows), READ_AT_ONCE):
        block = maker.upload(shards.read(rows[start : start + READ_AT_ONCE]))
        parts.append(maker.batch(block).channels.flatten(1))
    return torch.cat(parts)


if __name__ == "__main__":
    main()
