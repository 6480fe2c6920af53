"""Training: one loop, readable from top to bottom, that can be stopped and goes on exactly where it was."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from model.data.augmentation import Draws
from model.data.channel_scaling import fit_input_spec
from model.data.shards import Shards, open_shards
from model.network.metrics import mask_iou
from model.network.wall_view import wall_view
from model.run_folder import (
    EpochRecord,
    RunConfig,
    RunError,
    changed_setting,
    read_config,
    save_weights,
    write_config,
    write_history,
)
from model.settings import TrainSettings
from model.training.checkpoint import load_checkpoint
from model.training.interruption import Interruption
from model.training.log import TrainingLog
from model.training.loss_watch import LossError, LossWatch
from model.training.optimisation import learning_rate
from model.training.processes import joined_processes
from model.training.refusals import TrainingError, naming_memory, refuse_empty_splits, refuse_start
from model.training.state import TrainingState
from scenegen import Dataset
from scenegen.progress import Progress, showing_progress

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended: after `max_epochs`, or because `patience` ran out."""

    epochs: int
    best_epoch: int
    best_validation_loss: float
    ended_by: Literal["max_epochs", "patience"]

    def sentence(self, out: Path) -> str:
        """The outcome for people to read; `out` is the run folder."""
        return (
            f"{self.epochs} epochs, ended by {self.ended_by}; best validation loss "
            f"{self.best_validation_loss:.4f} in epoch {self.best_epoch}; run in {out}"
        )


def train(
    dataset: Dataset,
    out: Path,
    settings: TrainSettings,
    *,
    resume: bool = False,
    memory_bytes: int | None = None,
) -> TrainingResult:
    """Train a network on a dataset's training scenes and write the run folder `out`.

    With `resume`, go on after the last batch of `out`'s checkpoint, to the same weights as if it had never
    been interrupted (to the bit on the CPU, with as many threads and processes). Only `max_epochs` (where
    the learning rate does not depend on it), `device`, `progress`, `compile` and `checkpoint_minutes` may
    differ then.

    Started by torchrun, all its processes train one network together, each on its part of every batch.

    Scenes of a split that take more than `memory_bytes` (by default a quarter of the memory of machine or
    GPU) are streamed from the shards and shuffled in windows (`model.data.order`); a resumed run keeps the
    windows it began with.

    Raises
    ------
    TrainingError : no training or validation scenes; a loss that is not finite or explodes.
    RunError : `out` is in use, or cannot be resumed with these settings.
    DeviceError, ShardError, ImageFileError : no such device; renders that are missing or unusable.
    """
    with joined_processes(settings.device) as processes:
        refuse_start(dataset, out, resume)
        before = read_config(out) if resume else None  # a wrong folder should not cost the making of shards
        with processes.first_one_first():
            shards = open_shards(dataset, progress=settings.progress and processes.is_first)
        refuse_empty_splits(shards, dataset)
        config = _configure(dataset, shards, settings, before)
        change = changed_setting(before, config) if before else None
        if change:
            raise RunError(
                f"{out} cannot be resumed: {change}; use the run's own settings or start a new run"
            )
        with naming_memory(config):
            state = TrainingState(config, shards, processes, memory_bytes)
            checkpoint = load_checkpoint(out) if resume else None
            if checkpoint:
                state.restore(checkpoint, out / "checkpoint.pt")
            if processes.is_first:
                write_config(out, config)
            return _run(state, out)


def _configure(
    dataset: Dataset, shards: Shards, settings: TrainSettings, before: RunConfig | None
) -> RunConfig:
    """What is trained; a resumed run keeps the constants of its channels, to the bit."""
    manifest = shards.manifest
    try:
        inputs = (
            before.inputs
            if before
            else fit_input_spec(settings.channels, shards, shards.rows("train"), settings.frequencies_hz)
        )
    except ValueError as error:
        raise TrainingError(f"{dataset.root}: {error}") from None
    return RunConfig(
        settings=settings,
        inputs=inputs,
        output_frequency_hz=manifest.frequencies_hz[0],
        geometry=wall_view(dataset),
        image_width=manifest.width,
        image_height=manifest.height,
        preset_sha256=manifest.preset_sha256,
        data_sha256=manifest.data_sha256,
        night_version=version("night-nlos"),
    )


