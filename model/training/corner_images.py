"""The images of the three bounces, for the corner of the dataset that a training begins with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor

from model.data.batches import BatchMaker
from model.data.object_depth import object_depth_m
from model.data.scene_walls import SceneWalls
from model.data.shards import Shards
from model.network.channels import IMAGES_AT_ONCE
from model.refinement.light.corner_light import known_corner
from model.refinement.light.inverse import bounce_inverse
from model.run_folder.run_config import RunConfig
from scenegen import Dataset

_SCENES: Final = 64  # whose images have the variance 1


def corner_images(
    config: RunConfig, dataset: Dataset, shards: Shards, rows: Sequence[int]
) -> dict[str, Tensor]:
    """What the weights of a new run contain of the corner of its dataset, by name; empty without images.

    Parameters
    ----------
    rows : rows of the training scenes. The images of the first of them get the variance 1, as the residual
        channels have.

    Raises
    ------
    BalanceError : the scenes have no object pixel.
    """
    images = config.network().images
    if images is None:
        return {}
    depth_m = config.object_depth_m or object_depth_m(shards, rows)
    images.load_state_dict(
        bounce_inverse(
            images, known_corner(dataset.scene(dataset.ids()[0])), config.geometry, config.inputs, depth_m
        )
    )
    deviation = images(_rendered_channels(config, shards, rows[:_SCENES])).std()
    if deviation > 0:
        images.project /= deviation
    return {f"images.{name}": array for name, array in images.state_dict().items()}


def _rendered_channels(config: RunConfig, shards: Shards, rows: Sequence[int]) -> Tensor:
    """(n, C, H, W) input channels of scenes as rendered: without augmentation, and without a camera."""
    frequencies_hz = shards.manifest.frequencies_hz
    wall = config.geometry.expected_wall(shards.reference, frequencies_hz)
    maker = BatchMaker.for_shards(
        *(config.inputs, frequencies_hz, wall, torch.device("cpu")),
        walls=SceneWalls.of_shards(config.geometry, shards, config.inputs.frequencies_hz),
    )
    parts = [rows[start : start + IMAGES_AT_ONCE] for start in range(0, len(rows), IMAGES_AT_ONCE)]
    return torch.cat([maker.batch(maker.upload(shards.read(part))).channels for part in parts])
