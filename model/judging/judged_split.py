"""The scenes of a split on which a network can be judged."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from model.data.corner import wall_view
from model.data.shards import Shards, open_shards
from model.judging.other_corner import refuse_other_corner
from model.judging.refusals import (
    nothing_rendered,
    refuse_many_corners,
    refuse_missing_split,
    refuse_other_images,
)
from model.prediction.predictor import Predictor
from model.run_folder.run_config import RunConfig
from scenegen import Dataset, Split


def seeing(predictor: Predictor, dataset: Dataset, shards: Shards) -> Predictor:
    """The network with the size of the images, and the camera and the wall, of a dataset."""
    size = shards.manifest.width, shards.manifest.height
    return predictor.for_size(*size).at(wall_view(dataset))


def open_split(
    trained: RunConfig,
    run: Path,
    dataset: Dataset,
    split: Split,
    *,
    force: bool,
    progress: bool,
    first: int | None = None,
) -> tuple[Shards, Sequence[int], tuple[str, ...]]:
    """Shards, the rows of the `first` rendered scenes of a split, and what is unlike the training in these.

    Raises
    ------
    EvaluationError : there are none, the network cannot read their images or, without `force`, does not know
        their corner.
    ShardError, ImageFileError, DatasetError : files of the dataset cannot be used.
    """
    refuse_missing_split(dataset, split)
    shards = open_shards(dataset, progress=progress)
    refuse_other_images(trained, shards, run, dataset)
    refuse_many_corners(trained, dataset)
    rows = shards.rows(split)[:first]
    if not rows:
        raise nothing_rendered(dataset, split)
    return shards, rows, refuse_other_corner(trained, dataset, shards.ids(rows), run, force=force)
