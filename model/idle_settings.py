"""Settings of a training that change nothing, because of what its network predicts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

IDLE: Final[Mapping[str, frozenset[str]]] = {  # by target
    "components": frozenset({"smooth_l1_beta"}),
    "depth": frozenset({"smooth_l1_beta", "loss_on", "mask_from", "mask_gradient"}),
    "mask+depth": frozenset(
        {"loss_on", "alpha", "balance", "mask_from", "mask_gradient", "mask_depth_m", "dead_zone"}
    ),
}
