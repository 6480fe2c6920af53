"""The run folder: a contract between training and everything that uses a trained network.

``run.json`` (what was trained, on what, how), ``best.safetensors`` (weights of the best validation loss),
``checkpoint.pt`` (everything needed to go on where it was written, in the middle of an epoch or not;
loadable with ``weights_only=True``), ``history.csv`` (one
line an epoch) and ``log/`` (TensorBoard).
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


class RunError(NightError):
    """A run folder that is missing, foreign, damaged, of another schema, or in the way."""


@dataclass(frozen=True, config=STRICT)
class RunConfig:
    """Contents of ``run.json``.

    Attributes
    ----------
    settings : as asked for.
    inputs : network channels and their constants, fitted on the training scenes.
    output_frequency_hz : of the phasor that the network predicts: the dataset's first, Hz.
    geometry : camera and relay wall, which decide the direct return.
    image_width, image_height : of the images trained on, pixels.
    preset_sha256, data_sha256 : which preset, and which scenes and renders it was trained on.
    night_version : of the program that trained it.
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
        """How the network's output is read."""
        settings = self.settings
        return Readout(self.output_frequency_hz, settings.mask_threshold, settings.dead_zone)

    def network(self, generator: torch.Generator | None = None) -> UNet:
        """An untrained network of this run's architecture."""
        return UNet(self.inputs.channel_count, self.settings.width, generator=generator)


@plain_dataclass(frozen=True)
class EpochRecord:
    """One line of ``history.csv``: losses, and validation metrics of radial depth."""

    epoch: int
    learning_rate: float
    train_loss: float
    validation_loss: float
    validation_mae_cm: float
    validation_miou: float


def write_config(folder: Path, config: RunConfig) -> None:
    """Write ``run.json``."""
    write_text(folder / "run.json", TypeAdapter(RunConfig).dump_json(config, indent=2).decode() + "\n")


def read_config(folder: Path) -> RunConfig:
    """Read ``run.json``.

    Raises
    ------
    RunError : no such folder, not a run, of another schema, or against the contract.
    """
    file = folder / "run.json"
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
    """The settings of a run as plain data, as `settings_from_dict` takes them; what a resumed run needs.

    Raises
    ------
    RunError : as of `read_config`.
    """
    settings: dict[str, Any] = TypeAdapter(TrainSettings).dump_python(read_config(folder).settings)
    return settings


def changed_setting(before: RunConfig, now: RunConfig) -> str | None:
    """What keeps a run from being resumed under `now`, as a sentence; None when nothing does."""
    may_change = MAY_CHANGE_ON_RESUME
    if before.settings.schedule != "constant":
        may_change -= {"max_epochs"}  # the learning rate of all epochs depends on it
    for field in fields(TrainSettings):
        old, new = getattr(before.settings, field.name), getattr(now.settings, field.name)
        if field.name not in may_change and old != new:
            why = " (the learning rate's schedule ends with it)" if field.name == "max_epochs" else ""
            return f"{field.name} was {old} and is now {new}{why}"
    if before.data_sha256 != now.data_sha256:
        return "the dataset is not the one the run began with"
    return None


def save_weights(folder: Path, weights: Mapping[str, Tensor]) -> None:
    """Write ``best.safetensors``."""
    plain = {name: tensor.cpu().contiguous() for name, tensor in weights.items()}
    with whole_file(folder / "best.safetensors") as partial:
        save_file(plain, partial)


def load_weights(folder: Path, network: UNet) -> None:
    """Fill `network` from ``best.safetensors``.

    Raises
    ------
    RunError : no weights, a damaged file, or weights of another architecture.
    """
    file = folder / "best.safetensors"
    if not file.is_file():
        raise RunError(f"{folder} has no best.safetensors: no epoch was finished yet, go on with night-train")
    try:
        weights = load_file(file)
    except (SafetensorError, OSError) as error:
        raise RunError(f"{file} is damaged or no safetensors file ({error}): train again") from None
    fill(network, weights, file)


def fill(network: UNet, weights: Mapping[str, Tensor], file: Path) -> None:
    """Put `weights` into `network`; `RunError` when they belong to another architecture."""
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
    with whole_file(folder / "history.csv") as partial, partial.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(names)
        table.writerows([getattr(record, name) for name in names] for record in history)


def read_history(run: Path) -> dict[str, list[float]]:
    """Columns of a run's ``history.csv``, whichever it has; nothing where there is no such file.

    Raises
    ------
    RunError : a damaged file.
    """
    file = run / "history.csv"
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            lines = list(csv.DictReader(stream))
        return {name: [float(line[name]) for line in lines] for name in (lines[0] if lines else ())}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise RunError(f"{file} cannot be read: {error}") from None
