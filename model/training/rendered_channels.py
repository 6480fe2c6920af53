"""Network input of training scenes as they were rendered: without augmentation, and without a camera."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from model.data.batches import BatchMaker
from model.data.scene_walls import SceneWalls
from model.data.shards import Shards
from model.network.channels import IMAGES_AT_ONCE
from model.run_folder.run_config import RunConfig


def rendered_channels(config: RunConfig, shards: Shards, rows: Sequence[int]) -> Tensor:
    """(n, C, H, W) input channels of some scenes as rendered."""
    frequencies_hz = shards.manifest.frequencies_hz
    wall = config.geometry.expected_wall(shards.reference, frequencies_hz)
    maker = BatchMaker.for_shards(
        *(config.inputs, frequencies_hz, wall, torch.device("cpu")),
        walls=SceneWalls.of_shards(config.geometry, shards, config.inputs.frequencies_hz),
    )
    parts = [rows[start : start + IMAGES_AT_ONCE] for start in range(0, len(rows), IMAGES_AT_ONCE)]
    return torch.cat([maker.batch(maker.upload(shards.read(part))).channels for part in parts])
