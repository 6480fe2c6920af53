"""Starting a training from the weights of another run."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from disk.frequency_text import megahertz
from model.device import plain_memory_errors
from model.network.channels import InputSpec
from model.run_folder.run_config import RunConfig, RunError, StartingWeights, read_config
from model.run_folder.shipped import run_folder
from model.run_folder.weights import WEIGHTS_FILE, trained_network
from model.settings.target import MaskAndDepthTarget
from model.settings.train_settings import TrainSettings, flat_settings
from model.training.checkpoint import CHECKPOINT_FILE
from model.training.other_images import with_other_frequencies, with_other_pixels
from scenegen import Dataset


@dataclass(frozen=True)
class Start:
    """A trained network that a training starts from.

    Attributes
    ----------
    config : contents of its ``run.json``.
    weights : its best weights, on the CPU, without the images of its corner, for the block and the
        frequencies of the settings.
    origin : what the new run records about it.
    same_frequencies : whether the settings have those of the network.
    """

    config: RunConfig
    weights: dict[str, Tensor]
    origin: StartingWeights
    same_frequencies: bool = True

    def inputs(self, dataset: Dataset, output_hz: float) -> InputSpec | None:
        """The input channels with the constants of the trained network, whose weights expect them.

        None at other frequencies, for which the training scenes give new constants.

        Parameters
        ----------
        output_hz : frequency of the phasors that a training on `dataset` predicts, Hz.

        Raises
        ------
        RunError : the network predicts at another frequency.
        ChannelError : the dataset lacks a frequency of the network.
        """
        if not self.same_frequencies:
            return None
        self.config.inputs.places(dataset.preset.itof.frequencies_hz)
        ours = self.config.output_frequency_hz
        if ours != output_hz:
            raise RunError(
                f"{self.origin.run} predicts at {megahertz(ours)}, and a training on {dataset.root} at "
                f"{megahertz(output_hz)}: render the dataset at the frequencies of that run"
            )
        return self.config.inputs


def read_start(run: Path, settings: TrainSettings) -> Start:
    """The network of the run folder `run`, whose files are checked as for a prediction.

    Raises
    ------
    RunError : the run is damaged, has no weights, or has another network or input than `settings`.
    """
    run = run_folder(run)
    config = read_config(run)
    _refuse_other_network(config, settings, run)
    with plain_memory_errors():
        network, content = trained_network(run, config)
        weights = {
            name: each for name, each in network.state_dict().items() if not name.startswith("images.")
        }
        if settings.predicts_uncertainty and not config.settings.predicts_uncertainty:
            weights |= _new_head(config, settings)
        block, own_hz = config.settings.network.block, config.inputs.frequencies_hz
        wanted_hz = settings.input.frequencies_hz or own_hz
        if wanted_hz != own_hz:
            weights = with_other_frequencies(weights, config.inputs, wanted_hz, block)
        weights = with_other_pixels(weights, block, settings.network.block)
    name = run.resolve().name[:255]
    origin = StartingWeights(run=name, run_id=config.run_id, sha256=hashlib.sha256(content).hexdigest())
    return Start(config, weights, origin, wanted_hz == own_hz)


def _new_head(config: RunConfig, settings: TrainSettings) -> dict[str, Tensor]:
    """Initial weights of the head of the uncertainty, for a network that has none."""
    wanted = replace(config, settings=replace(config.settings, target=MaskAndDepthTarget(uncertainty=True)))
    network = wanted.network(torch.Generator().manual_seed(settings.run.seed))
    return {name: weight for name, weight in network.state_dict().items() if "uncertainty" in name}


def _refuse_other_network(config: RunConfig, settings: TrainSettings, run: Path) -> None:
    """`RunError` if the settings contradict the network or the input of a run."""
    of_run, wanted = flat_settings(config.settings), flat_settings(settings)
    for key in {**of_run, **wanted}:
        if not (key.startswith(("input.", "network.")) or key in ("target.kind", "target.uncertainty")):
            continue
        theirs, ours = of_run.get(key), wanted.get(key)
        if key == "input.frequencies_hz":
            if "paper" not in config.inputs.channels:
                continue  # `with_other_frequencies` makes the weights fit
            theirs = config.inputs.frequencies_hz
            ours = theirs if ours is None else ours
        if key == "target.uncertainty" and ours:
            continue  # its head may be new: it changes nothing else
        if key == "network.block" and ours and 0 in (ours % theirs, theirs % ours):
            continue  # `with_other_pixels` makes the weights fit
        if ours != theirs:
            multiple = f", give a multiple or a part of {theirs}" if key == "network.block" else ""
            raise RunError(
                f"{key} is {ours}, but {run} was trained with {theirs}: its weights fit no other network; "
                f"leave the setting out{multiple}, or train from the start"
            )


def refuse_lost_checkpoint(config: RunConfig, out: Path) -> None:
    """`RunError` for a resumed run without checkpoint, if it has weights or began with those of another."""
    if (out / WEIGHTS_FILE).is_file():
        raise RunError(
            f"{out} has weights but no checkpoint ({CHECKPOINT_FILE}), so it cannot be resumed: train on "
            f"from its weights with --from {out} and another --out"
        )
    if config.started_from:
        raise RunError(
            f"{out / CHECKPOINT_FILE} is missing, which held the weights of {config.started_from.run} that "
            "this run started from: begin a new run with --from"
        )
