"""Ablations of the paper and of the input channels: train and evaluate every row of the table.

Each row has a preset in data/training. Its own keys, without the preset that it extends, are applied to
--preset. Interrupted runs continue and finished runs are only evaluated, so the table can be made in steps.
Run, for all rows or for those of the paper (its Table 2, the loss that it tried, and its baseline):

    .venv/bin/python benchmarks/ablations.py mydata --out ablations --width 16 --max-epochs 30
    .venv/bin/python benchmarks/ablations.py mydata --out table2 --rows paper --preset paper --seeds 3
"""

import argparse
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, stdev

import numpy as np
from numpy.typing import NDArray

from disk import read_settings
from itof.metrics import Summary, image_metrics, no_object_metrics, summarise
from model.data.feed import Feed
from model.data.shards import Shards, open_shards
from model.prediction.predictor import Predictor, load
from model.settings.keys import merged, tables
from model.settings.presets import training_preset
from model.settings.train_settings import TrainSettings, settings_from_dict
from model.training.loop import train
from scenegen import open_dataset

BATCH = 16
Change = Callable[[NDArray[np.complex64]], NDArray[np.complexfloating]]


@dataclass(frozen=True)
class Row:
    """A row of the table: its preset, its label, and the MAE in cm and the mIoU of the paper."""

    preset: str | None
    words: str
    paper: str = ""


PAPER_ROWS = (
    Row(None, "base", "5.21 / 0.77"),
    Row("ablation-20mhz", "20 MHz alone", "6.15 / 0.74"),
    Row("ablation-50mhz", "50 MHz alone", "10.33 / 0.68"),
    Row("ablation-60mhz", "60 MHz alone", "9.43 / 0.69"),
    Row("ablation-mae", "loss: MAE", "5.83 / 0.76"),
    Row("ablation-mse", "loss: MSE", "13.72 / 0.66"),
    Row("ablation-mse-iou", "loss: MSE and IoU", "5.93 / 0.77"),
    Row("ablation-mae-iou", "loss: MAE and IoU", "5.21 / 0.77"),
    Row("ablation-mae-lovasz", "loss: MAE and Lovász", "worse; no number"),
    Row("ablation-direct-depth", "depth predicted directly", "poor; no number"),
)
ROWS = (
    *PAPER_ROWS,
    Row("ablation-components", "error of the components"),
    Row("ablation-depth", "error of the depth"),
    Row("ablation-paper-channels", "channels: the paper's seven", "5.21 / 0.77"),
    Row("ablation-residual", "channels: residual alone"),
    Row("ablation-paper-residual", "channels: both"),
)


def main() -> None:
    """Train and evaluate the rows that are not finished, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument(
        "--preset", default="known-wall", help="preset that all rows are applied to, default: known-wall"
    )
    parser.add_argument("--width", type=int, help="channels of the first level, default from --preset")
    parser.add_argument("--max-epochs", type=int, help="default from --preset")
    parser.add_argument("--learning-rate", type=float, help="default from --preset")
    parser.add_argument("--schedule", help="of the learning rate, default from --preset")
    parser.add_argument("--seeds", type=int, default=1, help="runs per row, default 1")
    parser.add_argument("--rows", choices=["all", "paper"], default="all", help="paper: those that it names")
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    dataset = open_dataset(given.dataset)
    shards = open_shards(dataset)
    changes = {
        "network.width": given.width,
        "run.max_epochs": given.max_epochs,
        "run.patience": given.max_epochs,
        "optimiser.learning_rate": given.learning_rate,
        "optimiser.schedule": given.schedule,
    }
    rows = PAPER_ROWS if given.rows == "paper" else ROWS
    own = tables({key: value for key, value in changes.items() if value})
    base = merged(training_preset(given.preset)[0], own)
    done: dict[TrainSettings, Path] = {}
    results: dict[Row, list[Summary]] = {row: [] for row in rows}
    for seed in range(given.seeds):
        for row in rows:
            settings = settings_from_dict(
                merged(merged(base, own_keys(row)), {"run": {"seed": seed}}), str(row.preset)
            )
            out = given.out / f"{row.preset or 'base'}-{seed}"
            if settings not in done:  # several rows have the settings of the base
                done[settings] = out
                train(dataset, out, settings, resume=(out / "run.json").is_file())
            results[row].append(judged(load(done[settings]), shards, shards.rows("test")))
            print(line(row, results[row]), flush=True)
    print_table(shards, results)


def own_keys(row: Row) -> dict[str, object]:
    """Keys in the preset of the row, without those of the preset that it extends."""
    keys = read_settings("training", row.preset)[0] if row.preset else {}
    keys.pop("extends", None)
    return keys


def judged(
    predictor: Predictor, shards: Shards, rows: Sequence[int], change: Change = lambda phasors: phasors
) -> Summary:
    """Metrics of scenes whose phasors (n, H, W, F) went through `change`."""
    places = predictor.config.inputs.places(shards.manifest.frequencies_hz)
    feed = Feed(shards, rows, window_rows=0)
    metrics = []
    for block in feed.in_order(BATCH):
        found = predictor.predict(
            change(block.phasors[..., places]),
            fields_of_view_deg=shards.fields_of_view_deg(block.rows),
        )
        images = zip(found.radial_depth_m, found.mask, block.radial_depth_m, block.mask, strict=True)
        metrics += [image_metrics(*image) for image in images]
    return summarise(metrics)


def cells(*found: Summary) -> str:
    """MAE in cm, mIoU and MAE on the object in cm, as cells of a table; of several seeds `over_seeds`."""
    maes, mious = [100 * each.depth_mae_m.mean for each in found], [each.miou.mean for each in found]
    on_object = [100 * each.object_mae_m.mean for each in found if each.object_mae_m]
    object_words = over_seeds(on_object, 2) if on_object else "-"
    return f"{over_seeds(maes, 2)} | {over_seeds(mious, 3)} | {object_words}"


def print_table(shards: Shards, results: dict[Row, list[Summary]]) -> None:
    """Print the table as Markdown; the last row is the prediction that there is no object."""
    rows = shards.rows("test")
    block = shards.read(rows)
    pairs = zip(block.radial_depth_m, block.mask, strict=True)
    nothing = summarise([no_object_metrics(*pair) for pair in pairs])
    size = f"{shards.manifest.width} x {shards.manifest.height}"
    print(f"\n{len(shards.rows('train'))} training and {len(rows)} test scenes, {size} pixels\n")
    print("| | MAE cm | mIoU | paper: MAE cm / mIoU |\n|---|---|---|---|")
    for row, summaries in results.items():
        print(line(row, summaries))
    print(line(Row(None, "no object at all"), [nothing]))


def line(row: Row, summaries: list[Summary]) -> str:
    """A row of the table: the mean over seeds and, if there are several, their standard deviation."""
    maes, mious = [100 * s.depth_mae_m.mean for s in summaries], [s.miou.mean for s in summaries]
    return f"| {row.words} | {over_seeds(maes, 2)} | {over_seeds(mious, 3)} | {row.paper} |"


def over_seeds(values: Sequence[float], digits: int) -> str:
    """Mean of the values of several seeds and, if there are several, their standard deviation."""
    spread = f" ± {stdev(values):.{digits}f}" if len(values) > 1 else ""
    return f"{mean(values):.{digits}f}{spread}"


if __name__ == "__main__":
    main()
