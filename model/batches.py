"""Rows of the shards as tensors: what one training step sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from model.inputs import InputSpec
from model.rows import RowBlock


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


def make_batch(
    block: RowBlock, reference: NDArray[np.complex128], inputs: InputSpec, device: torch.device
) -> Batch:
    """Network channels and ground truth of rows that were read, on `device`.

    Parameters
    ----------
    reference : (H, W, F) direct return of the bare relay wall.
    """
    channels = inputs.apply(block.complex_phasors(), reference)
    return Batch(
        channels=torch.from_numpy(channels).to(device),
        target=torch.from_numpy(block.target).to(device),
        radial_depth_m=torch.from_numpy(block.radial_depth_m).to(device),
        mask=torch.from_numpy(block.mask.astype(np.float32)).to(device),
    )
