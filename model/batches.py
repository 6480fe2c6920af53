"""Rows of the shards as tensors: what one training step sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from model.inputs import InputSpec
from model.shards import Shards


@dataclass(frozen=True)
class Batch:
    """Network input and ground truth of some scenes, on one device, float32.

    Attributes
    ----------
    channels : (N, C, H, W) network input.
    target : (N, 2, H, W) Re and Im of the mirrored scene.
    radial_depth_m : (N, H, W) true depth, 0 on background.
    mask : (N, H, W) true mask, 0 or 1.
    """

    channels: Tensor
    target: Tensor
    radial_depth_m: Tensor
    mask: Tensor


def load_batch(shards: Shards, rows: Sequence[int], inputs: InputSpec, device: torch.device) -> Batch:
    """Read rows from disk, make their network channels and put them on `device`."""
    chosen = list(rows)
    channels = inputs.apply(shards.complex_phasors(chosen), shards.reference)
    return Batch(
        channels=torch.from_numpy(channels).to(device),
        target=torch.from_numpy(np.array(shards.target[chosen])).to(device),
        radial_depth_m=torch.from_numpy(np.array(shards.radial_depth_m[chosen])).to(device),
        mask=torch.from_numpy(shards.mask[chosen].astype(np.float32)).to(device),
    )
