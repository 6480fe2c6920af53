"""Channels with the rays of the pixels, for networks that see images of several sizes and of any corner."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from model.network.channels import RAYS
from model.settings.input import averaged_over

# Standard deviations of a channel: bright objects near the wall have up to 27, edges of other surfaces a
# hundred.
LARGEST: Final = 30.0


def seen(channels: Tensor) -> tuple[Tensor, Tensor]:
    """Channels (N, C, H, W) as the U-Net sees them, (N, C, h, w), and (N, 1, 1, 1) which are turned half.

    Values are bounded. Large images are averaged to about 40 pixels a row: hidden light is smooth. The rays
    go to the right along the wall in each image: one whose camera looks to the left is turned half.
    """
    height, width = channels.shape[-2:]
    x = torch.cat([channels[:, :-RAYS].clamp(-LARGEST, LARGEST), upright(channels[:, -RAYS:])], dim=1)
    less = averaged_over(width)
    if less > 1:
        x = functional.interpolate(x, (max(1, height // less), width // less), mode="area")
    right = x[:, -RAYS]
    looks_left = (right[:, 0, -1] < right[:, 0, 0])[:, None, None, None]
    return torch.where(looks_left, x.flip((-2, -1)), x), looks_left


def answered(output: Tensor, looks_left: Tensor, size: tuple[int, int]) -> Tensor:
    """(N, C', H, W) the output (N, C', h, w) for what was `seen`, as an image of this size."""
    output = torch.where(looks_left, output.flip((-2, -1)), output)
    if output.shape[-2:] == size:
        return output
    return functional.interpolate(output, size, mode="bilinear", align_corners=False)


def upright(rays: Tensor) -> Tensor:
    """Rays (N, 3, H, W) of images that may have been flipped top to bottom, as those of a camera.

    A flip reverses the order of an image's rays, which no turn of a camera does. The flipped image is that of
    a camera whose rays go up instead of down, in the corner upside down.
    """
    one, two, three = rays[..., 0, 0], rays[..., 0, -1], rays[..., -1, 0]  # (N, 3)
    is_flipped = (torch.linalg.cross(one, two) * three).sum(-1) < 0  # x, y, z: right, down, forward
    ones = torch.ones_like(is_flipped, dtype=rays.dtype)
    sign = torch.stack([ones, torch.where(is_flipped, -ones, ones), ones], dim=-1)
    return rays * sign[..., None, None]
