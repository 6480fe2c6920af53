"""Training: one loop, readable from top to bottom, that can be stopped and goes on exactly where it was."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from model.augmentation import augmentation_named
from model.batches import Batch, make_batch
from model.feed import Feed, window_rows
from model.inputs import fit_input_spec
from model.loss import NightLoss
from model.metrics import image_metrics, summarise
from model.prediction import read_output
from model.rows import RowBlock
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
from model.settings import TrainSettings, choose_device
from model.shards import Shards, open_shards
from scenegen import Dataset, Split, is_partial

PICTURE_EVERY = 10  # epochs between pictures in TensorBoard
_log = logging.getLogger(__name__)


class TrainingError(ValueError):
    """A dataset that cannot be trained on, or a loss that is not a number."""


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

    With `resume`, go on after the last finished epoch of `out`, to the same weights as if it had never
    been interrupted (to the bit on the CPU, with as many threads). Only `max_epochs`, `device` and
    `progress` may differ then.

    Scenes of a split that take more than `memory_bytes` (by default `model.MEMORY_PART` of the machine's
    memory) are streamed from the shards and shuffled in windows (`model.order`); a resumed run keeps the
    windows it began with.

    Raises
    ------
    TrainingError : no training or validation scenes; a loss that is not finite.
    RunError : `out` is in use, or cannot be resumed with these settings.
    DeviceError, ShardError, ImageFileError : no such device; renders that are missing or unusable.
    """
    device = choose_device(settings.device)
    if not resume and out.exists() and not _is_free(out):
        hint = "resume it (--resume)" if (out / "run.json").is_file() else "it is not empty"
        raise RunError(f"{out} exists already: {hint} or choose another folder")
    for split in ("train", "validation"):
        if not dataset.ids(split):
            raise TrainingError(
                f"{dataset.root} has no {split} scenes ({len(dataset.ids())} scenes in all): make more "
                "scenes, or change dataset.test_fraction and dataset.validation_fraction of the preset"
            )
    before = read_config(out) if resume else None  # a wrong folder should not cost the making of shards
    shards = open_shards(dataset, progress=settings.progress)
    config = _configure(shards, settings)
    change = changed_setting(before, config) if before else None
    if change:
        raise RunError(f"{out} cannot be resumed: {change}; use the run's own settings or start a new run")
    with _naming_memory(config):
        training = _Training(config, shards, device, memory_bytes)
        checkpoint = load_checkpoint(out, device) if resume else None
        if checkpoint:
            training.restore(checkpoint, out / "checkpoint.pt")
        write_config(out, config)
        return training.run(out)


def _is_free(out: Path) -> bool:
    """Whether a new run may be written to `out`: an empty folder, but for what a killed process left."""
    return out.is_dir() and all(is_partial(entry.name) for entry in out.iterdir())


@contextmanager
def _naming_memory(config: RunConfig) -> Iterator[None]:
    """Turn PyTorch's and numpy's ways to run out of memory into one sentence."""
    try:
        yield
    except (RuntimeError, MemoryError) as error:
        # On the CPU, PyTorch has no exception of its own for this.
        ours = isinstance(error, torch.OutOfMemoryError | MemoryError) or "alloc_cpu.cpp" in str(error)
        if not ours:
            raise
        raise TrainingError(
            f"out of memory with batch size {config.settings.batch_size} and width {config.settings.width} "
            f"at {config.image_width}x{config.image_height} pixels: make the batch or the width smaller"
        ) from None


def _configure(shards: Shards, settings: TrainSettings) -> RunConfig:
    manifest = shards.manifest
    return RunConfig(
        settings=settings,
        inputs=fit_input_spec(settings.channels, shards, shards.rows("train")),
        image_width=manifest.width,
        image_height=manifest.height,
        preset_sha256=manifest.preset_sha256,
        data_sha256=manifest.data_sha256,
        night_version=version("night-nlos"),
    )


