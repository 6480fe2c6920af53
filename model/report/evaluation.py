"""Evaluation: a trained network against the truth of a split, as numbers, pictures, points and a page."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from itof import join_components, phasor_of_return
from model.data.feed import Feed
from model.data.rows import RowBlock
from model.data.shards import Shards, open_shards
from model.network.metrics import summarise
from model.network.readout import Readout
from model.prediction.figures import DepthView
from model.prediction.pointclouds import object_points, write_point_cloud
from model.prediction.predictor import BATCH, Prediction, Predictor, load
from model.report.calibration import SWEEP, Calibration, ThresholdSweep, reread
from model.report.groups import group_tables
from model.report.page import write_page
from model.report.report_files import is_report, write_files
from model.report.results import Report
from model.report.scene_result import SceneResult, judge_scene
from model.report.showcase import ShownScene, choose
from model.settings import DeviceName
from scenegen import Dataset, NightError, Split, whole_folder

_log = logging.getLogger(__name__)


class EvaluationError(NightError):
    """A dataset that a run cannot be evaluated on, or a report folder that holds something else."""


@dataclass(frozen=True)
class _Bench:
    """All that is judged together: a network, how its output is read, and the scenes."""

    predictor: Predictor
    readout: Readout
    dataset: Dataset
    shards: Shards
    progress: bool

    @property
    def fov_deg(self) -> float:
        return self.dataset.preset.camera.horizontal_fov_deg

    def predictions(self, split: Split) -> Iterator[tuple[RowBlock, Prediction]]:
        """Batches of a split and what the network says of them."""
        rows = self.shards.rows(split)
        feed: Feed[RowBlock] = Feed(self.shards, rows, window_rows=0)  # seen once: a piece at a time will do
        with tqdm(total=len(rows), desc=split, unit="scene", disable=not self.progress or None) as bar:
            for block in feed.in_order(BATCH):
                yield block, self.predict(block)
                bar.update(len(block))

    def predict(self, block: RowBlock) -> Prediction:
        """What the network says of some rows, at the frequencies it was trained at."""
        used = self.predictor.config.inputs.places(self.shards.manifest.frequencies_hz)
        prediction = self.predictor.predict(
            block.complex_phasors()[..., used], self.shards.reference[..., used]
        )
        if self.readout == self.predictor.config.readout:
            return prediction
        return reread(prediction, self.readout)


def evaluate(
    run: Path,
    dataset: Dataset,
    out: Path,
    *,
    split: Split = "test",
    device: DeviceName = "auto",
    progress: bool = True,
    mask_threshold: float | None = None,
) -> Report:
    """Judge the best weights of `run` on one split and write everything to the folder `out`.

    ``index.html`` (the report to look at, complete in itself), ``metrics.json``, ``metrics.csv`` (one line a
    scene), ``table.txt``, ``summary.md``, ``figures/`` (best, median and worst scene; the page's charts) and
    ``pointclouds/<id>_gt.ply``, ``<id>_pred.ply`` (none where no pixel shows an object).
    The folder appears whole or not at all; an earlier report there is replaced.

    Parameters
    ----------
    mask_threshold : amplitude from which on a pixel shows the object; None for the run's own.

    Raises
    ------
    EvaluationError : no scenes in the split, images the run was not trained for, a threshold that is not
        positive, or an `out` that holds anything but an earlier report.
    RunError, DeviceError, ShardError, ImageFileError : an unusable run, device or dataset.
    DatasetError, PresetError : scenes whose description is missing or damaged.
    """
    out = out.resolve()  # a whole folder needs a name, which "." has not
    _refuse_other_contents(out)
    if mask_threshold is not None and not (math.isfinite(mask_threshold) and mask_threshold > 0):
        raise EvaluationError(f"a mask threshold is an amplitude above 0, got {mask_threshold:g}")
    predictor = load(run, device)
    _refuse_missing_split(dataset, split)
    shards = open_shards(dataset, progress=progress)
    _refuse_other_images(predictor, shards, run, dataset)
    own = predictor.config.readout
    readout = own if mask_threshold is None else replace(own, mask_threshold=mask_threshold)
    bench = _Bench(predictor, readout, dataset, shards, progress)
    with whole_folder(out) as folder:
        report = _judge_split(bench, split, folder)
        shown = _showcase(bench, report)
        write_files(folder, report, _origin(bench, run))
        write_page(folder, report, shown, run, predictor.config, _origin(bench, run))
    return report


def _judge_split(bench: _Bench, split: Split, folder: Path) -> Report:
    """Metrics of every scene of a split; their point clouds are written on the way."""
    run_threshold, threshold = bench.predictor.config.readout.mask_threshold, bench.readout.mask_threshold
    thresholds = (*SWEEP, run_threshold, threshold)
    sweep = ThresholdSweep(split, thresholds, bench.readout)
    results: list[SceneResult] = []
    clouds = folder / "pointclouds"
    clouds.mkdir()
    for block, predictions in bench.predictions(split):
        sweep.add(predictions.phasor, block.radial_depth_m, block.mask)
        for index, scene in enumerate(bench.shards.ids(block.rows)):
            truth_m, mask = block.radial_depth_m[index], block.mask[index]
            prediction = _one(predictions, index)
            results.append(judge_scene(bench.dataset.scene(scene), prediction, truth_m, mask))
            views = {"gt": (truth_m, mask), "pred": (prediction.radial_depth_m, prediction.mask)}
            _write_clouds(clouds, scene, views, bench.fov_deg)
    if not results:
        raise EvaluationError(
            f"no scene of the {split} split of {bench.dataset.root} could be rendered: "
            "see night-render --status"
        )
    judged = sweep.curve()
    validation = judged if split == "validation" else None
    if validation is None and bench.shards.rows("validation"):
        other = ThresholdSweep("validation", thresholds, bench.readout)
        for block, predictions in bench.predictions("validation"):
            other.add(predictions.phasor, block.radial_depth_m, block.mask)
        validation = other.curve()
    location = bench.dataset.preset.hidden_object.location_m
    return Report(
        split=split,
        scenes=tuple(results),
        prediction=summarise([r.prediction for r in results]),
        no_object=summarise([r.no_object for r in results]),
        groups=group_tables(results, (location.x, location.y, location.z)),
        calibration=Calibration(run_threshold, threshold, judged, validation),
    )


def _showcase(bench: _Bench, report: Report) -> list[ShownScene]:
    """The best, the median and the worst scene by accuracy, seen once more."""
    rows = {scene.id: row for row, scene in enumerate(bench.shards.manifest.scenes)}
    shown = []
    for rank, result in choose(report.ranked).items():
        block = bench.shards.read([rows[result.scene]])
        prediction = _one(bench.predict(block), 0)
        truth_m, mask = block.radial_depth_m[0], block.mask[0] > 0
        shown.append(
            ShownScene(
                rank,
                result,
                DepthView(_true_phasor(bench, block), truth_m, mask),
                DepthView(prediction.phasor, prediction.radial_depth_m, prediction.mask),
                object_points(truth_m, mask, bench.fov_deg),
                object_points(prediction.radial_depth_m, prediction.mask, bench.fov_deg),
            )
        )
    return shown


def _true_phasor(bench: _Bench, block: RowBlock) -> NDArray[np.complexfloating]:
    """(H, W) phasor of the block's first mirrored scene, at the frequency that the network predicts."""
    frequency_hz = bench.readout.frequency_hz
    if frequency_hz == bench.shards.manifest.frequencies_hz[0]:
        return join_components(np.moveaxis(block.target[0], 0, -1))[..., 0]
    return (block.mask[0] > 0) * phasor_of_return(block.radial_depth_m[0], frequency_hz)


def _origin(bench: _Bench, run: Path) -> dict[str, Any]:
    """What was judged on what, as plain data."""
    manifest = bench.shards.manifest
    return {
        "run": str(run.resolve()),
        "dataset": str(bench.dataset.root.resolve()),
        "data_sha256": manifest.data_sha256,
        "image_size": [manifest.width, manifest.height],
    }


def _refuse_other_contents(out: Path) -> None:
    """Refuse to replace anything but an empty folder or an earlier report."""
    if not out.exists():
        return
    if not out.is_dir():
        raise EvaluationError(f"{out} is a file: give the report a folder of its own")
    if any(out.iterdir()) and not is_report(out):
        raise EvaluationError(
            f"{out} is not empty and holds other things than an earlier report: choose another folder"
        )


def _refuse_missing_split(dataset: Dataset, split: Split) -> None:
    if not dataset.ids(split):
        present = sorted({entry.split for entry in dataset.index.scenes})
        raise EvaluationError(
            f"{dataset.root} has no {split} split: its {len(dataset.ids())} scenes are "
            f"{' and '.join(present)}; choose another split or make more scenes"
        )


def _refuse_other_images(predictor: Predictor, shards: Shards, run: Path, dataset: Dataset) -> None:
    trained, given = predictor.config, shards.manifest
    if (trained.image_width, trained.image_height) != (given.width, given.height):
        raise EvaluationError(
            f"wrong resolution between stages: {run} was trained on {trained.image_width}x"
            f"{trained.image_height} pixels, {dataset.root} is rendered at {given.width}x{given.height}; "
            "render it at the run's resolution or train again"
        )
    if not {*trained.inputs.frequencies_hz} <= {*given.frequencies_hz}:
        raise EvaluationError(
            f"{run} was trained at {[f / 1e6 for f in trained.inputs.frequencies_hz]} MHz, {dataset.root} "
            f"holds {[f / 1e6 for f in given.frequencies_hz]} MHz: train again or make the dataset again"
        )


def _one(predictions: Prediction, index: int) -> Prediction:
    return Prediction(predictions.radial_depth_m[index], predictions.mask[index], predictions.phasor[index])


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
