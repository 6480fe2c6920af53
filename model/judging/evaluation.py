"""Evaluation of a trained network on a split of a dataset; writes the report folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from disk import PathLike, sha256_of, whole_folder
from disk.extras import need
from model.judging.judged_split import open_split, seeing
from model.judging.judging import Bench, judge_split, shown_scenes
from model.judging.refusals import (
    EvaluationError,
    refuse_other_contents,
    refuse_other_masks,
    refuse_scenes_not_shown,
    refuse_scenes_without_render,
)
from model.judging.report_files import write_files
from model.judging.results import Report
from model.judging.showcase import choose, choose_for_figures
from model.prediction.predictor import Predictor, load
from model.run_folder.history import read_history
from model.run_folder.shipped import run_folder
from model.run_folder.weights import WEIGHTS_FILE
from model.settings.run import DeviceName
from model.settings.target import MaskSource
from scenegen import Dataset, Split

_TRIES = 3  # to read weights and history of a run that goes on


def evaluate(
    run: PathLike,
    dataset: Dataset,
    out: PathLike,
    *,
    split: Split = "test",
    device: DeviceName = "auto",
    progress: bool = True,
    mask_threshold: float | None = None,
    mask_from: MaskSource | None = None,
    scenes: Sequence[str] = (),
    force: bool = False,
) -> Report:
    """Judge the best weights of `run` on a split and write the report folder `out`.

    ==================  ======================================================================================
    ``index.html``      the report page; it needs no other file
    ``metrics.json``    all numbers
    ``metrics.csv``     one line for each scene
    ``table.txt``       summary as text
    ``summary.md``      summary as Markdown
    ``tables.tex``      all tables as LaTeX
    ``references.bib``  what to cite, for BibTeX
    ``figures/``        pictures of scenes: ``best``, ``median``, ``worst``, and several in ``scenes`` and
                        ``point_clouds``; charts of the page; each as ``.png`` and ``.pdf``
    ``film.gif``        truth beside prediction over time; of a sequence only
    ``pointclouds/``    ``<id>_gt.ply`` (blue) and ``<id>_pred.ply`` (green to red by distance from the
                        truth); missing if no pixel shows an object
    ==================  ======================================================================================

    The folder is written whole or not at all and replaces an earlier report. It is not replaced if it has got
    other files since, or if one of its files was changed.

    Parameters
    ----------
    run : run folder of the trained network.
    mask_threshold : a pixel shows the object if its amplitude is at least this; None for the run's own.
    mask_from : whether masks are taken from amplitude or depth; None for the run's own.
    scenes : ids of the scenes in the figures of several scenes; none for five that are spread by accuracy.
    force : judge also scenes of a corner, or with a field of view, that the training has not seen.

    Raises
    ------
    EvaluationError : the split has no scenes, the run was trained for other images or, without `force`, for
        another corner, the threshold is not positive or of no use, one of `scenes` is not in the split or not
        rendered, or `out` contains anything but an earlier report.
    RunError, DeviceError, ShardError, ImageFileError : run, device or renders cannot be used.
    DatasetError : the dataset lacks one of `scenes`, or the description of a scene is missing or damaged.
    MissingPackageError : the extra ``report`` is not installed.
    """
    need("report", ("jinja2", "plotly"), "the report of night-eval")
    from model.judging.report.page import write_page
    from model.judging.report.sequence_film import write_sequence_film

    run, out = run_folder(run), Path(out).resolve()  # `whole_folder` needs a name; "." has none
    refuse_other_contents(out)
    if mask_threshold is not None and not (math.isfinite(mask_threshold) and mask_threshold > 0):
        raise EvaluationError(f"a mask threshold is an amplitude above 0, got {mask_threshold:g}")
    predictor, history = _loaded(run, device)
    refuse_other_masks(predictor.config, mask_from, mask_threshold)
    if mask_threshold is not None and (mask_from or predictor.config.readout.mask_from) == "depth":
        raise EvaluationError(
            "the masks are those of the depth, for which a threshold of the amplitude means nothing: leave "
            "--mask-threshold out, or add --mask-from amplitude"
        )
    refuse_scenes_not_shown(dataset, split, scenes)
    config = predictor.config
    shards, _, unlike = open_split(config, run, dataset, split, force=force, progress=progress)
    refuse_scenes_without_render(shards, dataset, scenes)
    readout = predictor.config.readout
    if mask_from is not None:
        readout = replace(readout, mask_from=mask_from)
    if mask_threshold is not None:
        readout = replace(readout, mask_threshold=mask_threshold)
    bench = Bench(seeing(predictor, dataset, shards), readout, dataset, shards, progress)
    with whole_folder(out) as folder:
        clouds = folder / "pointclouds"
        clouds.mkdir()
        judged, sheet = judge_split(bench, split, clouds)
        report = replace(judged, unlike_training=unlike)
        shown = list(shown_scenes(bench, choose(report.ranked)))
        figured = list(shown_scenes(bench, choose_for_figures(report.ranked, scenes)))
        write_sequence_film(folder, bench, report)
        write_page(folder, report, sheet, shown, figured, history, predictor.config, _origin(bench, run))
        write_files(folder, report, _origin(bench, run))
        refuse_other_contents(out)  # which may have got other files meanwhile
    return report


def _loaded(run: Path, device: DeviceName) -> tuple[Predictor, dict[str, list[float]]]:
    """The network of a run and its history; of the same moment, but for milliseconds, if the run goes on."""
    for _ in range(_TRIES):
        predictor, history = load(run, device), read_history(run)
        if sha256_of(run / WEIGHTS_FILE) == predictor.weights_sha256:
            break
    return predictor, history


def _origin(bench: Bench, run: Path) -> dict[str, Any]:
    """Run, dataset and image size of the evaluation as plain data."""
    manifest = bench.shards.manifest
    return {
        "run": str(run.resolve()),
        "dataset": str(bench.dataset.root.resolve()),
        "data_sha256": manifest.data_sha256,
        "image_size": [manifest.width, manifest.height],
    }