def _run(state: TrainingState, out: Path) -> TrainingResult:
    """Train until the last epoch or the end of patience, with a checkpoint now and then."""
    max_epochs, scenes = state.settings.max_epochs, len(state.feeds["train"].rows)
    done = len(state.history)
    if done >= max_epochs or state.out_of_patience():
        _log.info("%s is finished already, after %d epochs: nothing to do", out, done)
        return _result(state)
    if state.history and state.processes.is_first:  # a killed run may have left those of later epochs
        save_weights(out, state.best_weights)
        write_history(out, state.history)
    is_first = state.processes.is_first
    before = min(done * scenes + state.batches_done * state.settings.batch_size, max_epochs * scenes)
    shown = showing_progress(
        max_epochs * scenes, "scene", initial=before, show=state.settings.progress and is_first
    )
    log_folder = out if is_first else None
    with Interruption() as interruption, shown as bar, TrainingLog(log_folder, done) as log:
        while len(state.history) < max_epochs and not state.out_of_patience():
            bar.set_description(f"epoch {len(state.history) + 1}", refresh=False)
            train_loss = _train_epoch(state, out, bar, interruption)
            record = _validate(state, train_loss, lambda: _save_if_due(state, out, interruption))
            _refuse_bad_validation(record)
            bar.set_postfix(train=f"{record.train_loss:.4f}", validation=f"{record.validation_loss:.4f}")
            state.finish_epoch(record)
            if is_first:
                if state.best is record:
                    save_weights(out, state.best_weights)  # before the history that speaks of them
                write_history(out, state.history)
                _report(state, log, record)
            _save_if_due(state, out, interruption)
        state.save(out)
    if state.out_of_patience():
        _log.info("no better validation loss for %d epochs: stopped", state.settings.patience)
    return _result(state)


def _train_epoch(state: TrainingState, out: Path, bar: Progress, interruption: Interruption) -> float:
    """What is left of a pass over the training scenes in random order; mean loss of a scene in it."""
    state.step.network.train()
    feed, size = state.feeds["train"], state.settings.batch_size
    # Order and changes of all batches are a function of seed and epoch: they are the same after a resume.
    epoch = len(state.history) + 1
    generator = torch.Generator().manual_seed(_epoch_seed(state.settings.seed, epoch))
    blocks = feed.shuffled(size, generator, skip=state.batches_done)
    draws = Draws.of(len(feed.rows), generator)
    watch = LossWatch(epoch, state.shards.ids, every=_check_every(state))
    for block in blocks:
        mine = state.processes.share(range(len(block)))
        part = block.take([block.rows[place] for place in mine])
        chance = draws[[state.batches_done * size + place for place in mine]]
        loss = state.step.loss_of(part, chance)
        _watch(watch, loss, part.rows)
        own = state.processes.own(len(block))
        # Gradients are averaged over processes; so weighted, that is the mean over the batch.
        state.step.take(loss * (own * state.processes.count / len(block)))
        state.loss_total += own * loss.detach()
        state.batches_done += 1
        bar.update(len(block))
        if state.batches_done % _check_every(state) == 0:
            _save_if_due(state, out, interruption, watch)
    _watch(watch)
    return float(state.processes.total(state.loss_total)) / len(feed.rows)


def _check_every(state: TrainingState) -> int:
    """Batches between two looks at the loss; a look makes the processor wait for the GPU."""
    return 1 if state.processes.device.type == "cpu" else 16


def _watch(watch: LossWatch, loss: Tensor | None = None, rows: Sequence[int] = ()) -> None:
    """Keep an eye on a batch's loss, or on all that were not looked at; `TrainingError` when bad."""
    try:
        if loss is None:
            watch.look()
        else:
            watch.add(loss.detach(), rows)
    except LossError as error:
        raise TrainingError(
            f"{error}: try a smaller learning rate or clip_norm; the run keeps its last checkpoint"
        ) from None


