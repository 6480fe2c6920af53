"""Conditions under which a run cannot be evaluated on a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from disk import NightError
from disk.frequency_text import megahertz
from disk.own_files import refuse_other_files
from model.data.corner import many_corners_problem
from model.data.shards import Shards
from model.judging.report_files import files_of_report
from model.run_folder.networks import Wanted, what_to_do
from model.run_folder.run_config import RunConfig
from model.settings.target import MaskSource
from scenegen import Dataset, Split

MOST_FIGURE_SCENES = 20  # a taller figure is of no use on paper or screen


class EvaluationError(NightError):
    """The run cannot be evaluated on this dataset, or the report folder contains other files."""


def refuse_other_contents(out: Path) -> None:
    """Refuse an output folder that contains anything but an earlier report, as it was written."""
    refuse_other_files(out, files_of_report, "report", EvaluationError)


def refuse_other_masks(
    trained: RunConfig, mask_from: MaskSource | None, mask_threshold: float | None
) -> None:
    """Refuse masks that the outputs of a network do not give."""
    if trained.settings.target.kind == "depth" and (mask_from == "amplitude" or mask_threshold is not None):
        raise EvaluationError(
            "the network predicts depth and no amplitude: leave --mask-from and --mask-threshold out"
        )
    if not trained.settings.predicts_probability:
        return
    if mask_from == "depth":
        raise EvaluationError(
            "the network predicts the mask itself, and a depth for every pixel: leave --mask-from out"
        )
    if mask_threshold is not None and mask_threshold >= 1:
        raise EvaluationError(
            "the network predicts the probability of the mask, and no probability is above "
            f"{mask_threshold:g}: give a --mask-threshold below 1"
        )


def refuse_many_corners(trained: RunConfig, dataset: Dataset) -> None:
    """Refuse scenes with cameras elsewhere for a network that cannot find their walls."""
    problem = many_corners_problem(dataset, trained.inputs)
    if problem:
        size, frequencies_hz = (trained.image_width, trained.image_height), dataset.preset.itof.frequencies_hz
        raise EvaluationError(f"{problem}; or {what_to_do(Wanted(*size, frequencies_hz))}")


def refuse_missing_split(dataset: Dataset, split: Split) -> None:
    """Refuse a split without scenes."""
    if not dataset.ids(split):
        present = sorted({entry.split for entry in dataset.index.scenes})
        raise EvaluationError(
            f"{dataset.root} has no {split} split: its {len(dataset.ids())} scenes are "
            f"{' and '.join(present)}; choose another split or make more scenes"
        )


def nothing_rendered(dataset: Dataset, split: Split) -> EvaluationError:
    """The error of a split of which no scene is rendered."""
    return EvaluationError(
        f"no scene of the {split} split of {dataset.root} could be rendered: see night-render status"
    )


def refuse_scenes_not_shown(dataset: Dataset, split: Split, scenes: Sequence[str]) -> None:
    """Refuse scenes for the figures that the dataset lacks or another split has, or too many of them."""
    for scene in scenes:
        entry = dataset.entry(scene)
        if entry.split != split:
            raise EvaluationError(
                f"scene {scene} is a {entry.split} scene, and the report is about the {split} split: choose "
                f"another scene, or judge by the {entry.split} split"
            )
    if len(set(scenes)) > MOST_FIGURE_SCENES:
        raise EvaluationError(
            f"a figure shows at most {MOST_FIGURE_SCENES} scenes, and {len(set(scenes))} are named"
        )


def refuse_scenes_without_render(shards: Shards, dataset: Dataset, scenes: Sequence[str]) -> None:
    """Refuse scenes for the figures that could not be rendered."""
    rendered = {scene.id for scene in shards.manifest.scenes}
    for scene in scenes:
        if scene not in rendered:
            raise EvaluationError(
                f"scene {scene} of {dataset.root} could not be rendered, so it cannot be shown: "
                "see night-render status"
            )


def refuse_other_images(trained: RunConfig, shards: Shards, run: Path, dataset: Dataset) -> None:
    """Refuse images of another size, or without a frequency, than those of the training."""
    given = shards.manifest
    todo = what_to_do(Wanted(given.width, given.height, given.frequencies_hz))
    if not trained.reads(given.width, given.height):
        raise EvaluationError(
            f"wrong resolution between stages: {run} was trained on {trained.image_width}x"
            f"{trained.image_height} pixels, {dataset.root} is rendered at {given.width}x{given.height}; "
            f"render it at the run's resolution, or: {todo}"
        )
    if not {*trained.inputs.frequencies_hz} <= {*given.frequencies_hz}:
        raise EvaluationError(
            f"{run} was trained at {megahertz(*trained.inputs.frequencies_hz)}, {dataset.root} holds "
            f"{megahertz(*given.frequencies_hz)}: {todo}"
        )
