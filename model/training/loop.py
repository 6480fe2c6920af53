"""Training: one loop, readable from top to bottom, that can be stopped and goes on exactly where it was."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from model.data.augmentation import Draws
from model.data.batches import BatchMaker, TensorRows
from model.data.channel_scaling import fit_input_spec
from model.data.feed import Feed, window_rows
from model.data.shards import Shards, open_shards
from model.network.metrics import mask_iou
from model.network.wall_view import wall_view
from model.run_folder import (
    EpochRecord,
    RunConfig,
    RunError,
    changed_setting,
    fill,
    load_checkpoint,
    read_config,
    save_checkpoint,
    save_weights,
    write_config,
    write_history,
)
from model.settings import TrainSettings
from model.training.interruption import Interruption
from model.training.log import TrainingLog
from model.training.loss_watch import LossError, LossWatch
from model.training.optimisation import learning_rate
from model.training.processes import Processes, joined_processes, processes_of_this_machine
from model.training.refusals import TrainingError, naming_memory, refuse_empty_splits, refuse_start
from model.training.step import TrainingStep
from scenegen import Dataset, Split

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended: after `max_epochs`, or because `patience` ran out."""

    epochs: int
    best_epoch: int
    best_validation_loss: float
    ended_by: Literal["max_epochs", "patience"]


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
            training = _Training(config, shards, processes, memory_bytes)
            checkpoint = load_checkpoint(out) if resume else None
            if checkpoint:
                training.restore(checkpoint, out / "checkpoint.pt")
            if processes.is_first:
                write_config(out, config)
            return training.run(out)


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


