"""All settings of a training, and which of them a resumed or a fine-tuned run may change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final

from pydantic import TypeAdapter
from pydantic.dataclasses import dataclass

from disk import PresetError
from disk.contract import DOCUMENTED, checked_data
from model.settings.augmentation import AugmentationSettings
from model.settings.input import InputSettings, PaperChannels
from model.settings.keys import merged, wrong_key
from model.settings.network import NetworkSettings
from model.settings.optimiser import OptimiserSettings
from model.settings.run import RunSettings
from model.settings.target import MaskAndDepthTarget, TargetSettings

MAY_CHANGE_ON_RESUME: Final = frozenset(
    {"run.max_epochs", "run.device", "run.workers", "run.progress", "run.checkpoint_minutes"}
)


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