class _Training:
    """State of a training run between epochs: network, optimiser, random stream and history."""

    def __init__(
        self, config: RunConfig, shards: Shards, device: torch.device, memory_bytes: int | None
    ) -> None:
        settings = config.settings
        self.config, self.settings, self.shards, self.device = config, settings, shards, device
        self.generator = torch.Generator().manual_seed(settings.seed)
        self.network = config.network(self.generator).to(device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate)
        self.loss = NightLoss(config.readout, settings.loss, settings.alpha)
        noise = settings.noise_sigma
        noise_std = torch.from_numpy(config.inputs.noise_std(noise)) if noise > 0 else None
        self.augmentation = augmentation_named(settings.augmentations, noise_std)
        rows: dict[Split, list[int]] = {s: shards.rows(s) for s in ("train", "validation")}
        self.feeds = {s: Feed(shards, rows[s], window_rows(shards, len(rows[s]), memory_bytes)) for s in rows}
        self.history: list[EpochRecord] = []

    @property
    def best(self) -> EpochRecord:
        """First epoch of the smallest validation loss; there must have been one."""
        return min(self.history, key=lambda record: record.validation_loss)

    def out_of_patience(self) -> bool:
        """Whether too many epochs have passed without a better validation loss."""
        return bool(self.history) and len(self.history) - self.best.epoch >= self.settings.patience

    def run(self, out: Path) -> TrainingResult:
        """Train until the last epoch or the end of patience; everything is on disk after every epoch."""
        max_epochs, scenes = self.settings.max_epochs, len(self.feeds["train"].rows)
        done = len(self.history)
        if done >= max_epochs or self.out_of_patience():
            _log.info("%s is finished already, after %d epochs: nothing to do", out, done)
            return self.result()
        bar = tqdm(
            total=max_epochs * scenes,
            initial=done * scenes,
            unit="scene",
            disable=not self.settings.progress or None,
        )
        with bar, SummaryWriter(str(out / "log"), purge_step=done + 1) as writer:
            for epoch in range(done + 1, max_epochs + 1):
                bar.set_description(f"epoch {epoch}", refresh=False)
                record = self.validate(epoch, train_loss=self.train_epoch(epoch, bar))
                bar.set_postfix(train=f"{record.train_loss:.4f}", validation=f"{record.validation_loss:.4f}")
                self.history.append(record)
                self.save(out)
                self.report(writer, record)
                if self.out_of_patience():
                    _log.info("no better validation loss for %d epochs: stopping", self.settings.patience)
                    break
        return self.result()

    def train_epoch(self, epoch: int, bar: tqdm[None]) -> float:
        """One pass over the training scenes in random order; mean loss of a scene."""
        self.network.train()
        feed, total = self.feeds["train"], 0.0
        for block in feed.shuffled(self.settings.batch_size, self.generator):
            batch = self.augmentation(self.batch(block), self.generator)
            loss = self.loss_of(batch)
            total += len(block) * self.checked(loss, epoch, block.rows)
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()
            bar.update(len(block))
        return total / len(feed.rows)

    @torch.no_grad()
    def validate(self, epoch: int, train_loss: float) -> EpochRecord:
        """Mean loss and metrics of the validation scenes, without augmentation."""
        self.network.eval()
        feed, total, metrics = self.feeds["validation"], 0.0, []
        for block in feed.in_order(self.settings.batch_size):
            batch = self.batch(block)
            output = self.network(batch.channels)
            loss = self.loss(output, batch.target, batch.radial_depth_m, batch.mask)
            total += len(block) * self.checked(loss, epoch, block.rows)
            depth_m, mask, _ = read_output(output, self.config.readout)
            truth = zip(block.radial_depth_m, block.mask, strict=True)
            metrics += [image_metrics(d, m, *t) for d, m, t in zip(depth_m, mask, truth, strict=True)]
        summary = summarise(metrics)
        return EpochRecord(
            epoch=epoch,
            train_loss=train_loss,
            validation_loss=total / len(feed.rows),
            validation_mae_cm=100 * summary.depth_mae_m.mean,
            validation_miou=summary.miou.mean,
        )

    def batch(self, block: RowBlock) -> Batch:
        """Rows of the shards as a batch on the device."""
        return make_batch(block, self.shards.reference, self.config.inputs, self.device)

    def loss_of(self, batch: Batch) -> Tensor:
        """Loss of the network on a batch."""
        return self.loss(self.network(batch.channels), batch.target, batch.radial_depth_m, batch.mask)

    def checked(self, loss: Tensor, epoch: int, rows: Sequence[int]) -> float:
        """The loss as a number; `TrainingError` when it is none."""
        value = float(loss.detach())
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss became {value} in epoch {epoch}, on scenes {', '.join(self.shards.ids(rows))}: "
                "try a smaller learning rate; the run keeps its last good epoch"
            )
        return value

    def save(self, out: Path) -> None:
        """Write the finished epoch; best weights first, so that no checkpoint outlives its best."""
        if self.best is self.history[-1]:
            save_weights(out, self.network)
        write_history(out, self.history)
        state = {
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "history": [asdict(record) for record in self.history],
            "window_rows": self.feeds["train"].window_rows,
        }
        save_checkpoint(out, state)

    def restore(self, state: dict[str, Any], file: Path) -> None:
        """Continue from a checkpoint; `RunError` when it is of another training."""
        try:
            fill(self.network, state["network"], file)
            settings = set(self.optimiser.param_groups[0])
            self.optimiser.load_state_dict(state["optimiser"])
            self.generator.set_state(state["generator"].cpu())
            self.history = [EpochRecord(**record) for record in state["history"]]
            self.keep_windows(int(state.get("window_rows", len(self.feeds["train"].rows))))
            fits = settings <= set(self.optimiser.param_groups[0]) and all(
                self.optimiser.state[parameter][moment].shape == parameter.shape
                for parameter in self.network.parameters()
                for moment in ("exp_avg", "exp_avg_sq")
            )
        except RunError:
            raise
        except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError):
            fits = False
        if not (fits and self.history):
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
        self.feeds["train"] = Feed(self.shards, feed.rows, window_rows)

    def report(self, writer: SummaryWriter, record: EpochRecord) -> None:
        """Scalars of every epoch, and now and then the first validation scene: truth above prediction."""
        for name, value in asdict(record).items():
            if name != "epoch":
                writer.add_scalar(name, value, record.epoch)
        if record.epoch % PICTURE_EVERY == 1:
            batch = self.batch(self.shards.read(self.feeds["validation"].rows[:1]))
            with torch.no_grad():
                depth_m, _, _ = read_output(self.network(batch.channels), self.config.readout)
            both = np.concatenate([batch.radial_depth_m[0].cpu().numpy(), depth_m[0]])  # (2H, W)
            writer.add_image("radial_depth", both[None] / max(float(both.max()), 1e-9), record.epoch)

    def result(self) -> TrainingResult:
        """How the run stands."""
        return TrainingResult(
            epochs=len(self.history),
            best_epoch=self.best.epoch,
            best_validation_loss=self.best.validation_loss,
            ended_by="patience" if self.out_of_patience() else "max_epochs",
        )
