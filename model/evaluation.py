"""Evaluation: a trained network against the truth of a split, as numbers, pictures and point clouds."""

from __future__ import annotations

import csv
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from itof import join_components
from model.feed import Feed
from model.figures import DepthView, accuracy_histogram, comparison_figure, write_figure
from model.metrics import ImageMetrics, Statistics, Summary, image_metrics, no_object_metrics, summarise
from model.pointclouds import object_points, write_point_cloud
from model.prediction import BATCH, Prediction, Predictor, load_run
from model.settings import DeviceName
from model.shards import Shards, open_shards
from scenegen import Dataset, SceneEntry, Split, whole_file, whole_folder, write_text

REPORT_SCHEMA = 1
REPORT_ENTRIES = frozenset({"metrics.json", "metrics.csv", "table.txt", "figures", "pointclouds"})
PAPER = {
    "source": "Caligiuri et al. 2024 (arXiv 2403.19376), on their own data set",
    "depth_mae_m": {"mean": 0.0521, "std": 0.0284, "min": 0.0114, "max": 0.1870},
    "miou": {"mean": 0.77, "std": 0.12, "min": 0.48, "max": 0.95},
}
_log = logging.getLogger(__name__)


class EvaluationError(ValueError):
    """A dataset that a run cannot be evaluated on, or a report folder that holds something else."""


@dataclass(frozen=True)
class SceneResult:
    """Metrics of one scene, of the prediction and of the "no object" baseline."""

    scene: str
    object_class: str
    prediction: ImageMetrics
    no_object: ImageMetrics


@dataclass(frozen=True)
class Report:
    """Outcome of an evaluation; `table` is for people."""

    split: Split
    scenes: tuple[SceneResult, ...]
    prediction: Summary
    no_object: Summary

    @property
    def table(self) -> str:
        """The summary as text, baseline and paper beside it."""
        return _table(self)


def evaluate(
    run: Path,
    dataset: Dataset,
    out: Path,
    *,
    split: Split = "test",
    device: DeviceName = "auto",
    progress: bool = True,
) -> Report:
    """Judge the best weights of `run` on one split and write everything to the folder `out`.

    ``metrics.json``, ``metrics.csv`` (one line a scene), ``table.txt``, ``figures/`` (best, median and
    worst scene, histogram) and ``pointclouds/<id>_gt.ply``, ``<id>_pred.ply`` (none where no pixel shows an
    object).
    The folder appears whole or not at all; an earlier report there is replaced.

    Raises
    ------
    EvaluationError : no scenes in the split, images the run was not trained for, or an `out` that holds
        anything but an earlier report.
    RunError, DeviceError, ShardError, ImageFileError : an unusable run, device or dataset.
    """
    out = out.resolve()  # a whole folder needs a name, which "." has not
    _refuse_other_contents(out)
    predictor = load_run(run, device)
    if not dataset.ids(split):
        present = sorted({entry.split for entry in dataset.index.scenes})
        raise EvaluationError(
            f"{dataset.root} has no {split} split: its {len(dataset.ids())} scenes are "
            f"{' and '.join(present)}; choose another split or make more scenes"
        )
    shards = open_shards(dataset, progress=progress)
    _refuse_other_images(predictor, shards, run, dataset)
    with whole_folder(out) as folder:
        report = _judge_split(
            predictor, shards, split, folder, dataset.preset.camera.horizontal_fov_deg, progress
        )
        _write_figures(folder, report, predictor, shards)
        _write_numbers(folder, report, run, dataset, shards)
    return report


def _judge_split(
    predictor: Predictor, shards: Shards, split: Split, folder: Path, fov_deg: float, progress: bool
) -> Report:
    """Metrics of every scene of a split; their point clouds are written on the way."""
    rows = shards.rows(split)
    results: list[SceneResult] = []
    clouds = folder / "pointclouds"
    clouds.mkdir()
    feed = Feed(shards, rows, window_rows=0)  # seen once, so a piece at a time will do
    with tqdm(total=len(rows), desc=split, unit="scene", disable=not progress or None) as bar:
        for block in feed.in_order(BATCH):
            predictions = predictor.predict(block.complex_phasors(), shards.reference)
            for index, row in enumerate(block.rows):
                truth_m, mask = block.radial_depth_m[index], block.mask[index]
                prediction = _one(predictions, index)
                results.append(_judge(shards.manifest.scenes[row], prediction, truth_m, mask))
                views = {"gt": (truth_m, mask), "pred": (prediction.radial_depth_m, prediction.mask)}
                _write_clouds(clouds, shards.manifest.scenes[row].id, views, fov_deg)
            bar.update(len(block))
    return Report(
        split,
        tuple(results),
        summarise([r.prediction for r in results]),
        summarise([r.no_object for r in results]),
    )


