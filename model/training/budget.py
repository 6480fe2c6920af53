"""A training's speed on this machine, measured on its own first scenes, and the epochs that a time gives."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from disk import PathLike
from model.data.shards import Shards, open_shards
from model.settings.fresh import FreshScenes
from model.settings.train_settings import TrainSettings
from model.training.configuring import configure
from model.training.corner_images import corner_images
from model.training.epoch import train_epoch, validate, validate_start
from model.training.fine_tuning import read_start
from model.training.fresh.feed import scenes_at_once
from model.training.interruption import Interruption
from model.training.processes import joined_processes
from model.training.refusals import TrainingError, refuse_other_corner, refuse_other_view
from model.training.state import TrainingState, rows_of
from scenegen import Dataset, Preset
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_LISTS: Final = 2  # of scenes that a worker renders at once, whose time is taken after the first
_EPOCHS: Final = 16  # about so many, of the sizes below
_SMALL, _LARGEST_EPOCH = 256, 8192  # scenes
_LEAST_EPOCH: Final = 32  # where the time is too short for a small one, as on a busy machine


@dataclass(frozen=True)
class Speed:
    """What was measured before a training on fresh scenes.

    Attributes
    ----------
    scenes_per_s : with the rendering.
    start_s : until the first scenes are rendered, seconds.
    validation_s : of one validation, seconds.
    no_object_cm : MAE of predicting no object on the validation scenes.
    start_cm : that of the network that the training starts from; None from new weights.
    """

    scenes_per_s: float
    start_s: float
    validation_s: float
    no_object_cm: float
    start_cm: float | None

    def epochs_in(self, budget_s: float) -> tuple[int, int]:
        """How many epochs fit into a time, seconds, and of how many scenes.

        Raises
        ------
        TrainingError : not one does.
        """
        size = _SMALL
        while size < _LARGEST_EPOCH and 2 * size * _EPOCHS <= (budget_s - self.start_s) * self.scenes_per_s:
            size *= 2
        while size > _LEAST_EPOCH and self.seconds(1, size) > budget_s:
            size //= 2
        epochs = int((budget_s - self.start_s) / self._epoch_s(size))
        if epochs < 1:
            raise TrainingError(
                f"a budget of {budget_s:.3g} s is too small: one epoch of {size} scenes takes "
                f"{self.seconds(1, size):.3g} s here; give {self.seconds(_EPOCHS, _SMALL):.3g} s or more"
            )
        return epochs, size

    def seconds(self, epochs: int, scenes: int) -> float:
        """How long so many epochs of so many scenes take."""
        return self.start_s + epochs * self._epoch_s(scenes)

    def _epoch_s(self, scenes: int) -> float:
        return scenes / self.scenes_per_s + self.validation_s


class _Clock:
    """Notes when scenes are done, as the progress of an epoch."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.counts: list[int] = []

    def update(self, n: int = 1) -> None:
        self.times_s.append(time.monotonic())
        self.counts.append(n)

    def set_description(self, desc: str, refresh: bool = True) -> None:
        """Nothing is shown."""

    def set_postfix(self, *, refresh: bool = True, **values: object) -> None:
        """Nothing is shown."""


def measured_speed(
    dataset: Dataset,
    settings: TrainSettings,
    *,
    fresh: Preset,
    meshes: Mapping[Shape, UnitMesh],
    start_from: PathLike | None,
) -> Speed:
    """Train on a few fresh scenes as `model.train` would, and throw the weights away.

    Raises
    ------
    TrainingError, RunError : as in `model.train`.
    """
    stream = FreshScenes.of(fresh, meshes)
    start = read_start(Path(start_from), settings) if start_from is not None else None
    shards = open_shards(dataset, ground_truth=settings.run.ground_truth, progress=settings.run.progress)
    manifest, batch = shards.manifest, settings.optimiser.batch_size
    scenes = _LISTS * scenes_at_once(manifest.width * manifest.height, batch) + batch
    trial = replace(settings.run, epoch_scenes=scenes, max_epochs=1, progress=False)
    settings = replace(settings, run=trial).for_images(manifest.width)
    refuse_other_view(shards, dataset, settings)
    refuse_other_corner(stream, dataset, shards, settings, meshes)
    with joined_processes(settings.run.device) as processes, TemporaryDirectory() as folder:
        config = configure(dataset, shards, settings, None, start, stream)
        weights = start.weights if start else {}
        weights = weights | corner_images(config, dataset, shards, rows_of(shards, "train", settings))
        state = TrainingState(config, shards, processes, None, weights, meshes)
        with closing(state):
            record = validate_start(state, lambda: None)
            clock, began_s = _Clock(), time.monotonic()
            train_epoch(state, Path(folder), clock, Interruption())  # not entered: a signal ends it at once
            trained_s = time.monotonic()
            validate(state, 0.0, lambda: None)
            validation_s = time.monotonic() - trained_s
    speed = sum(clock.counts[1:]) / (clock.times_s[-1] - clock.times_s[0])
    start_s, start_cm = clock.times_s[0] - began_s, record.validation_mae_cm if start else None
    return Speed(speed, start_s, validation_s, _no_object_cm(shards), start_cm)


def _no_object_cm(shards: Shards) -> float:
    """MAE of predicting no object on the validation scenes, cm."""
    rows = list(shards.rows("validation"))
    return 100 * float(np.mean([shards.read([row]).radial_depth_m.mean() for row in rows]))
