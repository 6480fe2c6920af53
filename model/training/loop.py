"""The training loop. It can be stopped at any batch and resumes exactly there."""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

import torch

from disk import PathLike, remove_leftovers
from disk.counted import counted
from model.data.shards import open_shards
from model.run_folder.history import HISTORY_FILE, EpochRecord
from model.run_folder.run_config import (
    CONFIG_FILE,
    RunError,
    changed_setting,
    read_config,
    write_config,
)
from model.settings.fresh import FreshScenes
from model.settings.train_settings import TrainSettings
from model.training.checkpoint import CHECKPOINT_FILE, load_checkpoint, refuse_short_checkpoint
from model.training.configuring import configure
from model.training.corner_images import corner_images
from model.training.epoch import save_if_due, train_epoch, validate, validate_start
from model.training.fine_tuning import Start, read_start, refuse_lost_checkpoint
from model.training.interruption import Interruption
from model.training.lock import only_training
from model.training.log import TrainingLog
from model.training.processes import Processes, joined_processes
from model.training.refusals import (
    RESUME,
    naming_disk,
    naming_memory,
    output_frequency_hz,
    refuse_images_of_many_corners,
    refuse_missing_scenes,
    refuse_other_corner,
    refuse_other_view,
    refuse_start,
    refuse_without_engine,
)
from model.training.state import TrainingState, rows_of
from processes.progress import showing_progress
from scenegen import Dataset, Preset
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_log = logging.getLogger(__name__)
_AGAIN: Final = "start again"


@dataclass(frozen=True)
class TrainingResult:
    """Outcome of a training, which ends after `max_epochs`, or `patience` epochs after the best one.

    The best epoch is 0 if the network that the training started from has the smallest loss.
    """

    epochs: int
    best_epoch: int
    best_validation_loss: float
    ended_by: Literal["max_epochs", "patience"]

    def sentence(self, out: PathLike) -> str:
        """The outcome as text; `out` is the run folder."""
        best = f"best epoch {self.best_epoch}" if self.best_epoch else "no epoch was better than the start"
        return (
            f"{counted(self.epochs, 'epoch')}, ended by {self.ended_by}; {best}, with the validation loss "
            f"{self.best_validation_loss:.4f}; run in {out}"
        )


def train(
    dataset: Dataset,
    out: PathLike,
    settings: TrainSettings,
    *,
    resume: bool = False,
    start_from: PathLike | None = None,
    fresh: Preset | None = None,
    meshes: Mapping[Shape, UnitMesh] | None = None,
    memory_bytes: int | None = None,
) -> TrainingResult:
    """Train a network on a dataset's training scenes and write the run folder `out`.

    Under torchrun, all processes train one network together, each on its part of every batch.

    Parameters
    ----------
    dataset : a rendered dataset.
    out : run folder; new or empty, except with `resume`.
    settings : settings of the training.
    resume : continue after the last batch of the checkpoint in `out`. The weights become the same as without
        the interruption: to the bit on the CPU, with the same number of threads and processes. Only
        `max_epochs` (if the learning rate does not depend on it), `device`, `progress` and
        `checkpoint_minutes` may differ from the settings of the run.
    start_from : run folder of a trained network, whose best weights the training starts from (fine-tuning).
        `settings` must have its network and input (`fine_tuning_settings`); the constants of its input
        channels are kept, except the largest shift of the wall. A resumed run no longer needs this folder.
    fresh : train on new scenes of this preset, which worker processes draw and render meanwhile; no scene
        comes twice. The training scenes of `dataset` then scale the input, and its validation scenes judge.
        A resumed run needs it only if it has `meshes`, and then the same.
    meshes : the mesh files that the shapes of `fresh` name (`scenegen.making.meshes.with_meshes`).
    memory_bytes : memory for the scenes of a split; None for a quarter of the memory of machine or GPU. If
        the scenes take more, they are streamed from the shards and shuffled in windows
        (`model.data.feed`). A resumed run keeps the windows of its start.

    Raises
    ------
    TrainingError : there are no training or validation scenes; memory is too small; a loss is not finite or
        too large.
    RunError : `out` is in use, or it cannot be resumed with these settings; `start_from` is damaged, has
        another network or input, or is given with `resume`.
    DeviceError : the device does not exist.
    ShardError, ImageFileError : renders are missing or unusable.
    """
    with joined_processes(settings.run.device) as processes:
        out = Path(out)
        check = functools.partial(refuse_start, dataset, out, resume)
        check()  # before the lock, which is a file in `out`
        if resume and start_from is not None:
            raise RunError(f"{out} goes on from its own weights: leave out resume or start_from")
        refuse_images_of_many_corners(dataset, settings)
        start = read_start(Path(start_from), settings) if start_from is not None else None
        stream = FreshScenes.of(fresh, meshes or {}) if fresh else None
        if not resume:
            output_frequency_hz(dataset, settings, stream)  # refuses, before the shards are made
            refuse_without_engine(settings, stream)
        with only_training(out, processes, check):
            return _train(
                dataset, out, settings, processes, resume, start, stream, meshes or {}, memory_bytes
            )


