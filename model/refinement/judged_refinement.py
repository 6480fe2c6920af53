"""A network's depth maps before and after refinement by rendering, judged on a split of a dataset."""

from __future__ import annotations

import csv
import json
import logging
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from pydantic import TypeAdapter

from disk import PathLike, is_partial, whole_file, write_text
from disk.inner_paths import inside
from disk.plain_file import read_text
from model.judging.judged_split import open_split
from model.judging.refusals import EvaluationError
from model.prediction.predictor import load
from model.refinement.family import Family, family_of, refuse_misfit
from model.refinement.figures import MOST_SCENES, write_refined_figure
from model.refinement.refined_result import RefinedScene, RefinementReport
from model.refinement.settings import LARGEST_MISFIT, Unknown
from model.refinement.work import SCENES_FOLDER, Job, Recipe, read_result, worked
from model.run_folder.shipped import run_folder
from model.settings.run import DeviceName
from processes.progress import showing_progress
from scenegen import Dataset, Preset, Split

_log = logging.getLogger(__name__)

RECIPE_FILE, RESULT_FILE = "recipe.json", "refined.json"
TABLE_FILE, FIGURE_FILE = "refined.csv", "refined.png"
_OF_FOUND = ("misfit", "noise", "difference_m")  # columns of the table


def refine_split(
    run: PathLike,
    dataset: Dataset,
    out: PathLike,
    *,
    split: Split = "test",
    objects: Preset | None = None,
    unknown: Sequence[Unknown] = (),
    largest_misfit: float = LARGEST_MISFIT,
    workers: int = 1,
    force: bool = False,
    device: DeviceName = "auto",
    progress: bool = True,
) -> RefinementReport:
    """Refine the predictions of a run on a split, and compare both with the ground truth.

    ``scenes/<id>.json`` and ``scenes/<id>.exr`` hold each scene's result and its refined depth map,
    ``refined.csv`` and ``refined.json`` all numbers, ``refined.png`` the first twelve scenes. What an
    interrupted command has finished is kept.

    Parameters
    ----------
    objects : a preset with the shapes, extents and reflectance of what may be there; None for that of the
        dataset. A dataset of measurements (`render.write_pairs`) has none.
    unknown : what of the object is fitted, too: its extents (from those of `objects`), its reflectance.
    largest_misfit : what is accepted; see `model.refinement.refining.Refined.is_right`.
    workers : number of processes; the results do not depend on it.
    force : as in `model.evaluate`.

    Raises
    ------
    EvaluationError : the split has no scenes, the run was trained for other images or needs one corner,
        `objects` has no shape that can be fitted or is missing for measurements, `out` holds results of
        another recipe, or a worker process was killed.
    RunError, DeviceError, ShardError : as `model.evaluate`.
    """
    if workers < 1:
        raise EvaluationError(f"the number of workers is at least 1, got {workers}")
    refuse_misfit(largest_misfit)
    run, out = run_folder(run), Path(out).resolve()
    fitted = tuple(sorted(set(unknown)))
    family = _family(dataset, objects, fitted)
    predictor = load(run, device)
    config = predictor.config
    shards, rows, unlike = open_split(config, run, dataset, split, force=force, progress=progress)
    for sentence in unlike:
        _log.warning("warning: %s", sentence)
    recipe = Recipe(
        predictor.config.run_id,
        predictor.weights_sha256,
        shards.manifest.data_sha256,
        split,
        dict(family.sizes),
        family.reflectance,
        family.apart_m,
        fitted,
        largest_misfit,
    )
    _prepare(out, recipe)
    job = Job(run, dataset.root, device, family, recipe, out)
    work = job.begun(predictor, dataset, shards)
    scenes = shards.ids(rows)
    results = {scene: found for scene in scenes if (found := read_result(out, scene)) is not None}
    missing = [(row, scene) for row, scene in zip(rows, scenes, strict=True) if scene not in results]
    with showing_progress(len(rows), "scene", "refine", initial=len(results), show=progress) as bar:
        for result in worked(job, work, missing, workers):
            results[result.scene] = result
            bar.update(1)
    report = RefinementReport(tuple(results[scene] for scene in scenes))
    _write_table(out / TABLE_FILE, report.scenes)
    write_text(out / RESULT_FILE, json.dumps({**asdict(recipe), **report.as_data()}, indent=2) + "\n")
    write_refined_figure(out / FIGURE_FILE, [work.shown(row) for row in rows[:MOST_SCENES]])
    return report


def _family(dataset: Dataset, objects: Preset | None, fitted: Sequence[Unknown]) -> Family:
    """What the hidden objects of a dataset may be."""
    if objects is None and dataset.is_measured:
        raise EvaluationError(
            f"{dataset.root} holds measurements and does not say what may be there: give a preset with the "
            "shapes and sizes, --objects PRESET"
        )
    return family_of(dataset.preset if objects is None else objects, fitted)


def _prepare(out: Path, recipe: Recipe) -> None:
    """Make the folder, or see that its results are of the same recipe."""
    file = out / RECIPE_FILE
    if file.exists():
        try:
            earlier = TypeAdapter(Recipe).validate_json(read_text(file))
        except (OSError, ValueError):
            earlier = None
        if earlier is None:
            raise EvaluationError(
                f"{file} is damaged, or another version of NIGHT wrote it: choose another --out, or delete "
                f"{out}"
            )
        if earlier != recipe:
            raise EvaluationError(
                f"{out} holds results of another run, of its earlier weights, of another dataset or of other "
                "options: choose another --out, or delete it"
            )
    else:
        if out.exists() and not all(is_partial(each.name) for each in out.iterdir()):
            raise EvaluationError(f"{out} holds other files: choose another --out")
        write_text(file, json.dumps(asdict(recipe), indent=2) + "\n")
    inside(out, SCENES_FOLDER).mkdir(exist_ok=True)


def _write_table(file: Path, scenes: Sequence[RefinedScene]) -> None:
    rows = [
        {
            "scene": scene.scene,
            "object_class": scene.object_class,
            "shape": " + ".join(solid.shape for solid in scene.found.solids) if scene.found else "",
            **{name: getattr(scene.found, name, None) for name in _OF_FOUND},
            "expected_mae_m": scene.expected_mae_m,
            "accepted": scene.accepted,
            **{f"network_{key}": value for key, value in asdict(scene.network).items()},
            **{f"refined_{key}": value for key, value in asdict(scene.refined).items()},
        }
        for scene in scenes
    ]
    with (
        whole_file(file) as partial,
        partial.open("w", encoding="utf-8", newline="", errors="backslashreplace") as stream,
    ):
        table = csv.DictWriter(stream, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)
