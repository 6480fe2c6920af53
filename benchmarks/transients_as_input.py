"""Does it matter for training where phasors and ground truth come from?

Three networks for each seed, with the same settings and scenes: trained on the exact phasors that the
renderer sums, on the phasors of the rendered transients (the measurement matrix Φ applied to the bins, as in
the paper), and on exact phasors with the simulated ground truth. The scenes must be rendered with transients.
Networks are judged by the geometric truth, on the kind of phasors that they were trained on. Interrupted runs
continue.

    night-gen scenes mydata --preset paper
    night-render mydata --product both --resolution 40x30 --error 0.01 --workers 2
    .venv/bin/python benchmarks/transients_as_input.py mydata --out phi --width 16 --max-epochs 30 --seeds 3
"""

import argparse
import logging
import shutil
from pathlib import Path

from ablations import Row, judged, line

from itof.metrics import Summary
from model.data.shards import Shards, open_shards
from model.prediction.predictor import load
from model.settings.keys import merged
from model.settings.presets import training_preset
from model.settings.train_settings import settings_from_dict
from model.training.loop import train
from render.products.conversion import convert_to_itof
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, open_dataset

EXACT, PHI, SIMULATED = "exact phasors", "transients and Φ", "exact phasors, simulated ground truth"


def main() -> None:
    """Convert the scenes, train and judge the networks that are not finished, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, help="rendered with --product both")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the converted dataset and the runs"
    )
    parser.add_argument("--preset", default="default", help="training preset, default: default")
    parser.add_argument("--width", type=int, default=16, help="channels of the first level, default 16")
    parser.add_argument("--max-epochs", type=int, default=30, help="default 30")
    parser.add_argument("--seeds", type=int, default=3, help="runs per row, default 3")
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    exact = open_dataset(given.dataset)
    converted = with_phasors_of_transients(exact, given.out / "converted")
    base = training_preset(given.preset)[0]
    epochs = {"max_epochs": given.max_epochs, "patience": given.max_epochs}
    base = merged(base, {"network": {"width": given.width}, "run": epochs})
    results: dict[str, list[Summary]] = {EXACT: [], PHI: [], SIMULATED: []}
    for seed in range(given.seeds):
        for name, dataset in ((EXACT, exact), (PHI, converted), (SIMULATED, exact)):
            truth = {"ground_truth": "simulated"} if name == SIMULATED else {}
            settings = settings_from_dict(merged(base, {"run": truth | {"seed": seed}}), name)
            out = given.out / f"{list(results).index(name)}-{seed}"
            train(dataset, out, settings, resume=(out / "run.json").is_file())
            shards = open_shards(dataset)
            results[name].append(judged(load(out), shards, shards.rows("test")))
            print(line(Row(None, name), results[name]), flush=True)
    print_table(open_shards(exact), results)


def with_phasors_of_transients(dataset: Dataset, folder: Path) -> Dataset:
    """A dataset of the same scenes whose phasors are those of the transients; made if it is missing."""
    if not (folder / "dataset.json").is_file():
        shutil.copytree(dataset.root, folder, ignore=shutil.ignore_patterns("renders", "shards"))
    copy = open_dataset(folder)
    for scene_id in dataset.ids():
        there = copy.render_folder(scene_id)
        if not (there / MEASUREMENT_FILE).is_file():
            there.mkdir(parents=True, exist_ok=True)
            shutil.copy(dataset.render_folder(scene_id) / GROUND_TRUTH_FILE, there)
            convert_to_itof(dataset, scene_id, there).rename(there / MEASUREMENT_FILE)
    return copy


def print_table(shards: Shards, results: dict[str, list[Summary]]) -> None:
    """Print the table as Markdown."""
    size = f"{shards.manifest.width} x {shards.manifest.height}"
    print(
        f"\n{len(shards.rows('train'))} training and {len(shards.rows('test'))} test scenes, {size} pixels\n"
    )
    print("| | MAE cm | mIoU | |\n|---|---|---|---|")
    for name, summaries in results.items():
        print(line(Row(None, name), summaries))


if __name__ == "__main__":
    main()
