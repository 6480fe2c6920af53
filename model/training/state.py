"""State of a training: network, optimiser, position in the epoch, history; saved and restored."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from model.data.batches import BatchMaker
from model.data.feed import Feed, window_rows
from model.data.shards import Shards
from model.run_folder import EpochRecord, RunConfig, RunError, fill, save_weights, write_history
from model.training.checkpoint import save_checkpoint
from model.training.processes import Processes, processes_of_this_machine
from model.training.refusals import TrainingError
from model.training.step import TrainingStep
from scenegen import Split

_log = logging.getLogger(__name__)


class TrainingState:
    """State of a training, and the objects that it uses.

    Attributes
    ----------
    step, optimisation : network and optimiser.
    maker, feeds : make the batches of the training and validation scenes.
    history : record of each finished epoch.
    best_weights : weights of the epoch with the smallest validation loss, on the CPU.
    batches_done : batches of the current epoch that are done.
    loss_total : sum of the losses of this process's scenes in the current epoch.
    saved_at : time of the last checkpoint on the monotonic clock, seconds.
    """

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

    def _feed(self, split: Split, memory_bytes: int | None) -> Feed:
        rows = self.shards.rows(split)
        sharers = processes_of_this_machine()
        window = window_rows(self.shards, len(rows), memory_bytes, self.processes.device, sharers)
        # The window decides the order of the rows, which must be the same in all processes.
        return Feed(self.shards, rows, self.processes.smallest(window), self.maker.upload)

    @property
    def best(self) -> EpochRecord:
        """The first epoch with the smallest validation loss; there must be a finished epoch."""
        return min(self.history, key=lambda record: record.validation_loss)

    def out_of_patience(self) -> bool:
        """Whether the validation loss did not improve for `patience` epochs."""
        return bool(self.history) and len(self.history) - self.best.epoch >= self.settings.patience

    def finish_epoch(self, record: EpochRecord) -> None:
        """Add an epoch to the history and start the next one."""
        self.history.append(record)
        self.batches_done = 0
        self.loss_total.zero_()
        if self.best is record:
            weights = self.optimisation.judged.state_dict()
            self.best_weights = {
                name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in weights.items()
            }

    def save(self, out: Path) -> None:
        """Write the best weights, the history and then the checkpoint that refers to them.

        Raises
        ------
        TrainingError : the weights are not finite; nothing is written.
        """
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
        """Load a checkpoint; `RunError` if it belongs to another training."""
        try:
            fill(self.step.network, state["network"], file)
            fits = self.optimisation.restore(state["optimisation"])
            self.history = [EpochRecord(**record) for record in state["history"]]
            self.best_weights = {name: tensor.cpu() for name, tensor in state["best"].items()}
            fits = fits and bool(self.best_weights) == bool(self.history)
            self.batches_done = int(state["position"]["batches"])
            if self.processes.is_first:  # the total is a sum over processes
                self.loss_total += float(state["position"]["loss_total"])
            self.keep_windows(int(state["window_rows"]))
        except RunError:
            raise
        except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError):
            fits = False
        if not fits:
            raise RunError(f"{file} does not hold the state of this training: train again from the start")

    def keep_windows(self, window_rows: int) -> None:
        """Use the window size with which the run began; another size would change the order of the scenes."""
        feed = self.feeds["train"]
        if window_rows > feed.window_rows:
            _log.warning(
                "the run began with %d training scenes in memory and keeps this number, but the memory for "
                "them on this machine holds only %d",
                window_rows,
                feed.window_rows,
            )
        self.feeds["train"] = Feed(self.shards, feed.rows, window_rows, self.maker.upload)
