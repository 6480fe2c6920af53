"""Conditions under which a run cannot be evaluated on a dataset."""

from __future__ import annotations

from pathlib import Path

from model.data.shards import Shards
from model.report.report_files import files_of_report
from model.run_folder.run_config import RunConfig
from scenegen import Dataset, NightError, Split
from scenegen.files.own_files import refuse_other_files


class EvaluationError(NightError):
    """The run cannot be evaluated on this dataset, or the report folder contains other files."""


def refuse_other_contents(out: Path) -> None:
    """Refuse an output folder that contains anything but an earlier report, as it was written."""
    refuse_other_files(out, files_of_report, "report", EvaluationError)


def refuse_missing_split(dataset: Dataset, split: Split) -> None:
    """Refuse a split without scenes."""
    if not dataset.ids(split):
        present = sorted({entry.split for entry in dataset.index.scenes})
        raise EvaluationError(
            f"{dataset.root} has no {split} split: its {len(dataset.ids())} scenes are "
            f"{' and '.join(present)}; choose another split or make more scenes"
        )


def refuse_other_images(trained: RunConfig, shards: Shards, run: Path, dataset: Dataset) -> None:
    """Refuse images of another size, or without a frequency, than those of the training."""
    given = shards.manifest
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
