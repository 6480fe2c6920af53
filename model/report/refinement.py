"""A network's depth maps before and after refinement by rendering, judged on a split of a dataset."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass
from scipy.spatial.transform import Rotation

from itof import DepthMap
from model.data.shards import open_shards
from model.network.metrics import ImageMetrics, image_metrics
from model.network.wall_view import WallView, wall_view
from model.prediction.predictor import load
from model.refinement.refining import ACCEPTED, Family, Refined, refined
from model.refinement.room import Room, room_of
from model.refinement.solids import KIND_OF_SHAPE
from model.report.judging import Bench
from model.report.refined_figure import MOST_SCENES, write_refined_figure
from model.report.refined_result import FoundSolid, RefinedScene, RefinementReport, SceneNumbers
from model.report.refusals import EvaluationError, refuse_missing_split, refuse_other_images
from model.run_folder.shipped import run_folder
from model.settings import DeviceName
from scenegen import Dataset, PathLike, Split, whole_file, write_text
from scenegen.contract import STRICT, Vector
from scenegen.progress import showing_progress

Unknown = Literal["sizes", "reflectance"]
RECIPE_FILE, RESULT_FILE, SCENES_FOLDER = "recipe.json", "refined.json", "scenes"
TABLE_FILE, FIGURE_FILE = "refined.csv", "refined.png"


@checked_dataclass(frozen=True, config=STRICT)
class Recipe:
    """What results depend on; only results of the same recipe are kept."""

    run_id: str | None
    data_sha256: str
    split: Split
    unknown: tuple[Unknown, ...]
    largest_misfit: float
    schema_version: Literal[1] = 1


def refine_split(
    run: PathLike,
    dataset: Dataset,
    out: PathLike,
    *,
    split: Split = "test",
    unknown: Sequence[Unknown] = (),
    largest_misfit: float = ACCEPTED,
    device: DeviceName = "auto",
    progress: bool = True,
) -> RefinementReport:
    """Refine the predictions of a run on a split, and compare both with the ground truth.

    ``scenes/<id>.json`` and ``scenes/<id>.exr`` hold each scene's result and its refined depth map,
    ``refined.csv`` and ``refined.json`` all numbers, ``refined.png`` the first twelve scenes. What an
    interrupted command has finished is kept.

    Parameters
    ----------
    unknown : what of the object is fitted, too: its extents (from those of the preset), its reflectance. The
        preset has what is not fitted.
    largest_misfit : a fit that leaves a larger part of the hidden light unexplained is not accepted.

    Raises
    ------
    EvaluationError : the split has no scenes, the run was trained for other images, each scene has its camera
        elsewhere, the preset has no shape that can be fitted, or `out` holds results of another recipe.
    RunError, DeviceError, ShardError : as `model.evaluate`.
    """
    if not (math.isfinite(largest_misfit) and largest_misfit > 0):
        raise EvaluationError(f"the largest misfit is a share above 0, got {largest_misfit:g}")
    run, out = run_folder(run), Path(out).resolve()
    refuse_missing_split(dataset, split)
    fitted = tuple(sorted(set(unknown)))
    family = _family(dataset, fitted)
    predictor = load(run, device)
    shards = open_shards(dataset, progress=progress)
    refuse_other_images(predictor.config, shards, run, dataset)
    rows = shards.rows(split)
    if not rows:
        raise EvaluationError(
            f"no scene of the {split} split of {dataset.root} could be rendered: see night-render status"
        )
    recipe = Recipe(predictor.config.run_id, shards.manifest.data_sha256, split, fitted, largest_misfit)
    _prepare(out, recipe)
    view = wall_view(dataset)
    bench = Bench(predictor.at(view), predictor.config.readout, dataset, shards, progress)
    work = _Work(bench, view, room_of(dataset), family, largest_misfit, out)
    results = []
    with showing_progress(len(rows), "scene", "refine", show=progress) as bar:
        for row, scene in zip(rows, shards.ids(rows), strict=True):
            results.append(_read_result(out, scene) or work.result(row, scene))
            bar.update(1)
    report = RefinementReport(tuple(results))
    _write_table(out / TABLE_FILE, report.scenes)
    write_refined_figure(out / FIGURE_FILE, [work.shown(row) for row in rows[:MOST_SCENES]])
    write_text(out / RESULT_FILE, json.dumps({**asdict(recipe), **report.as_data()}, indent=2) + "\n")
    return report


@dataclass(frozen=True)
class _Work:
    """What the scenes of a split have in common."""

    bench: Bench
    view: WallView
    room: Room
    family: Family
    largest_misfit: float
    out: Path

    def result(self, row: int, scene: str) -> RefinedScene:
        """Predict, refine and judge one scene, and write its files."""
        bench = self.bench
        block = bench.shards.read([row])
        frequencies_hz = bench.predictor.config.inputs.frequencies_hz
        used = bench.predictor.config.inputs.places(bench.shards.manifest.frequencies_hz)
        wall = self.view.expected_wall(bench.shards.reference[..., used], frequencies_hz)
        prediction = bench.predict(block)[0]
        phasor = block.complex_phasors()[0][..., used]
        entry = bench.dataset.scene(scene)
        found = refined(phasor, prediction, wall, self.room, self.family, seed=entry.seed)
        accepted = found is not None and found.misfit <= self.largest_misfit
        better = found.depth_map if found is not None and accepted else prediction
        truth = block.radial_depth_m[0], block.mask[0]
        result = RefinedScene(
            scene,
            entry.object_class,
            _numbers(image_metrics(prediction.radial_depth_m, prediction.mask, *truth)),
            _numbers(image_metrics(better.radial_depth_m, better.mask, *truth)),
            accepted,
            None if found is None else found.misfit,
            None if found is None else self._in_world(found),
            None if found is None else found.reflectance,
            None if found is None else found.roughness,
        )
        self._write(result, better)
        return result

    def shown(self, row: int) -> tuple[str, DepthMap, DepthMap, DepthMap]:
        """Name of a finished scene, and the depth maps of truth, network and refinement."""
        block = self.bench.shards.read([row])
        (scene,) = self.bench.shards.ids([row])
        prediction = self.bench.predict(block)[0]
        truth = DepthMap.of_object(block.radial_depth_m[0], block.mask[0] > 0, prediction.frequency_hz)
        better = DepthMap.read(self.out / SCENES_FOLDER / f"{scene}.exr")
        name = f"{scene} {self.bench.dataset.scene(scene).object_class.replace('_', ' ')}"
        return name, truth, prediction, better

    def _in_world(self, found: Refined) -> FoundSolid:
        axes = np.asarray(self.view.camera_axes)
        location_m = np.asarray(self.view.camera_location_m) + found.solid.centre_m @ axes
        turned = Rotation.from_matrix(axes.T @ found.solid.axes)
        with_limits = turned.as_euler("xyz", degrees=True)
        return FoundSolid(found.solid.shape, found.solid.size_m, _vector(location_m), _vector(with_limits))

    def _write(self, result: RefinedScene, better: DepthMap) -> None:
        folder = self.out / SCENES_FOLDER
        better.write(folder / f"{result.scene}.exr", {"scene_id": result.scene})
        write_text(folder / f"{result.scene}.json", json.dumps(asdict(result), indent=1) + "\n")


def _family(dataset: Dataset, fitted: Sequence[Unknown]) -> Family:
    """What the hidden objects of a dataset may be."""
    if not dataset.preset.is_one_corner:
        raise EvaluationError(
            f"each scene of {dataset.root} has its camera elsewhere (camera_spread): "
            "refinement needs one corner"
        )
    hidden = dataset.preset.hidden_object
    known = {shape: hidden.size_m.of(shape) for shape in hidden.shapes if shape in KIND_OF_SHAPE}
    if not known:
        raise EvaluationError(
            f"{dataset.root} has none of the shapes that can be fitted: {', '.join(KIND_OF_SHAPE)}"
        )
    return Family(known, "sizes" in fitted, None if "reflectance" in fitted else hidden.reflectance)


def _prepare(out: Path, recipe: Recipe) -> None:
    """Make the folder, or see that its results are of the same recipe."""
    file = out / RECIPE_FILE
    if file.exists():
        try:
            earlier = TypeAdapter(Recipe).validate_json(file.read_text(encoding="utf-8"))
        except (OSError, ValueError, ValidationError):
            earlier = None
        if earlier != recipe:
            raise EvaluationError(
                f"{out} holds results of another run, dataset or options: choose another --out, or delete it"
            )
        return
    if out.exists() and any(out.iterdir()):
        raise EvaluationError(f"{out} holds other files: choose another --out")
    (out / SCENES_FOLDER).mkdir(parents=True, exist_ok=True)
    write_text(file, json.dumps(asdict(recipe), indent=2) + "\n")


def _read_result(out: Path, scene: str) -> RefinedScene | None:
    """The result of a scene that an earlier command has finished; None if there is none, or it is damaged."""
    folder = out / SCENES_FOLDER
    try:
        text = (folder / f"{scene}.json").read_text(encoding="utf-8")
        result = TypeAdapter(RefinedScene).validate_json(text)
        DepthMap.read(folder / f"{scene}.exr")
    except (OSError, ValueError):
        return None
    return result if result.scene == scene else None


def _write_table(file: Path, scenes: Sequence[RefinedScene]) -> None:
    rows = [
        {
            "scene": scene.scene,
            "object_class": scene.object_class,
            "shape": scene.solid.shape if scene.solid else "",
            "misfit": scene.misfit,
            "accepted": scene.accepted,
            **{f"network_{key}": value for key, value in asdict(scene.network).items()},
            **{f"refined_{key}": value for key, value in asdict(scene.refined).items()},
        }
        for scene in scenes
    ]
    with whole_file(file) as partial, partial.open("w", newline="") as stream:
        table = csv.DictWriter(stream, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def _numbers(metrics: ImageMetrics) -> SceneNumbers:
    return SceneNumbers(**asdict(metrics))


def _vector(values: Any) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
