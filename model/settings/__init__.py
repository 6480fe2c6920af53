"""Settings of a training run, as plain data: one file for each group. Imports neither torch nor siblings.

`TrainSettings` has the groups; `settings_from_dict` and `training_preset` read them from plain data and TOML.
"""

from model.settings.augmentation import AugmentationSettings, CameraSettings, PaperChanges
from model.settings.input import (
    AmplitudeDivisor,
    Channels,
    InputSettings,
    PaperAndResidualChannels,
    PaperChannels,
    Reference,
    ResidualChannels,
    WallChannels,
)
from model.settings.keys import merged, tables
from model.settings.network import NetworkSettings
from model.settings.optimiser import OptimiserSettings
from model.settings.presets import training_preset
from model.settings.run import DeviceName, GroundTruth, Precision, RunSettings
from model.settings.target import (
    Balance,
    ComponentsTarget,
    DepthTarget,
    LossName,
    LossTarget,
    MaskAndDepthTarget,
    MaskGradient,
    MaskSource,
    Target,
)
from model.settings.train_settings import (
    MAY_CHANGE_ON_RESUME,
    TrainSettings,
    flat_settings,
    plain_settings,
    settings_from_dict,
)

__all__ = [
    "MAY_CHANGE_ON_RESUME",
    "AmplitudeDivisor",
    "AugmentationSettings",
    "Balance",
    "CameraSettings",
    "Channels",
    "ComponentsTarget",
    "DepthTarget",
    "DeviceName",
    "GroundTruth",
    "InputSettings",
    "LossName",
    "LossTarget",
    "MaskAndDepthTarget",
    "MaskGradient",
    "MaskSource",
    "NetworkSettings",
    "OptimiserSettings",
    "PaperAndResidualChannels",
    "PaperChanges",
    "PaperChannels",
    "Precision",
    "Reference",
    "ResidualChannels",
    "RunSettings",
    "Target",
    "TrainSettings",
    "WallChannels",
    "flat_settings",
    "merged",
    "plain_settings",
    "settings_from_dict",
    "tables",
    "training_preset",
]
