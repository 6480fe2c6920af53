"""Settings of a training run, as plain data: neither torch nor anything that the settings are for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from scenegen import PresetError, read_settings
from scenegen.preset import STRICT, Positive, WholeCount, checked

Channels = Literal["paper", "residual", "paper+residual"]
CHANNELS: tuple[Channels, ...] = ("paper", "residual", "paper+residual")
LossName = Literal["mae", "mse", "mae+iou", "mse+iou"]
LOSSES: tuple[LossName, ...] = ("mae", "mse", "mae+iou", "mse+iou")
LossTarget = Literal["components", "depth"]
LOSS_TARGETS: tuple[LossTarget, ...] = ("components", "depth")
DeviceName = Literal["auto", "cpu", "cuda"]
DEVICES: tuple[DeviceName, ...] = ("auto", "cpu", "cuda")
Precision = Literal["auto", "float32", "bfloat16", "float16"]
PRECISIONS: tuple[Precision, ...] = ("auto", "float32", "bfloat16", "float16")
Schedule = Literal["constant", "cosine"]
SCHEDULES: tuple[Schedule, ...] = ("constant", "cosine")
MAY_CHANGE_ON_RESUME = frozenset({"max_epochs", "device", "progress", "checkpoint_minutes", "compile"})
NotNegative = Annotated[float, Field(ge=0)]


@dataclass(frozen=True, config=STRICT)
class TrainSettings:
    """Everything that decides a training run; the defaults are the paper's unless said otherwise.

    Attributes
    ----------
    frequencies_hz : of the dataset's, those that the network sees; all when None.
    channels : network input. Ours is ``paper+residual``: with ``paper`` alone little is learnt (DESIGN 4.9).
    width : channels of the U-Net's first level.
    loss : ``mae``, ``mse``, ``mae+iou`` or ``mse+iou``.
    loss_on : error of the components, or of the depth in metres.
    alpha : weight of the object in the loss.
    mask_threshold : amplitude from which on a pixel shows the object (ours).
    dead_zone : components below this become 0 before mask and depth are taken.
    learning_rate, batch_size : of Adam; a batch is shared by all processes of a run.
    schedule : of the learning rate: ``constant``, or down to 0 along half a ``cosine`` by `max_epochs`.
    warm_up_epochs : in which the learning rate grows from 0 (ours); may be a fraction.
    clip_norm : largest norm of the gradient, longer ones are scaled down to it; 0 for no limit (ours).
    ema_decay : of the moving average of the weights that is validated and kept, each step; 0 for none (ours).
    max_epochs, patience : training ends after so many epochs, or so many without a better validation loss.
    flip_rows, flip_columns, rotation_deg, translation, amplitude_spread, noise_sigma : see
        `model.Augmentation`. Only the flip of the rows is a symmetry of the scene and on by default. The
        paper gives no number for its noise; this one costs nothing (DESIGN 4.12).
    precision : of the convolutions; the U-Net's first block and head, the loss and the weights are float32.
        ``auto`` takes bfloat16 on GPUs and processors that compute in it, float32 elsewhere.
    channels_last : memory order of images in the network, faster on most processors.
    compile : compile the network with `torch.compile` (needs a C++ compiler; a minute at the start).
    checkpoint_minutes : between two checkpoints; 0 for one after every batch.
    seed : of weights, order and augmentation.
    device : ``auto`` takes cuda where there is one.
    progress : show a progress bar, where there is a terminal to show it.
    """

    frequencies_hz: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    channels: Channels = "paper+residual"
    width: WholeCount = 32
    loss: LossName = "mae+iou"
    loss_on: LossTarget = "components"
    alpha: NotNegative = 1 / 7
    mask_threshold: Positive = 0.5
    dead_zone: NotNegative = 0.05
    learning_rate: Positive = 1e-4
    batch_size: WholeCount = 32
    schedule: Schedule = "constant"
    warm_up_epochs: NotNegative = 0.0
    clip_norm: NotNegative = 0.0
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.0
    max_epochs: WholeCount = 1500
    patience: WholeCount = 150
    flip_rows: bool = True
    flip_columns: bool = False
    rotation_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    translation: Annotated[float, Field(ge=0, le=1)] = 0.0
    amplitude_spread: NotNegative = 0.0
    noise_sigma: NotNegative = 1e-4
    precision: Precision = "float32"
    channels_last: bool = True
    compile: bool = False
    checkpoint_minutes: NotNegative = 10.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    device: DeviceName = "auto"
    progress: bool = True

    def __post_init__(self) -> None:
        if self.frequencies_hz is not None and list(self.frequencies_hz) != sorted(set(self.frequencies_hz)):
            raise ValueError("frequencies_hz must ascend, each once")


def training_preset(name_or_file: str) -> tuple[dict[str, Any], str]:
    """Settings of a TOML file or of one in data/training, and its path.

    A preset with the key ``extends`` begins with the settings of the preset it names, a file beside it or
    one of data/training.

    Raises
    ------
    PresetError : no such file, not TOML, or presets that extend each other in a circle.
    """
    layers: list[dict[str, Any]] = []
    origins: list[str] = []
    name: Any = name_or_file
    while name is not None:
        data, origin = read_settings("training", str(name))
        if origin in origins:
            raise PresetError(f"{' extends '.join([*origins, origin])}: a circle has no beginning")
        origins.append(origin)
        name = data.pop("extends", None)
        beside = Path(origin).parent / str(name)
        if name is not None and beside.is_file():
            name = beside
        layers.append(data)
    return {key: value for layer in reversed(layers) for key, value in layer.items()}, origins[0]


def settings_from_dict(data: dict[str, Any], origin: str) -> TrainSettings:
    """Check plain data against the settings there are; `origin` names the file in the error.

    Raises
    ------
    PresetError : an unknown key, a wrong type or an impossible value, by name.
    """
    settings: TrainSettings = checked(TypeAdapter(TrainSettings), json.dumps(data, default=str), origin)
    return settings
