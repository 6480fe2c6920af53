"""Settings of a training run, and the device it runs on."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import torch
from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from model.augmentation import AugmentationName
from model.inputs import Channels
from model.loss import LossVariant, NightLoss
from model.readout import Readout
from scenegen.preset import STRICT, Positive, WholeCount, checked

DeviceName = Literal["auto", "cpu", "cuda"]
DEVICES: tuple[DeviceName, ...] = ("auto", "cpu", "cuda")
MAY_CHANGE_ON_RESUME = frozenset({"max_epochs", "device", "progress"})
NotNegative = Annotated[float, Field(ge=0)]


class DeviceError(ValueError):
    """A device that this machine does not have."""


@dataclass(frozen=True, config=STRICT)
class TrainSettings:
    """Everything that decides a training run; the defaults are the paper's unless said otherwise.

    Attributes
    ----------
    channels : network input. Ours is ``paper+residual``: with ``paper`` alone little is learnt (DESIGN 4.9).
    width : channels of the U-Net's first level.
    loss : error of the components, or of the depth in metres.
    alpha : weight of the object in the loss.
    mask_threshold : amplitude from which on a pixel shows the object (ours).
    dead_zone : components below this become 0 before mask and depth are taken.
    learning_rate, batch_size : of Adam.
    max_epochs, patience : training ends after so many epochs, or so many without a better validation loss.
    augmentations : ``none``, ``flip`` (ours: the one exact symmetry) or ``paper``.
    noise_sigma : sensor noise added to the inputs, per phasor component, as a fraction of the amplitude at
        the first frequency (ours: the paper gives no number; this one costs nothing, DESIGN 4.12).
    seed : of weights, order and augmentation.
    device : ``auto`` takes cuda where there is one.
    progress : show a progress bar, where there is a terminal to show it.
    """

    channels: Channels = "paper+residual"
    width: WholeCount = 32
    loss: LossVariant = NightLoss.variant
    alpha: NotNegative = NightLoss.alpha
    mask_threshold: Positive = Readout.mask_threshold
    dead_zone: NotNegative = Readout.dead_zone
    learning_rate: Positive = 1e-4
    batch_size: WholeCount = 32
    max_epochs: WholeCount = 1500
    patience: WholeCount = 150
    augmentations: AugmentationName = "flip"
    noise_sigma: NotNegative = 1e-4
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    device: DeviceName = "auto"
    progress: bool = True


def settings_from_dict(data: dict[str, Any], origin: str) -> TrainSettings:
    """Check plain data against the settings there are; `origin` names the file in the error.

    Raises
    ------
    PresetError : an unknown key, a wrong type or an impossible value, by name.
    """
    settings: TrainSettings = checked(TypeAdapter(TrainSettings), json.dumps(data, default=str), origin)
    return settings


def choose_device(name: DeviceName) -> torch.device:
    """The device to compute on.

    Raises
    ------
    DeviceError : cuda where there is none.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise DeviceError("there is no CUDA device that PyTorch can use: choose device cpu or auto")
    return torch.device(name)