def _train(
    dataset: Dataset,
    out: Path,
    settings: TrainSettings,
    processes: Processes,
    resume: bool,
    start: Start | None,
    fresh: FreshScenes | None,
    meshes: Mapping[Shape, UnitMesh],
    memory_bytes: int | None,
) -> TrainingResult:
    """`train` in one of its processes, under the lock."""
    before = read_config(out) if resume else None
    if processes.is_first:
        remove_leftovers(out)
        if before is None:  # of a fine-tuning that was killed before it had a run.json
            for name in (CHECKPOINT_FILE, HISTORY_FILE):
                (out / name).unlink(missing_ok=True)
    with processes.first_one_first():
        shown = settings.run.progress and processes.is_first
        shards = open_shards(dataset, ground_truth=settings.run.ground_truth, progress=shown)
    settings = settings.for_images(shards.manifest.width)
    refuse_missing_scenes(shards, dataset, settings.run.train_scenes)
    refuse_other_view(shards, dataset, settings)
    if shown and not before and not start:
        _log.info("scaling the input channels by the training scenes")
    if before is not None:
        if fresh not in (None, before.fresh):
            raise RunError(f"{out} was trained on other scenes than those of --fresh: leave --fresh out")
        fresh = before.fresh
    if fresh is not None:
        refuse_other_corner(fresh, dataset, shards, settings, meshes)
    config = configure(dataset, shards, settings, before, start, fresh)
    change = changed_setting(before, config) if before else None
    if change:
        raise RunError(f"{out} cannot be resumed: {change}; use the run's own settings or start a new run")
    with naming_memory(config):
        goes_on = before is not None and (out / CHECKPOINT_FILE).is_file()
        weights = start.weights if start else {}
        if not goes_on:
            rows = rows_of(shards, "train", settings)
            weights = weights | corner_images(config, dataset, shards, rows)
        else:
            refuse_short_checkpoint(out, config)  # before the network is made, which may take all memory
        state = TrainingState(config, shards, processes, memory_bytes, weights, meshes)
        checkpoint = load_checkpoint(out, before, state.weights_bytes) if before else None
        if checkpoint:
            state.restore(checkpoint, out / CHECKPOINT_FILE)
        elif before:
            refuse_lost_checkpoint(before, out)
        if start:
            # Before run.json: --resume never needs the other run. Until then, the folder counts as free.
            state.save(out, _AGAIN)
        if processes.is_first:
            if state.candidates:
                # A killed run may have left the files of a later epoch than that of its checkpoint.
                state.save_results(out)
            with naming_disk(out / CONFIG_FILE, _AGAIN):
                write_config(out, config)
        if not goes_on and not start:
            state.save(out, RESUME)  # before any weights: a run with weights has a checkpoint, or lost it
        with closing(state):
            return _run(state, out)


def _run(state: TrainingState, out: Path) -> TrainingResult:
    """Train until the last epoch or the end of patience, with a checkpoint from time to time."""
    max_epochs, scenes = state.settings.run.max_epochs, len(state.feeds["train"].rows)
    done, is_first = len(state.history), state.processes.is_first
    if done >= max_epochs or state.out_of_patience():
        _log.info("%s is finished already, after %d epochs: nothing to do", out, done)
        return _result(state)
    before = min(
        done * scenes + state.batches_done * state.settings.optimiser.batch_size, max_epochs * scenes
    )
    if state.settings.run.progress and is_first:
        _log.info("preparing %d scenes", sum(len(feed.distinct_rows) for feed in state.feeds.values()))
    for feed in state.feeds.values():
        feed.hold()  # before the first epoch, whose speed would be that of reading
    shown = showing_progress(
        max_epochs * scenes,
        "sample",  # a scene counts once in each epoch
        initial=before,
        show=state.settings.run.progress and is_first,
    )
    log = TrainingLog(out if is_first else None, done)
    with Interruption() as interruption, shown as bar:
        if state.config.started_from and not (state.candidates or state.batches_done):
            state.begin_with(validate_start(state, lambda: save_if_due(state, out, interruption)))
            state.save(out)  # the start is kept if no epoch is better
        while len(state.history) < max_epochs and not state.out_of_patience():
            bar.set_description(f"epoch {len(state.history) + 1}", refresh=False)
            train_loss = train_epoch(state, out, bar, interruption)
            record = validate(state, train_loss, lambda: save_if_due(state, out, interruption))
            values: dict[str, object] = {
                "train": f"{record.train_loss:.4f}",
                "validation": f"{record.validation_loss:.4f}",
            }
            if state.config.fresh is not None:
                values["waiting"] = f"{state.feeds['train'].waiting_share:.0%}"
            bar.set_postfix(refresh=True, **values)
            state.finish_epoch(record)
            if is_first:
                state.save_results(out, weights=state.best is record)
                _report(state, log, record)
            save_if_due(state, out, interruption)
        state.save(out)
    if state.out_of_patience():
        _log.info("stopped: the validation loss did not improve for %d epochs", state.settings.run.patience)
    return _result(state)


def _report(state: TrainingState, log: TrainingLog, record: EpochRecord) -> None:
    """Log the scalars of an epoch, and in some epochs pictures of the first validation scenes."""
    log.scalars(asdict(record), state.optimisation, len(state.feeds["train"].rows))
    if log.wants_pictures(record.epoch):
        rows = state.feeds["validation"].first(log.PICTURES)
        with torch.no_grad():
            batch = state.maker.batch(rows)
            output = state.step.output(batch, state.optimisation.judged)
        log.pictures(batch, state.config.readout, output, record.epoch)
    log.write()


def _result(state: TrainingState) -> TrainingResult:
    return TrainingResult(
        epochs=len(state.history),
        best_epoch=state.best.epoch,
        best_validation_loss=state.best.validation_loss,
        ended_by="patience" if state.out_of_patience() else "max_epochs",
    )
