"""All settings of a training, and which of them a resumed or a fine-tuned run may change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from math import log2
from typing import Annotated, Any, Final, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk import PresetError
from disk.contract import DOCUMENTED, checked_data
from disk.quantities import NotNegative, Positive, WholeCount
from model.settings.augmentation import AugmentationSettings
from model.settings.input import InputSettings, PaperChannels, RayChannels, averaged_over
from model.settings.keys import merged, wrong_key
from model.settings.run import RunSettings
from model.settings.target import MaskAndDepthTarget, TargetSettings

MAY_CHANGE_ON_RESUME: Final = frozenset(
    {"run.max_epochs", "run.device", "run.workers", "run.progress", "run.checkpoint_minutes"}
)
Algorithm = Literal["adam", "muon"]
Schedule = Literal["constant", "cosine"]
MOST_MULTIPLE: Final = 1024  # pixels: images are enlarged to a multiple of blocks, halved at every level


@dataclass(frozen=True, config=DOCUMENTED)
class NetworkSettings:
    """Sizes of the U-Net."""

    width: Annotated[int, Field(ge=1, le=1_000_000)] = 48
    """Channels of the first level; each level has twice as many as the one before. The paper: 32."""
    levels: Annotated[int, Field(ge=1, le=8)] = 3
    """Levels of the encoder; the paper: 5."""
    negative_slope: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """Slope of the ReLUs below 0. With 0, as in the paper, a long training leaves dead units
    (notebook/experiments.md)."""
    block: Annotated[int, Field(ge=0, le=64)] = 0
    """Pixels per side of a position of the U-Net; the paper: 1. 0: the power of two, at most 8, with which an
    image is about 20 positions wide."""

    def __post_init__(self) -> None:
        multiple = self.block * 2 ** (self.levels - 1)
        if multiple > MOST_MULTIPLE:
            raise ValueError(
                f"{self.levels} levels and blocks of {self.block} pixels enlarge images to multiples of "
                f"{multiple} pixels, more than {MOST_MULTIPLE}: take fewer levels or a smaller block"
            )

    def block_for(self, width: int) -> int:
        """The block for images of so many pixels: 2 for 40 pixels and 4 for 80, if it is 0.

        It is at most 8, because a position knows the details of its pixels from few features.
        """
        return self.block or 2 ** min(3, max(0, round(log2(width / 20))))


@dataclass(frozen=True, config=DOCUMENTED)
class OptimiserSettings:
    """Algorithm, batch, learning rate and what smooths it."""

    algorithm: Algorithm = "muon"
    """Adam, as in the paper, or Muon for the inner convolutions and Adam for the other weights. Muon has a
    smaller error after the same training (notebook/experiments.md)."""
    learning_rate: Positive = 1e-3
    """Step size. With both algorithms, the root mean square of a weight's step is about a fifth of it; the
    first steps of Adam are as large as it. The paper: 1e-4."""
    batch_size: WholeCount = 16
    """Scenes of one training step, shared by all processes of a run."""
    schedule: Schedule = "cosine"
    """Learning rate: constant, as in the paper, or down to 0 along half a cosine by the last epoch."""
    warm_up_epochs: NotNegative = 0.5
    """Epochs in which the learning rate grows from 0; may be a fraction."""
    clip_norm: NotNegative = 1.0
    """Largest norm of the gradient; a longer one is scaled down to it. 0: no limit."""
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.99
    """Decay per step of the average of the weights that is validated and kept, shorter at first; 0: none."""


@dataclass(frozen=True, config=DOCUMENTED)
class TrainSettings:
    """Everything that decides a training run; the defaults are what night-train does without a preset.

    A table with the key ``kind`` has other keys for each kind, so what does not go together cannot be
    written. The preset ``paper`` has all values of the paper.
    """

    input: InputSettings = InputSettings()
    """What the network sees."""
    network: NetworkSettings = NetworkSettings()
    """Sizes of the U-Net."""
    target: TargetSettings = MaskAndDepthTarget()
    """What the network predicts, and its loss."""
    optimiser: OptimiserSettings = OptimiserSettings()
    """How the weights are updated."""
    augmentation: AugmentationSettings = AugmentationSettings()
    """Random changes of the training images."""
    run: RunSettings = RunSettings()
    """Scenes, epochs and machine."""

    def __post_init__(self) -> None:
        needs_capture = self.input.reference == "capture" and not isinstance(
            self.input.channels, PaperChannels
        )
        if self.augmentation.camera is not None and needs_capture:
            raise ValueError(
                "input.channels.reference capture needs a capture with every scene, and augmentation.camera "
                "makes none: take reference self, with camera.empty_corner if predictions have one"
            )

    @property
    def predicts_probability(self) -> bool:
        """Whether the amplitude of a predicted phasor is the probability of an object pixel."""
        return isinstance(self.target, MaskAndDepthTarget)

    @property
    def predicts_uncertainty(self) -> bool:
        """Whether the network predicts the error of its depth."""
        return isinstance(self.target, MaskAndDepthTarget) and self.target.uncertainty

    @property
    def balances_dataset(self) -> bool:
        """Whether the loss needs the numbers of object and background pixels of all training scenes."""
        return not isinstance(self.target, MaskAndDepthTarget) and self.target.balance == "dataset"

    def for_images(self, width: int) -> TrainSettings:
        """These settings with the number for which a block of 0 stands, for images of so many pixels."""
        if isinstance(self.input.channels, RayChannels):
            width //= averaged_over(width)
        return replace(self, network=replace(self.network, block=self.network.block_for(width)))


_ADAPTER: Final = TypeAdapter(TrainSettings)


def plain_settings(settings: TrainSettings) -> dict[str, Any]:
    """Settings as plain data, as they stand in ``run.json``."""
    data: dict[str, Any] = _ADAPTER.dump_python(settings, mode="json")
    return data


def settings_from_dict(data: Mapping[str, Any], origin: str) -> TrainSettings:
    """The default settings with the changes in `data`; `origin` names the file in the error.

    A table with another ``kind`` than the default has the defaults of that kind.

    Raises
    ------
    PresetError : an unknown key, with the nearest ones; a key of another kind; a wrong type or an impossible
        value, by name.
    """
    whole = merged(plain_settings(TrainSettings()), data)
    wrong = wrong_key(TrainSettings, whole)
    if wrong:
        raise PresetError(f"{origin}: {wrong}")
    settings: TrainSettings = checked_data(_ADAPTER, whole, origin, PresetError)
    return settings


def flat_settings(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Values by their keys, such as ``network.width``."""
    flat: dict[str, Any] = {}
    for field in fields(settings):
        value, key = getattr(settings, field.name), f"{prefix}{field.name}"
        flat |= flat_settings(value, f"{key}.") if is_dataclass(value) else {key: value}
    return flat
