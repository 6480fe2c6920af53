"""Comparison of a network's predictions with the ground truth of a split."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from itof import DepthMap, phasor_of_return
from itof.metrics import summarise
from itof.pictures.pointclouds import (
    TRUTH_COLOUR,
    distance_colours,
    distances_m,
    object_points,
    write_point_cloud,
)
from model.data.feed import Feed
from model.data.rows import RowBlock
from model.data.shards import Shards
from model.judging.calibration import SWEEP, Calibration, ThresholdCurve, ThresholdSweep, reread
from model.judging.groups import group_tables
from model.judging.reliability import DepthReliabilityCount, ReliabilityCount
from model.judging.results import Report
from model.judging.scene_result import SceneResult, judge_scene
from model.judging.scene_sheet import SceneSheet
from model.judging.showcase import ShownScene
from model.network.readout import Readout
from model.prediction.explained_light import ExplainedLight
from model.prediction.predictor import BATCH, Predictor
from processes.progress import showing_progress
from scenegen import Dataset, Split
from scenegen.corner_geometry import corners_of
from scenegen.pose import camera_axes

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Bench:
    """A network, the readout of its output, and the scenes on which it is judged."""

    predictor: Predictor
    readout: Readout
    dataset: Dataset
    shards: Shards
    progress: bool

    @property
    def thresholds(self) -> tuple[float, ...]:
        """Mask thresholds of the calibration: the sweep, the run's own and the one in use."""
        return (*SWEEP, self.predictor.config.readout.mask_threshold, self.readout.mask_threshold)

    def predictions(self, split: Split) -> Iterator[tuple[RowBlock, DepthMap]]:
        """Batches of a split with their predictions."""
        rows = self.shards.rows(split)
        feed = Feed(self.shards, rows, window_rows=0)  # rows are used once, so one piece at a time suffices
        with showing_progress(len(rows), "scene", split, show=self.progress) as bar:
            for block in feed.in_order(BATCH):
                yield block, self.predict(block)
                bar.update(len(block))

    def predict(self, block: RowBlock) -> DepthMap:
        """Predictions of rows, from the frequencies of the training."""
        prediction = self.predictor.predict(block.phasors[..., self._used], **self._seen(block))
        if self.readout == self.predictor.config.readout:
            return prediction
        return reread(prediction, self.readout)

    def lights(self, block: RowBlock, predictions: DepthMap) -> tuple[ExplainedLight | None, ...]:
        """What the predictions of rows explain of their light."""
        images = block.phasors[..., self._used]
        return self.predictor.explained_light(images, predictions, **self._seen(block))

    def _seen(self, block: RowBlock) -> dict[str, Any]:
        """The reference of rows, or their fields of view."""
        fields_of_view_deg = self.shards.fields_of_view_deg(block.rows)
        if fields_of_view_deg:
            return {"fields_of_view_deg": fields_of_view_deg}
        return {"reference": self.shards.reference[..., self._used]}

    @property
    def _used(self) -> list[int]:
        """Places of the training's frequencies."""
        return self.predictor.config.inputs.places(self.shards.manifest.frequencies_hz)