@torch.no_grad()
def _validate(state: TrainingState, train_loss: float, between_batches: Callable[[], None]) -> EpochRecord:
    """Mean loss and metrics of the validation scenes, without augmentation."""
    network = state.optimisation.judged.eval()
    feed = state.feeds["validation"]
    sums = torch.zeros(3, dtype=torch.float64, device=state.processes.device)
    for block in feed.in_order(state.settings.batch_size):
        part = block.take([block.rows[place] for place in state.processes.share(range(len(block)))])
        batch = state.maker.batch(part)
        output = state.step.output(batch, network)
        loss = state.step.judge(output, batch)
        depth_error_m = (state.config.readout.radial_depth_m(output) - batch.radial_depth_m).abs().mean()
        pred, truth = state.config.readout.mask(output) > 0, batch.mask > 0
        miou = torch.stack([mask_iou(pred, truth), mask_iou(~pred, ~truth)]).mean()
        sums += state.processes.own(len(block)) * torch.stack([loss.double(), depth_error_m.double(), miou])
        between_batches()
    loss, depth_mae_m, miou = (state.processes.total(sums) / len(feed.rows)).tolist()
    return EpochRecord(
        epoch=len(state.history) + 1,
        learning_rate=learning_rate(
            state.settings, state.optimisation.steps - 1, state.optimisation.steps_per_epoch
        ),
        train_loss=train_loss,
        validation_loss=loss,
        validation_mae_cm=100 * depth_mae_m,
        validation_miou=miou,
    )


def _refuse_bad_validation(record: EpochRecord) -> None:
    """`TrainingError` for a validation loss that is no number: no later one could be called better."""
    if not math.isfinite(record.validation_loss):
        raise TrainingError(
            f"the validation loss became {record.validation_loss} in epoch {record.epoch}: try a smaller "
            "learning rate or clip_norm; the run keeps its last checkpoint"
        )


def _save_if_due(
    state: TrainingState, out: Path, interruption: Interruption, watch: LossWatch | None = None
) -> None:
    """Write a checkpoint when it is time, or when the process was asked to stop, and then stop."""
    due = time.monotonic() - state.saved_at >= 60 * state.settings.checkpoint_minutes
    if not state.processes.any(due or interruption.signal is not None):
        return
    if watch:
        _watch(watch)  # no checkpoint holds the weights that a bad loss left
    state.save(out)
    if state.processes.any(interruption.signal is not None):
        epoch = len(state.history) + 1
        _log.info("stopped in epoch %d after %d batches; --resume goes on there", epoch, state.batches_done)
        interruption.end()
        raise KeyboardInterrupt  # another process was asked to stop


def _report(state: TrainingState, log: TrainingLog, record: EpochRecord) -> None:
    """Scalars of every epoch, and now and then what some validation scenes look like."""
    log.scalars(asdict(record), state.optimisation)
    if log.wants_pictures(record.epoch):
        feed = state.feeds["validation"]
        rows = state.maker.upload(state.shards.read(feed.rows[: log.PICTURES]))
        with torch.no_grad():
            batch = state.maker.batch(rows)
            output = state.step.output(batch, state.optimisation.judged)
        log.pictures(batch, state.config.readout, output, record.epoch)


def _result(state: TrainingState) -> TrainingResult:
    """How the run stands."""
    return TrainingResult(
        epochs=len(state.history),
        best_epoch=state.best.epoch,
        best_validation_loss=state.best.validation_loss,
        ended_by="patience" if state.out_of_patience() else "max_epochs",
    )


def _epoch_seed(seed: int, epoch: int) -> int:
    """Seed of an epoch's random stream; streams of other epochs and seeds are independent of it."""
    return int(np.random.SeedSequence((seed, epoch)).generate_state(1, np.uint64)[0] >> np.uint64(1))