def _refuse_other_contents(out: Path) -> None:
    """Refuse to replace anything but an empty folder or an earlier report."""
    if not out.exists():
        return
    if not out.is_dir():
        raise EvaluationError(f"{out} is a file: give the report a folder of its own")
    names = {entry.name for entry in out.iterdir()}
    try:
        content = json.loads((out / "metrics.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        content = None
    is_report = isinstance(content, dict) and content.get("schema_version") == REPORT_SCHEMA
    if names and not (is_report and names <= REPORT_ENTRIES):
        raise EvaluationError(
            f"{out} is not empty and holds other things than an earlier report: choose another folder"
        )


def _refuse_other_images(predictor: Predictor, shards: Shards, run: Path, dataset: Dataset) -> None:
    trained, given = predictor.config, shards.manifest
    if (trained.image_width, trained.image_height) != (given.width, given.height):
        raise EvaluationError(
            f"wrong resolution between stages: {run} was trained on {trained.image_width}x"
            f"{trained.image_height} pixels, {dataset.root} is rendered at {given.width}x{given.height}; "
            "render it at the run's resolution or train again"
        )
    if trained.inputs.frequencies_hz != given.frequencies_hz:
        raise EvaluationError(
            f"{run} was trained at {[f / 1e6 for f in trained.inputs.frequencies_hz]} MHz, {dataset.root} "
            f"holds {[f / 1e6 for f in given.frequencies_hz]} MHz: train again or make the dataset again"
        )


def _one(predictions: Prediction, index: int) -> Prediction:
    return Prediction(predictions.radial_depth_m[index], predictions.mask[index], predictions.phasor[index])


def _judge(
    scene: SceneEntry, prediction: Prediction, truth_m: NDArray[np.float32], mask: NDArray[np.uint8]
) -> SceneResult:
    return SceneResult(
        scene.id,
        scene.object_class,
        image_metrics(prediction.radial_depth_m, prediction.mask, truth_m, mask),
        no_object_metrics(truth_m, mask),
    )


def _write_clouds(
    folder: Path,
    scene: str,
    views: Mapping[str, tuple[NDArray[np.float32], NDArray[np.uint8] | NDArray[np.bool_]]],
    fov_deg: float,
) -> None:
    """Point clouds of the views of a scene, each a depth and a mask, where they show an object."""
    for name, (radial_depth_m, mask) in views.items():
        points_m = object_points(radial_depth_m, mask, fov_deg)
        if len(points_m):
            write_point_cloud(folder / f"{scene}_{name}.ply", points_m)
        else:
            _log.info("scene %s shows no object (%s): no point cloud", scene, name)


def _write_figures(out: Path, report: Report, predictor: Predictor, shards: Shards) -> None:
    """Comparison of the best, median and worst scene by accuracy, and the histogram of all."""
    ranked = sorted(report.scenes, key=lambda result: -result.prediction.accuracy)
    chosen = {"best": ranked[0], "median": ranked[(len(ranked) - 1) // 2], "worst": ranked[-1]}
    rows = {scene.id: row for row, scene in enumerate(shards.manifest.scenes)}
    folder = out / "figures"
    folder.mkdir()
    for name, result in chosen.items():
        block = shards.read([rows[result.scene]])
        prediction = predictor.predict(block.complex_phasors()[0], shards.reference)
        truth = DepthView(
            join_components(np.moveaxis(block.target[0], 0, -1))[..., 0],
            block.radial_depth_m[0],
            block.mask[0] > 0,
        )
        view = DepthView(prediction.phasor, prediction.radial_depth_m, prediction.mask)
        title = f"{name} of {len(ranked)} {report.split} scenes: {result.scene}, {result.object_class}"
        figure = comparison_figure(title, truth, view, result.prediction)
        write_figure(folder / f"{name}.png", figure)
    ours, nothing = [r.prediction for r in ranked], [r.no_object for r in ranked]
    write_figure(folder / "accuracy_histogram.png", accuracy_histogram(ours, nothing, report.split))


def _write_numbers(out: Path, report: Report, run: Path, dataset: Dataset, shards: Shards) -> None:
    content: dict[str, Any] = {
        "schema_version": REPORT_SCHEMA,
        "run": str(run),
        "dataset": str(dataset.root),
        "data_sha256": shards.manifest.data_sha256,
        "split": report.split,
        "scene_count": len(report.scenes),
        "image_size": [shards.manifest.width, shards.manifest.height],
        "depth": "radial (along the ray), metres; background counts with depth 0",
        "prediction": asdict(report.prediction),
        "no_object": asdict(report.no_object),
        "paper": PAPER,
        "scenes": [
            {"scene": r.scene, "object_class": r.object_class, **_numbers(r.prediction)}
            for r in report.scenes
        ],
    }
    write_text(out / "metrics.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
    write_text(out / "table.txt", report.table + "\n")
    with whole_file(out / "metrics.csv") as partial, partial.open("w", newline="") as stream:
        table = csv.DictWriter(stream, fieldnames=list(content["scenes"][0]))
        table.writeheader()
        table.writerows(content["scenes"])


def _numbers(metrics: ImageMetrics) -> dict[str, float | None]:
    return {**asdict(metrics), "miou": metrics.miou, "accuracy": metrics.accuracy}


def _table(report: Report) -> str:
    head = f"{report.split} split, {len(report.scenes)} scenes, radial depth"
    lines = [f"{head:<44}{'average':>9}{'std':>9}{'min':>9}{'max':>9}"]
    rows: Sequence[tuple[str, str, float]] = (
        ("MAE over all pixels, cm", "depth_mae_m", 100.0),
        ("MAE on the object, cm", "object_mae_m", 100.0),
        ("object IoU", "object_iou", 1.0),
        ("mIoU", "miou", 1.0),
        ("accuracy", "accuracy", 1.0),
    )
    for name, field, scale in rows:
        for who, summary in (("prediction", report.prediction), ("no object", report.no_object)):
            lines.append(_line(f"{name:<26}{who}", getattr(summary, field), scale))
        paper = PAPER.get(field)
        if isinstance(paper, dict):
            lines.append(_line(f"{name:<26}paper, own data", Statistics(**paper, count=0), scale))
    return "\n".join(lines)


def _line(name: str, statistics: Statistics | None, scale: float) -> str:
    if statistics is None:
        return f"{name:<44}{'-':>9}{'-':>9}{'-':>9}{'-':>9}"
    values = (statistics.mean, statistics.std, statistics.min, statistics.max)
    return f"{name:<44}" + "".join(f"{scale * value:9.3f}" for value in values)