class _Training:
    """State of a training run: network, optimiser, place in the epoch, history."""

    def __init__(
        self, config: RunConfig, shards: Shards, processes: Processes, memory_bytes: int | None
    ) -> None:
        settings, device = config.settings, processes.device
        self.config, self.settings, self.shards, self.processes = config, settings, shards, processes
        frequencies_hz = shards.manifest.frequencies_hz
        self.maker = BatchMaker.for_shards(config.inputs, frequencies_hz, shards.reference, device)
        self.feeds = {split: self._feed(split, memory_bytes) for split in ("train", "validation")}
        steps = -(-len(self.feeds["train"].rows) // settings.batch_size)
        self.step = TrainingStep(config, self.maker, processes, steps)
        self.optimisation = self.step.optimisation
        self.history: list[EpochRecord] = []
        self.best_weights: dict[str, Tensor] = {}
        self.batches_done, self.loss_total = 0, torch.zeros((), dtype=torch.float64, device=device)
        self.saved_at = time.monotonic()

    def _feed(self, split: Split, memory_bytes: int | None) -> Feed[TensorRows]:
        rows = self.shards.rows(split)
        sharers = processes_of_this_machine()
        window = window_rows(self.shards, len(rows), memory_bytes, self.processes.device, sharers)
        # The order depends on it, so all processes must take the same.
        return Feed(self.shards, rows, self.processes.smallest(window), self.maker.upload)

    @property
    def best(self) -> EpochRecord:
        """First epoch of the smallest validation loss; there must have been one."""
        return min(self.history, key=lambda record: record.validation_loss)

    def out_of_patience(self) -> bool:
        """Whether too many epochs have passed without a better validation loss."""
        return bool(self.history) and len(self.history) - self.best.epoch >= self.settings.patience

    def run(self, out: Path) -> TrainingResult:
        """Train until the last epoch or the end of patience, with a checkpoint now and then."""
        max_epochs, scenes = self.settings.max_epochs, len(self.feeds["train"].rows)
        done = len(self.history)
        if done >= max_epochs or self.out_of_patience():
            _log.info("%s is finished already, after %d epochs: nothing to do", out, done)
            return self.result()
        if self.history and self.processes.is_first:  # a killed run may have left those of later epochs
            save_weights(out, self.best_weights)
            write_history(out, self.history)
        bar = tqdm(
            total=max_epochs * scenes,
            initial=min(done * scenes + self.batches_done * self.settings.batch_size, max_epochs * scenes),
            unit="scene",
            disable=not (self.settings.progress and self.processes.is_first) or None,
        )
        is_first = self.processes.is_first
        with Interruption() as interruption, bar, TrainingLog(out if is_first else None, done) as log:
            while len(self.history) < max_epochs and not self.out_of_patience():
                bar.set_description(f"epoch {len(self.history) + 1}", refresh=False)
                train_loss = self.train_epoch(out, bar, interruption)
                record = self.validate(train_loss, lambda: self.save_if_due(out, interruption))
                self.refuse_bad_validation(record)
                bar.set_postfix(train=f"{record.train_loss:.4f}", validation=f"{record.validation_loss:.4f}")
                self.finish_epoch(record)
                if is_first:
                    if self.best is record:
                        save_weights(out, self.best_weights)  # before the history that speaks of them
                    write_history(out, self.history)
                    self.report(log, record)
                self.save_if_due(out, interruption)
            self.save(out)
        if self.out_of_patience():
            _log.info("no better validation loss for %d epochs: stopped", self.settings.patience)
        return self.result()

    def train_epoch(self, out: Path, bar: tqdm[None], interruption: Interruption) -> float:
        """What is left of a pass over the training scenes in random order; mean loss of a scene in it."""
        self.step.network.train()
        feed, size = self.feeds["train"], self.settings.batch_size
        # Order and changes of all batches are a function of seed and epoch: they are the same after a resume.
        epoch = len(self.history) + 1
        generator = torch.Generator().manual_seed(_epoch_seed(self.settings.seed, epoch))
        blocks = feed.shuffled(size, generator, skip=self.batches_done)
        draws = Draws.of(len(feed.rows), generator)
        watch = LossWatch(epoch, self.shards.ids, every=self.check_every)
        for block in blocks:
            mine = self.processes.share(range(len(block)))
            part = block.take([block.rows[place] for place in mine])
            chance = draws[[self.batches_done * size + place for place in mine]]
            loss = self.step.loss_of(part, chance)
            self.watch(watch, loss, part.rows)
            own = self.processes.own(len(block))
            # Gradients are averaged over processes; so weighted, that is the mean over the batch.
            self.step.take(loss * (own * self.processes.count / len(block)))
            self.loss_total += own * loss.detach()
            self.batches_done += 1
            bar.update(len(block))
            if self.batches_done % self.check_every == 0:
                self.save_if_due(out, interruption, watch)
        self.watch(watch)
        return float(self.processes.total(self.loss_total)) / len(feed.rows)

    @property
    def check_every(self) -> int:
        """Batches between two looks at the loss; a look makes the processor wait for the GPU."""
        return 1 if self.processes.device.type == "cpu" else 16

    def watch(self, watch: LossWatch, loss: Tensor | None = None, rows: Sequence[int] = ()) -> None:
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
    def validate(self, train_loss: float, between_batches: Callable[[], None]) -> EpochRecord:
        """Mean loss and metrics of the validation scenes, without augmentation."""
        network = self.optimisation.judged.eval()
        feed = self.feeds["validation"]
        sums = torch.zeros(3, dtype=torch.float64, device=self.processes.device)
        for block in feed.in_order(self.settings.batch_size):
            part = block.take([block.rows[place] for place in self.processes.share(range(len(block)))])
            batch = self.maker.batch(part)
            output = self.step.output(batch, network)
            loss = self.step.judge(output, batch)
            depth_error_m = (self.config.readout.radial_depth_m(output) - batch.radial_depth_m).abs().mean()
            pred, truth = self.config.readout.mask(output) > 0, batch.mask > 0
            miou = torch.stack([mask_iou(pred, truth), mask_iou(~pred, ~truth)]).mean()
            sums += self.processes.own(len(block)) * torch.stack(
                [loss.double(), depth_error_m.double(), miou]
            )
            between_batches()
        loss, depth_mae_m, miou = (self.processes.total(sums) / len(feed.rows)).tolist()
        return EpochRecord(
            epoch=len(self.history) + 1,
            learning_rate=learning_rate(
                self.settings, self.optimisation.steps - 1, self.optimisation.steps_per_epoch
            ),
            train_loss=train_loss,
            validation_loss=loss,
            validation_mae_cm=100 * depth_mae_m,
            validation_miou=miou,
        )

    def refuse_bad_validation(self, record: EpochRecord) -> None:
        """`TrainingError` for a validation loss that is no number: no later one could be called better."""
        if not math.isfinite(record.validation_loss):
            raise TrainingError(
                f"the validation loss became {record.validation_loss} in epoch {record.epoch}: try a smaller "
                "learning rate or clip_norm; the run keeps its last checkpoint"
            )

    def finish_epoch(self, record: EpochRecord) -> None:
        """Add an epoch to the history and begin the next one."""
        self.history.append(record)
        self.batches_done = 0
        self.loss_total.zero_()
        if self.best is record:
            weights = self.optimisation.judged.state_dict()
            self.best_weights = {
                name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in weights.items()
            }

    def save_if_due(self, out: Path, interruption: Interruption, watch: LossWatch | None = None) -> None:
        """Write a checkpoint when it is time, or when the process was asked to stop, and then stop."""
        due = time.monotonic() - self.saved_at >= 60 * self.settings.checkpoint_minutes
        if not self.processes.any(due or interruption.signal is not None):
            return
        if watch:
            self.watch(watch)  # no checkpoint holds the weights that a bad loss left
        self.save(out)
        if self.processes.any(interruption.signal is not None):
            epoch = len(self.history) + 1
            _log.info(
                "stopped in epoch %d after %d batches; --resume goes on there", epoch, self.batches_done
            )
            interruption.end()
            raise KeyboardInterrupt  # another process was asked to stop

    def save(self, out: Path) -> None:
        """Write a checkpoint; best weights first, so that no checkpoint outlives its best."""
        loss_total = float(self.processes.total(self.loss_total))
        self.saved_at = time.monotonic()
        if not self.processes.is_first:
            return
        if not all(bool(weight.isfinite().all()) for weight in self.step.network.parameters()):
            raise TrainingError(
                f"the weights stopped being numbers in epoch {len(self.history) + 1}: try a smaller learning "
                "rate or clip_norm; the run keeps its last checkpoint"
            )
        if self.best_weights:
            save_weights(out, self.best_weights)
        write_history(out, self.history)
        state = {
            "network": self.step.network.state_dict(),
            "optimisation": self.optimisation.state(),
            "best": self.best_weights,
            "position": {"batches": self.batches_done, "loss_total": loss_total},
            "history": [asdict(record) for record in self.history],
            "window_rows": self.feeds["train"].window_rows,
        }
        save_checkpoint(out, state)
        self.saved_at = time.monotonic()

    def restore(self, state: Mapping[str, Any], file: Path) -> None:
        """Continue from a checkpoint; `RunError` when it is of another training."""
        try:
            fill(self.step.network, state["network"], file)
            fits = self.optimisation.restore(state["optimisation"])
            self.history = [EpochRecord(**record) for record in state["history"]]
            self.best_weights = {name: tensor.cpu() for name, tensor in state["best"].items()}
            fits = fits and bool(self.best_weights) == bool(self.history)
            self.batches_done = int(state["position"]["batches"])
            if self.processes.is_first:  # the total counts once
                self.loss_total += float(state["position"]["loss_total"])
            self.keep_windows(int(state["window_rows"]))
        except RunError:
            raise
        except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError):
            fits = False
        if not fits:
            raise RunError(f"{file} does not hold the state of this training: train again from the start")

    def keep_windows(self, window_rows: int) -> None:
        """Shuffle in windows of as many training scenes as before; without that the order would differ."""
        feed = self.feeds["train"]
        if window_rows > feed.window_rows:
            _log.warning(
                "the run began with %d training scenes in memory and goes on so; this machine's share of "
                "memory for them takes %d",
                *(window_rows, feed.window_rows),
            )
        self.feeds["train"] = Feed(self.shards, feed.rows, window_rows, self.maker.upload)

    def report(self, log: TrainingLog, record: EpochRecord) -> None:
        """Scalars of every epoch, and now and then what some validation scenes look like."""
        log.scalars(asdict(record), self.optimisation)
        if log.wants_pictures(record.epoch):
            feed = self.feeds["validation"]
            rows = self.maker.upload(self.shards.read(feed.rows[: log.PICTURES]))
            with torch.no_grad():
                batch = self.maker.batch(rows)
                output = self.step.output(batch, self.optimisation.judged)
            log.pictures(batch, self.config.readout, output, record.epoch)

    def result(self) -> TrainingResult:
        """How the run stands."""
        return TrainingResult(
            epochs=len(self.history),
            best_epoch=self.best.epoch,
            best_validation_loss=self.best.validation_loss,
            ended_by="patience" if self.out_of_patience() else "max_epochs",
        )


def _epoch_seed(seed: int, epoch: int) -> int:
    """Seed of an epoch's random stream; streams of other epochs and seeds are independent of it."""
    return int(np.random.SeedSequence((seed, epoch)).generate_state(1, np.uint64)[0] >> np.uint64(1))
