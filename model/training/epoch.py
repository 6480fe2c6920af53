"""One epoch: a pass over the training scenes, then one over the validation scenes."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from itof.metrics import mask_iou
from model.data.augmentation import Draws
from model.data.batches import Batch
from model.network.mask_and_depth import MaskAndDepth
from model.network.unet import UNet, average_with_flip
from model.run_folder.history import EpochRecord
from model.training.interruption import Interruption
from model.training.loss_watch import LossError, LossWatch
from model.training.refusals import TrainingError
from model.training.state import TrainingState, epoch_seed
from model.training.uncertainty_fit import UncertaintyFit
from processes.progress import Progress

_log = logging.getLogger(__name__)


def train_epoch(state: TrainingState, out: Path, bar: Progress, interruption: Interruption) -> float:
    """Train on the remaining batches of an epoch in random order; the epoch's mean loss per scene.

    Raises
    ------
    TrainingError : a loss is not finite, or too large.
    """
    state.step.network.train()
    feed, size = state.feeds["train"], state.settings.optimiser.batch_size
    # Order and augmentation depend only on seed and epoch, so they are the same after a resume.
    epoch = len(state.history) + 1
    generator = torch.Generator().manual_seed(epoch_seed(state.settings.run.seed, epoch))
    order, blocks = feed.epoch(epoch, generator, size, state.batches_done)
    draws = _draws(state, order, generator)
    watch = LossWatch(epoch, state.names, every=_check_every(state))
    for block in blocks:
        mine = state.processes.share(range(len(block)))
        part = block.take([block.rows[place] for place in mine])
        loss = state.step.loss_of(part, draws[[state.batches_done * size + place for place in mine]])
        _watch(watch, loss, part.rows)
        own = state.processes.own(len(block))
        # The processes average their gradients. With this weight, the average is the gradient of the
        # batch's mean loss.
        state.step.take(loss * (own * state.processes.count / len(block)))
        state.loss_total += own * loss.detach()
        state.batches_done += 1
        bar.update(len(block))
        if state.batches_done % _check_every(state) == 0:
            save_if_due(state, out, interruption, watch)
    _watch(watch)
    return float(state.processes.total(state.loss_total)) / len(feed.rows)


def _draws(state: TrainingState, order: Sequence[int], generator: torch.Generator) -> Draws:
    """Random numbers of the samples of an epoch, whose rows come in this order."""
    if state.enlarged is None:
        return Draws.of(len(order), generator)
    return state.enlarged.draws_in_order(order, generator)


@torch.no_grad()
def validate(state: TrainingState, train_loss: float, between_batches: Callable[[], None]) -> EpochRecord:
    """Mean loss and metrics of the validation scenes, without augmentation; fits ``state.uncertainty``.

    Raises
    ------
    TrainingError : the loss or an output of the network is not finite.
    """
    network = state.optimisation.judged.eval()
    feed = state.feeds["validation"]
    sums = torch.zeros(5, dtype=torch.float64, device=state.processes.device)
    readout = state.config.readout
    fit = UncertaintyFit(readout, state.processes.device) if isinstance(readout, MaskAndDepth) else None
    for block in feed.in_order(state.settings.optimiser.batch_size):
        part = block.take([block.rows[place] for place in state.processes.share(range(len(block)))])
        batch = state.maker.batch(part)
        output = state.step.output(batch, network)
        loss, uncertainty = state.step.judge(output, batch), state.step.uncertainty(output, batch)
        depth_error_m = (readout.radial_depth_m(output) - batch.radial_depth_m).abs().mean()
        pred, truth = readout.mask(output) > 0, batch.mask > 0
        miou = torch.stack([mask_iou(pred, truth), mask_iou(~pred, ~truth)]).mean()
        bad = (~output.isfinite()).sum()
        each = torch.stack([value.double() for value in (loss, uncertainty, depth_error_m, miou, bad)])
        sums += state.processes.own(len(block)) * each
        if fit and state.processes.own(len(block)):
            fit.add(_predicted(state, batch, output, network), batch.radial_depth_m, batch.mask)
        between_batches()
    loss, uncertainty, depth_mae_m, miou, bad_outputs = (
        state.processes.total(sums) / len(feed.rows)
    ).tolist()
    record = EpochRecord(
        epoch=len(state.history) + 1,
        learning_rate=state.optimisation.learning_rate(state.optimisation.steps - 1),
        train_loss=train_loss,
        validation_loss=loss,
        validation_mae_cm=100 * depth_mae_m,
        validation_miou=miou,
        validation_uncertainty=uncertainty,
    )
    _refuse_bad_validation(record, bad_outputs > 0)
    if fit:
        state.uncertainty = fit.result(state.processes.total)
    return record


def validate_start(state: TrainingState, between_batches: Callable[[], None]) -> EpochRecord:
    """`validate` the network that the training starts from, as epoch 0."""
    record = validate(state, 0.0, between_batches)
    return replace(record, epoch=0, learning_rate=0.0, train_loss=record.validation_loss)


def _predicted(state: TrainingState, batch: Batch, output: Tensor, network: UNet) -> Tensor:
    """(N, C, H, W) `output` as a prediction has it: averaged with that of the flipped images if so set."""
    if not state.settings.run.average_flip:
        return output

    def of_channels(channels: Tensor) -> Tensor:
        return state.step.output(replace(batch, channels=channels), network)

    return average_with_flip(of_channels, batch.channels, output)


def save_if_due(
    state: TrainingState, out: Path, interruption: Interruption, watch: LossWatch | None = None
) -> None:
    """Write a checkpoint if its time has come or a signal asked to stop; in the second case, stop."""
    due = time.monotonic() - state.saved_at >= 60 * state.settings.run.checkpoint_minutes
    if not state.processes.any(due or interruption.signal is not None):
        return
    if watch:
        _watch(watch)  # a checkpoint must not contain the weights that follow a bad loss
    state.save(out)
    if state.processes.any(interruption.signal is not None):
        epoch = len(state.history) + 1
        _log.info("stopped in epoch %d after %d batches; --resume continues there", epoch, state.batches_done)
        interruption.end()
        raise KeyboardInterrupt  # the signal went to another process


def _check_every(state: TrainingState) -> int:
    """Batches between two checks of the loss; on a GPU a check waits for all queued work.

    The checkpoints of ``checkpoint_minutes = 0`` come after every batch.
    """
    return 1 if state.processes.device.type == "cpu" or not state.settings.run.checkpoint_minutes else 16


def _watch(watch: LossWatch, loss: Tensor | None = None, rows: Sequence[int] = ()) -> None:
    """Note the loss of a batch, or check all that are unchecked; `TrainingError` if one is bad."""
    try:
        if loss is None:
            watch.look()
        else:
            watch.add(loss.detach(), rows)
    except LossError as error:
        raise TrainingError(
            f"{error}: try a smaller learning rate or clip_norm; the run keeps its last checkpoint"
        ) from None


def _refuse_bad_validation(record: EpochRecord, bad_outputs: bool) -> None:
    """`TrainingError` for a validation loss that is not finite: no later loss would compare as better."""
    if bad_outputs or not math.isfinite(record.validation_loss):
        value = "nan" if bad_outputs else record.validation_loss
        raise TrainingError(
            f"the validation loss became {value} in epoch {record.epoch}: try a smaller "
            "learning rate or clip_norm; the run keeps its last checkpoint"
        )
