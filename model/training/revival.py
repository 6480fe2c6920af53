"""New weights for dead units of the network that a training starts from."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Final

import torch
from torch import Tensor

from model.data.shards import Shards
from model.network.dead_units import revive
from model.run_folder.run_config import RunConfig
from model.training.rendered_channels import rendered_channels

_SCENES: Final = 256  # on which a unit is looked at; the result depends on it

_log = logging.getLogger(__name__)


def revived(
    weights: Mapping[str, Tensor], config: RunConfig, shards: Shards, rows: Sequence[int]
) -> dict[str, Tensor]:
    """`weights` of a network, with new ones for the units that are dead on the first training scenes.

    Parameters
    ----------
    rows : rows of the training scenes.
    """
    network = config.network(torch.Generator().manual_seed(config.settings.seed))
    network.load_state_dict(network.state_dict() | dict(weights))
    channels = rendered_channels(config, shards, rows[:_SCENES])
    count = revive(network, channels, torch.Generator().manual_seed(config.settings.seed))
    _log.info("%d units of the network were dead on the first %d training scenes", count, len(channels))
    return network.state_dict()
