"""State of a training: network, optimiser, position in the epoch, history; saved and restored."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from model.data.batches import BatchMaker
from model.data.feed import Feed, window_rows
from model.data.scene_walls import SceneWalls
from model.data.shards import Shards
from model.paper.augmentation import PaperAugmentation
from model.paper.enlarged_set import EnlargedSet
from model.run_folder.history import HISTORY_FILE, EpochRecord, compared_losses, write_history
from model.run_folder.run_config import RunConfig, RunError, run_id_of
from model.run_folder.weights import WEIGHTS_FILE, fill, save_weights
from model.settings.fresh import FreshScenes
from model.settings.train_settings import TrainSettings
from model.training.checkpoint import CHECKPOINT_FILE, save_checkpoint
from model.training.checkpoint_contents import (
    checked_history,
    checked_position,
    checked_tensors,
    checked_whole,
)
from model.training.fresh.feed import FreshFeed
from model.training.fresh.workers import FreshWorkers, Rendering
from model.training.optimisation import epochs_without_improvement
from model.training.processes import Processes, processes_of_this_machine
from model.training.refusals import GO_ON, TrainingError, naming_disk
from model.training.step import TrainingStep, augmentation_of
from model.training.uncertainty_fit import UncertaintyFactors
from processes.cores import usable_cores
from scenegen import Split
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_log = logging.getLogger(__name__)
_RENDERING: Final = 0.4  # of the cores, which render fresh scenes; the others train, on the CPU


class TrainingState:
    """State of a training, and the objects that it uses.

    Attributes
    ----------
    run_id : id of the run, which weights and checkpoint repeat.
    step, optimisation : network and optimiser.
    enlarged : the samples of an epoch, if the training set is enlarged once; else None.
    maker, feeds : make the batches of the training and validation scenes.
    start : record of the network that the training started from, as epoch 0; None from random weights, and
        before it is validated.
    history : record of each finished epoch.
    uncertainty : factors that make the probabilities and expected errors of the last validation hold.
    best_weights : weights of the epoch with the smallest validation loss, on the CPU, with these factors.
    batches_done : batches of the current epoch that are done.
    loss_total : sum of the losses of this process's scenes in the current epoch.
    saved_at : time of the last checkpoint on the monotonic clock, seconds.

    Parameters
    ----------
    weights : weights to start from, all or some; the others are random.
    meshes : the user's meshes of fresh scenes, by shape.
    """

    def __init__(
        self,
        config: RunConfig,
        shards: Shards,
        processes: Processes,
        memory_bytes: int | None,
        weights: Mapping[str, Tensor] | None = None,
        meshes: Mapping[Shape, UnitMesh] | None = None,
    ) -> None:
        settings, device = config.settings, processes.device
        camera = settings.augmentation.camera
        self.config, self.settings, self.shards, self.processes = config, settings, shards, processes
        self._threads = torch.get_num_threads()
        self.run_id = config.run_id or run_id_of(config)
        frequencies_hz = shards.manifest.frequencies_hz
        wall = config.geometry.expected_wall(shards.reference, frequencies_hz)
        self.maker = BatchMaker.for_shards(
            *(config.inputs, frequencies_hz, wall, device, camera.sensor if camera else None),
            sensor_capture=camera is not None and camera.empty_corner,
            walls=_walls(config),
        )
        self.enlarged = _enlarged(rows_of(shards, "train", settings), settings)
        self.feeds: dict[str, Any] = {"validation": self._feed("validation", memory_bytes)}
        if config.fresh is None:
            self.feeds["train"] = self._feed("train", memory_bytes)
        else:
            self.feeds["train"] = self._fresh_feed(config.fresh, meshes or {})
        steps = -(-len(self.feeds["train"].rows) // settings.optimiser.batch_size)
        self.step = TrainingStep(config, self.maker, processes, steps, weights)
        self.optimisation = self.step.optimisation
        self.start: EpochRecord | None = None
        self.history: list[EpochRecord] = []
        self.uncertainty = UncertaintyFactors()
        self.best_weights: dict[str, Tensor] = {}
        self.batches_done, self.loss_total = 0, torch.zeros((), dtype=torch.float64, device=device)
        self.saved_at = time.monotonic()

    def _feed(self, split: Split, memory_bytes: int | None) -> Feed:
        rows: Sequence[int] = rows_of(self.shards, split, self.settings)
        held = len(rows)
        if split == "train" and self.enlarged is not None:
            rows = self.enlarged.rows
        sharers = processes_of_this_machine()
        window = window_rows(
            *(self.shards, held, memory_bytes, self.processes.device, sharers),
            added_bytes=self.maker.reference_bytes,
        )
        # The window decides the order of the rows, which must be the same in all processes.
        return self._feed_of(split, rows, self.processes.smallest(window))

    def _fresh_feed(self, scenes: FreshScenes, meshes: Mapping[Shape, UnitMesh]) -> FreshFeed:
        """Feed of the training's own scenes."""
        run, size = self.settings.run, (self.config.image_width, self.config.image_height)
        cores = usable_cores() // processes_of_this_machine()
        rendering_cores = max(1, round(cores * _RENDERING))
        if self.processes.device.type == "cpu":
            # Threads that wait for each other on a busy core make a step ten times slower.
            torch.set_num_threads(max(1, min(torch.get_num_threads(), cores - rendering_cores)))
        threads = max(1, rendering_cores // run.workers)
        stream = scenes.with_seed(run.seed)
        rendering = Rendering(stream, meshes, *size, run.fresh_error, run.device, threads)
        return FreshFeed(
            *(FreshWorkers(rendering, run.workers), run.epoch_scenes, run.max_epochs, size[0] * size[1]),
            *(self.maker.upload_to_augment, self.processes),
        )

    def names(self, rows: Sequence[int]) -> list[str]:
        """Names of training scenes for a message."""
        if self.config.fresh is None:
            return self.shards.ids(rows)
        return [f"{row} of the stream" for row in rows]

    def _feed_of(self, split: Split, rows: Sequence[int], window_rows: int) -> Feed:
        """Feed of these rows of a split, in windows of at least so many of them."""
        return Feed(
            self.shards,
            rows,
            window_rows,
            self.maker.upload_to_augment if split == "train" else self.maker.upload,
            prepares_ahead=self.processes.device.type != "cpu",
        )

    def close(self) -> None:
        """End the workers that render fresh scenes."""
        if self.config.fresh is not None:
            self.feeds["train"].close()
            torch.set_num_threads(self._threads)

    @property
    def candidates(self) -> list[EpochRecord]:
        """What has weights that may be kept: the start, if there is one, and each finished epoch."""
        return [*([self.start] if self.start else []), *self.history]

    @property
    def best(self) -> EpochRecord:
        """The first candidate with the smallest of `compared_losses`; there must be one."""
        losses = self.compared_losses
        return self.candidates[losses.index(min(losses))]

    @property
    def compared_losses(self) -> list[float]:
        """Losses by which the candidates are compared (`model.run_folder.history.compared_losses`)."""
        return compared_losses(
            [record.validation_loss for record in self.candidates],
            [record.validation_uncertainty for record in self.candidates],
        )

    @property
    def weights_bytes(self) -> int:
        """Size of the network's weights."""
        return sum(weight.nbytes for weight in self.step.network.state_dict().values())

    def out_of_patience(self) -> bool:
        """Whether the validation loss did not improve by more than `min_delta` for `patience` epochs."""
        waited = epochs_without_improvement(self.compared_losses, self.settings.run.min_delta)
        return bool(self.history) and waited >= self.settings.run.patience

    def begin_with(self, record: EpochRecord) -> None:
        """Let the network that the training starts from be the best one so far."""
        self.start = record
        self._keep_if_best(record)

    def finish_epoch(self, record: EpochRecord) -> None:
        """Add an epoch to the history and start the next one."""
        self.history.append(record)
        self.batches_done = 0
        self.loss_total.zero_()
        self._keep_if_best(record)

    def _keep_if_best(self, record: EpochRecord) -> None:
        if self.best is record:
            network = self.optimisation.judged
            weights = network.state_dict()
            if self.settings.predicts_probability:
                weights = self.uncertainty.weights(network, weights)
            self.best_weights = {
                name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in weights.items()
            }

    def save(self, out: Path, then: str = GO_ON) -> None:
        """Write the best weights, the history and then the checkpoint that refers to them.

        Parameters
        ----------
        then : what to do when a full disk has room again.

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
        self.save_results(out, then=then)
        state = {
            "network": self.step.network.state_dict(),
            "optimisation": self.optimisation.state(),
            "best": self.best_weights,
            "position": {"batches": self.batches_done, "loss_total": loss_total},
            "history": [asdict(record) for record in self.candidates],
            "window_rows": self.feeds["train"].window_rows,
        }
        with naming_disk(out / CHECKPOINT_FILE, then):
            save_checkpoint(out, state, self.run_id)
        self.saved_at = time.monotonic()

    def save_results(self, out: Path, *, weights: bool = True, then: str = GO_ON) -> None:
        """Write the best weights, unless they are the same as before, and the history that refers to them."""
        if self.best_weights and weights:
            with naming_disk(out / WEIGHTS_FILE, then):
                save_weights(out, self.best_weights, self.run_id)
        with naming_disk(out / HISTORY_FILE, then):
            write_history(out, self.candidates)

    def restore(self, state: Mapping[str, Any], file: Path) -> None:
        """Load a checkpoint; `RunError` if it belongs to another training or contains impossible values."""
        try:
            self._take_over(state, file)
        except RunError:
            raise
        except (
            AttributeError,
            IndexError,
            KeyError,
            OverflowError,
            RuntimeError,
            TypeError,
            ValueError,
        ) as error:
            reason = " ".join(str(error).split())
            raise RunError(
                f"{file} does not hold the state of this training ({reason}): train again from the start"
            ) from None

    def _take_over(self, state: Mapping[str, Any], file: Path) -> None:
        feed, network = self.feeds["train"], self.step.network
        batches_an_epoch = self.optimisation.steps_per_epoch
        fill(network, state["network"], file)
        candidates = checked_history(state["history"])
        history = [record for record in candidates if record.epoch]
        batches, loss_total = checked_position(state["position"], batches_an_epoch, len(feed.rows))
        self.optimisation.restore(state["optimisation"], len(history) * batches_an_epoch + batches)
        best = checked_tensors(state["best"], network.state_dict() if candidates else {}, "best")
        window_rows = checked_whole(state["window_rows"], 0, len(feed.rows), "window_rows")
        self.start = candidates[0] if len(candidates) > len(history) else None
        self.history, self.best_weights, self.batches_done = history, best, batches
        if self.processes.is_first:  # the total is a sum over processes
            self.loss_total += loss_total
        if self.config.fresh is None:
            self.keep_windows(window_rows)

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
        self.feeds["train"] = self._feed_of("train", feed.rows, window_rows)


def _walls(config: RunConfig) -> SceneWalls | None:
    """The walls of scenes with different fields of view; None if all have that of the run's geometry."""
    if config.fields_of_view_deg is None:
        return None
    size = config.image_width, config.image_height
    return SceneWalls(config.geometry, config.fields_of_view_deg, *size, config.inputs.frequencies_hz)


def rows_of(shards: Shards, split: Split, settings: TrainSettings) -> list[int]:
    """Rows of a split that a training uses, in ascending order."""
    rows = list(shards.rows(split))
    return rows[: settings.run.train_scenes] if split == "train" else rows


def epoch_seed(seed: int, epoch: int) -> int:
    """Seed of an epoch's random numbers, independent of those of other epochs and seeds.

    The first epoch is 1. Of 0 is the enlarged training set, which is drawn once.
    """
    return int(np.random.SeedSequence((seed, epoch)).generate_state(1, np.uint64)[0] >> np.uint64(1))


def _enlarged(rows: Sequence[int], settings: TrainSettings) -> EnlargedSet | None:
    """The samples of every epoch; None if images are changed anew in each."""
    augmentation, changes = augmentation_of(settings.augmentation), settings.augmentation.paper
    if changes is None or changes.copies_per_change == 0 or not isinstance(augmentation, PaperAugmentation):
        return None
    generator = torch.Generator().manual_seed(epoch_seed(settings.run.seed, 0))
    return EnlargedSet.of(rows, augmentation, changes.copies_per_change, generator)
