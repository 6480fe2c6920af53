"""The run folder: the files that training writes and that everything else reads to use a trained network.

====================  ======================================================================================
``run.json``          settings, input channels and their constants, and the data that the run was trained on
``best.safetensors``  weights of the epoch with the smallest validation loss
``checkpoint.pt``     state from which training resumes, also within an epoch (`model.training.checkpoint`)
``history.csv``       one line for each epoch
``log/``              TensorBoard
====================  ======================================================================================
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass as plain_dataclass
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, Literal

import torch
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from model.network.channels import InputSpec
from model.network.readout import Readout
from model.network.unet import UNet
from model.network.wall_view import WallView
from model.settings import MAY_CHANGE_ON_RESUME, TrainSettings
from scenegen import NightError, whole_file, write_text
from scenegen.contract import STRICT, Positive, WholeCount, checked

RUN_SCHEMA: Final = 2
CONFIG_FILE, WEIGHTS_FILE, HISTORY_FILE = "run.json", "best.safetensors", "history.csv"


class RunError(NightError):
    """The run folder is missing, damaged, in use, or not a run of this schema version."""


@dataclass(frozen=True, config=STRICT)
class RunConfig:
    """Contents of ``run.json``.

    Attributes
    ----------
    settings : settings of the training.
    inputs : input channels and their constants, which were fitted to the training scenes.
    output_frequency_hz : modulation frequency of the predicted phasor, Hz; the first of the dataset.
    geometry : camera and relay wall, from which the direct return is computed.
    image_width, image_height : size of the training images, pixels.
    preset_sha256 : hash of the dataset's resolved preset.
    data_sha256 : hash of the scenes, splits and renders of the dataset.
    night_version : version of the program that trained the network.
    """

    settings: TrainSettings
    inputs: InputSpec
    output_frequency_hz: Positive
    geometry: WallView
    image_width: WholeCount
    image_height: WholeCount
    preset_sha256: str
    data_sha256: str
    night_version: str
    schema_version: Literal[2] = RUN_SCHEMA

    @property
    def readout(self) -> Readout:
        """Reads mask and depth from the output of this run's network."""
        settings = self.settings
        return Readout(self.output_frequency_hz, settings.mask_threshold, settings.dead_zone)

    def network(self, generator: torch.Generator | None = None) -> UNet:
        """A network of this run's architecture with initial weights."""
        return UNet(self.inputs.channel_count, self.settings.width, generator=generator)


@plain_dataclass(frozen=True)
class EpochRecord:
    """One line of ``history.csv``: losses, and metrics of the radial depth on the validation scenes."""

    epoch: int
    learning_rate: float
    train_loss: float
    validation_loss: float
    validation_mae_cm: float
    validation_miou: float


def write_config(folder: Path, config: RunConfig) -> None:
    """Write ``run.json``."""
    write_text(folder / CONFIG_FILE, TypeAdapter(RunConfig).dump_json(config, indent=2).decode() + "\n")


def read_config(folder: Path) -> RunConfig:
    """Read ``run.json``.

    Raises
    ------
    RunError : the folder is missing or not a run, or ``run.json`` has another schema version or is invalid.
    """
    file = folder / CONFIG_FILE
    if not folder.is_dir():
        raise RunError(f"there is no folder {folder}: train a network with night-train")
    try:
        text = file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RunError(
            f"{folder} is no training run (it has no run.json): train one with night-train"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{file} cannot be read: {error}") from None
    try:
        schema = TypeAdapter(dict[str, Any]).validate_json(text).get("schema_version")
    except ValidationError:
        raise RunError(f"{file} is not the JSON of a run: train again") from None
    if schema != RUN_SCHEMA:
        raise RunError(
            f"{file} has schema version {schema}, this program reads version {RUN_SCHEMA}: "
            "train again, or use the version of NIGHT that made it"
        )
    config: RunConfig = checked(TypeAdapter(RunConfig), text, str(file), RunError)
    return config


def run_settings(folder: Path) -> dict[str, Any]:
    """The settings of a run as plain data for `settings_from_dict`, with which the run can be resumed.

    Raises
    ------
    RunError : as in `read_config`.
    """
    settings: dict[str, Any] = TypeAdapter(TrainSettings).dump_python(read_config(folder).settings)
    return settings


def changed_setting(before: RunConfig, now: RunConfig) -> str | None:
    """The first difference that prevents resuming `before` as `now`, in words; None if there is none."""
    may_change = MAY_CHANGE_ON_RESUME
    if before.settings.schedule != "constant":
        may_change -= {"max_epochs"}  # the learning rate of every epoch depends on it
    for field in fields(TrainSettings):
        old, new = getattr(before.settings, field.name), getattr(now.settings, field.name)
        if field.name not in may_change and old != new:
            why = " (the learning rate's schedule ends with it)" if field.name == "max_epochs" else ""
            return f"{field.name} was {old} and is now {new}{why}"
    if before.data_sha256 != now.data_sha256:
        return "the dataset is not the one that the run began with"
    return None


def save_weights(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``best.safetensors``; `RunError` if it cannot be written."""
    plain = {name: tensor.cpu().contiguous() for name, tensor in weights.items()}
    with whole_file(folder / WEIGHTS_FILE) as partial:
        try:
            save_file(plain, partial)
        except SafetensorError as error:
            raise RunError(f"{folder / WEIGHTS_FILE} cannot be written: {error}") from None


def load_weights(folder: Path, network: UNet) -> None:
    """Load ``best.safetensors`` into `network`.

    Raises
    ------
    RunError : the file is missing or damaged, or its weights belong to another architecture.
    """
    file = folder / WEIGHTS_FILE
    if not file.is_file():
        raise RunError(
            f"{folder} has no best.safetensors: no epoch was finished; resume it with night-train --resume"
        )
    try:
        weights = load_file(file)
    except (SafetensorError, OSError) as error:
        raise RunError(f"{file} is damaged or no safetensors file ({error}): train again") from None
    fill(network, weights, file)


def fill(network: UNet, weights: Mapping[str, Tensor], file: Path) -> None:
    """Load `weights` into `network`; `RunError` if they belong to another architecture."""
    expected = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    found = {name: tuple(tensor.shape) for name, tensor in weights.items()}
    if found != expected:
        name = min(name for name in {*expected, *found} if expected.get(name) != found.get(name))
        raise RunError(
            f"{file} holds weights of another architecture than run.json describes: {name} is "
            f"{found.get(name, 'missing')}, expected {expected.get(name, 'no such weight')}"
        )
    network.load_state_dict(dict(weights))


def write_history(folder: Path, history: Sequence[EpochRecord]) -> None:
    """Write ``history.csv``."""
    names = [field.name for field in fields(EpochRecord)]
    with whole_file(folder / HISTORY_FILE) as partial, partial.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(names)
        table.writerows([getattr(record, name) for name in names] for record in history)


def read_history(run: Path) -> dict[str, list[float]]:
    """Columns of a run's ``history.csv`` by name; empty if the file does not exist.

    Raises
    ------
    RunError : the file is damaged.
    """
    file = run / HISTORY_FILE
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            lines = list(csv.DictReader(stream))
        return {name: [float(line[name]) for line in lines] for name in (lines[0] if lines else ())}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise RunError(f"{file} cannot be read: {error}") from None
