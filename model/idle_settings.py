"""Settings of a training that change nothing, because of what its network sees or predicts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_BY_TARGET: Final[Mapping[str, frozenset[str]]] = {
    "components": frozenset({"smooth_l1_beta"}),
    "depth": frozenset({"smooth_l1_beta", "loss_on", "mask_from", "mask_gradient"}),
    "mask+depth": frozenset(
        {"loss_on", "alpha", "balance", "mask_from", "mask_gradient", "mask_depth_m", "dead_zone"}
    ),
}
_OF_CHANNELS: Final[Mapping[str, str]] = {"amplitude_divisor": "paper", "reference": "residual"}


def idle_settings(target: str, channels: str) -> dict[str, str]:
    """Names of the settings that change nothing, and with what, such as ``target depth``.

    Parameters
    ----------
    target, channels : as in `model.settings.TrainSettings`.
    """
    by_target = dict.fromkeys(_BY_TARGET[target], f"target {target}")
    by_channels = {
        name: f"channels {channels}" for name, needed in _OF_CHANNELS.items() if needed not in channels
    }
    return by_target | by_channels
