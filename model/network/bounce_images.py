"""Images of what is behind the wall, which a linear inverse of the three bounces makes of input channels."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

# Runs that were trained with other numbers cannot be read: these decide the shapes of what is saved.
PLANES: Final = 6  # depths
COLUMNS: Final = 16  # of an image of one depth, before it is enlarged
SEEN_COLUMNS: Final = 20  # of the input channels: the hidden light is smooth over the wall
RANK: Final = 180  # dimensions of the images that show in the light, at most


class BounceImages(nn.Module):
    """Blurred images of what is at each of `PLANES` depths.

    Each part of the wall shows light of the whole object. A convolution sees a small part of the wall, so a
    U-Net has to learn from scenes how the light of all parts belongs together. In a known corner, the three
    bounces are known: a regularised linear inverse of them (`model.refinement.light.inverse`) makes
    images of the mirrored scene from the input channels. The network sees them beside its input channels.

    Attributes
    ----------
    project : (k, K r c) float32, from K residual channels of r x c parts of the wall to k numbers.
    expand : (PLANES R C, k) float32, from these to images of R x C pixels.

    These are no weights that are trained, but they are saved with them.

    Parameters
    ----------
    first, count : which K of the input channels are the residual ones (`InputSpec.residual_channels`).
    width, height : size of the training images; other sizes of the same shape give the same images.

    Source: ours; the regularisation is Tikhonov's.
    """

    project: Tensor
    expand: Tensor

    def __init__(self, first: int, count: int, width: int, height: int) -> None:
        super().__init__()
        self.channels = slice(first, first + count)
        self.shape, self.seen = _parts(COLUMNS, width, height), _parts(SEEN_COLUMNS, width, height)
        voxels, values = PLANES * self.shape[0] * self.shape[1], count * self.seen[0] * self.seen[1]
        rank = min(RANK, voxels, values)
        self.register_buffer("project", torch.zeros(rank, values))
        self.register_buffer("expand", torch.zeros(voxels, rank))

    def forward(self, channels: Tensor) -> Tensor:
        """(N, PLANES, H, W) images, in the number type of `project`, of (N, C, H, W) input channels."""
        height, width = channels.shape[-2:]
        with torch.autocast(channels.device.type, enabled=False):
            wall = channels[:, self.channels].to(self.project.dtype)
            seen = _means(self.seen[0], height, wall) @ wall @ _means(self.seen[1], width, wall).mT
            images = seen.flatten(1) @ self.project.mT @ self.expand.mT
            images = images.unflatten(1, (PLANES, *self.shape))
            return functional.interpolate(images, (height, width), mode="bilinear", align_corners=False)


def _parts(columns: int, width: int, height: int) -> tuple[int, int]:
    """Rows and columns of nearly square parts of an image; in very tall images, the parts are tall."""
    return max(1, min(round(columns * height / width), 4 * columns)), columns


def _means(count: int, pixels: int, like: Tensor) -> Tensor:
    """(count, pixels) matrix that takes the mean of each of `count` equal parts of an axis."""
    edges = torch.arange(count + 1, dtype=like.dtype, device=like.device) * (pixels / count)
    pixel = torch.arange(pixels, dtype=like.dtype, device=like.device)
    last = torch.minimum(edges[1:, None], pixel + 1)  # (count, pixels)
    covered = (last - torch.maximum(edges[:-1, None], pixel)).clamp(min=0)
    return covered * (count / pixels)