def judge_split(bench: Bench, split: Split, clouds: Path) -> tuple[Report, SceneSheet]:
    """Metrics of every scene of a split, and their pictures; point clouds are written to the folder `clouds`.

    Raises
    ------
    EvaluationError : no scene of the split is rendered.
    """
    sweep = ThresholdSweep(split, bench.thresholds, bench.readout)
    reliability, depth_reliability = ReliabilityCount(), DepthReliabilityCount()
    has_probability = bench.predictor.config.settings.predicts_probability
    results: list[SceneResult] = []
    sheet = SceneSheet(len(bench.shards.rows(split)))
    for block, predictions in bench.predictions(split):
        sweep.add(predictions.phasor, block.radial_depth_m, block.mask)
        reliability.add(predictions.phasor, block.mask)
        depth_reliability.add(predictions, block.radial_depth_m, block.mask)
        lights = bench.lights(block, predictions)
        for index, name in enumerate(bench.shards.ids(block.rows)):
            scene = bench.dataset.scene(name)
            truth_m, mask = block.radial_depth_m[index], block.mask[index]
            prediction, fov_deg = predictions[index], scene.camera.horizontal_fov_deg
            result = judge_scene(
                scene, prediction, truth_m, mask, lights[index], has_probability=has_probability
            )
            results.append(result)
            truth = DepthMap.of_object(truth_m, mask > 0, bench.readout.frequency_hz)
            sheet.add(name, truth, prediction)
            points_gt_m = object_points(truth_m, mask, fov_deg)
            points_pred_m = object_points(prediction.radial_depth_m, prediction.mask, fov_deg)
            _write_clouds(clouds, name, points_gt_m, points_pred_m)
    bare = sum(r.roundness_pred is None for r in results), sum(r.roundness_gt is None for r in results)
    if any(bare):
        _log.info("no object, so no point cloud: in %d predictions and %d true images", *bare)
    location = bench.dataset.preset.places_m
    report = Report(
        split=split,
        scenes=tuple(results),
        prediction=summarise([r.prediction for r in results]),
        no_object=summarise([r.no_object for r in results]),
        groups=group_tables(results, (location.x, location.y, location.z)),
        calibration=_calibration(bench, sweep.curve()),
        reliability=reliability.curve() if has_probability else None,
        depth_reliability=depth_reliability.curve(),
        frame_rate_hz=bench.dataset.preset.dataset.frame_rate_hz,
    )
    return report, sheet


def _calibration(bench: Bench, judged: ThresholdCurve) -> Calibration:
    """The sweep of the judged split, and of the validation split if there is one."""
    validation = judged if judged.split == "validation" else None
    if validation is None and bench.shards.rows("validation"):
        sweep = ThresholdSweep("validation", bench.thresholds, bench.readout)
        for block, predictions in bench.predictions("validation"):
            sweep.add(predictions.phasor, block.radial_depth_m, block.mask)
        validation = sweep.curve()
    return Calibration(bench.predictor.config.readout, bench.readout, judged, validation)


def shown_scenes(bench: Bench, chosen: Mapping[str, SceneResult]) -> Iterator[ShownScene]:
    """Scenes by rank, predicted again, one at a time."""
    rows = {scene.id: row for row, scene in enumerate(bench.shards.manifest.scenes)}
    for rank, result in chosen.items():
        block = bench.shards.read([rows[result.scene]])
        prediction = bench.predict(block)[0]
        truth_m, mask = block.radial_depth_m[0], block.mask[0] > 0
        scene = bench.dataset.scene(result.scene)
        camera, fov_deg = scene.camera, scene.camera.horizontal_fov_deg
        walls_m = np.stack([corners_of(wall) for wall in (scene.relay_wall, scene.middle_wall)])  # (2, 4, 3)
        yield ShownScene(
            rank,
            result,
            DepthMap(truth_m, mask, _true_phasor(bench, block), bench.readout.frequency_hz),
            prediction,
            object_points(truth_m, mask, fov_deg),
            object_points(prediction.radial_depth_m, prediction.mask, fov_deg),
            (walls_m - camera.location_m) @ camera_axes(camera).T,
        )


def _true_phasor(bench: Bench, block: RowBlock) -> NDArray[np.complexfloating]:
    """(H, W) true phasor of the first row of a block, at the frequency of the network's output."""
    frequency_hz = bench.readout.frequency_hz
    if frequency_hz == bench.shards.manifest.frequencies_hz[0]:
        true: NDArray[np.complex64] = block.target[0]
        return true
    return (block.mask[0] > 0) * phasor_of_return(block.radial_depth_m[0], frequency_hz)


def _write_clouds(
    folder: Path, scene: str, points_gt_m: NDArray[np.float32], points_pred_m: NDArray[np.float32]
) -> None:
    """Write the (n, 3) points of truth and prediction, if there are any, in the colours of the report."""
    distance_m = distances_m(points_pred_m, points_gt_m)
    views = {
        "gt": (points_gt_m, (255 * np.array(to_rgba(TRUTH_COLOUR))).round().astype(np.uint8)),
        "pred": (points_pred_m, distance_colours(distance_m)),
    }
    for name, (points_m, colours) in views.items():
        if len(points_m):
            write_point_cloud(folder / f"{scene}_{name}.ply", points_m, colours)
