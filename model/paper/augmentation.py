"""The paper's changes of training images: flips, rotation, shift, and noise on the input channels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from model.data.augmentation import Augmentation, Draws, flipped
from model.data.batches import Batch

KINDS = ("flip_rows", "flip_columns", "rotation", "shift", "channel_noise")
UNCHANGED = len(KINDS)


@dataclass(frozen=True)
class Warp:
    """Geometric transform of every image of a batch: flip, then rotation, then shift.

    Attributes
    ----------
    flip_rows, flip_columns : (N,) bool; whether to flip top and bottom, left and right.
    angle_rad : (N,) rotation from the image's right to its bottom (clockwise on the screen), radians.
    shift : (N, 2) shift to the right and down, as fractions of width and height.
    """

    flip_rows: Tensor
    flip_columns: Tensor
    angle_rad: Tensor
    shift: Tensor

    def __call__(self, batch: Batch) -> Batch:
        """The transformed batch; input and ground truth change alike.

        The input is interpolated bilinearly. Outside the image it repeats the edge, because light on the wall
        varies smoothly; mirrored padding would show the light of a second object that the ground truth does
        not have. The ground truth is that of the nearest pixel, because a mean of object and background is no
        meaningful phasor or depth; outside the image it is background.
        """
        batch = flipped(flipped(batch, self.flip_rows, -2), self.flip_columns, -1)
        if not (bool(self.angle_rad.any()) or bool(self.shift.any())):
            return batch
        truth = torch.cat([batch.target, batch.radial_depth_m[:, None], batch.mask[:, None]], dim=1)
        grid = self._grid(batch.channels)
        channels = functional.grid_sample(
            batch.channels, grid, mode="bilinear", padding_mode="border", align_corners=False
        )
        truth = functional.grid_sample(truth, grid, mode="nearest", padding_mode="zeros", align_corners=False)
        return Batch(channels, target=truth[:, :2], radial_depth_m=truth[:, 2], mask=truth[:, 3])

    def _grid(self, images: Tensor) -> Tensor:
        """(N, H, W, 2) source position of each output pixel: shifted back, then rotated back.

        `grid_sample` measures positions in half widths and half heights. Therefore the aspect ratio enters
        the matrix of the rotation, and a shift by a fraction of the width counts twice.
        """
        height, width = images.shape[-2:]
        cos, sin = self.angle_rad.cos(), self.angle_rad.sin()
        rows = [
            torch.stack([cos, sin * height / width], dim=-1),
            torch.stack([-sin * width / height, cos], dim=-1),
        ]
        turn = torch.stack(rows, dim=-2)  # (N, 2, 2)
        offset = -turn @ (2 * self.shift[..., None])  # (N, 2, 1), in half image sizes
        theta = torch.cat([turn, offset], dim=-1).to(images)  # (N, 2, 3)
        return functional.affine_grid(theta, list(images.shape), align_corners=False)


@dataclass(frozen=True)
class PaperAugmentation(Augmentation):
    """Our changes and those of the paper, of which only the flip of the rows is a symmetry of the scene.

    The noise of the channels is added at last, so that no interpolation makes it smaller. Changes are
    independent, and an image may get several, unless its draws say which one it gets
    (`model.paper.enlarged_set`).

    Attributes
    ----------
    flip_columns : flip left and right with probability 1/2.
    rotation_deg : rotate by up to this angle in either direction, degrees.
    translation : shift by up to this fraction of width and height in either direction.
    channel_noise_sigma : standard deviation of Gaussian noise on every input channel, in the channel's own
        unit. In the paper's channels, 1 is about 170 times the hidden light of a pixel; in the residual
        channels, which have unit variance, it is as much as the hidden light (notebook/training.md).

    Source: Caligiuri et al. 2024, sec. 4.2 (flips, rotation, translation, and noise with deviation 1). That
    the noise is on the channels, and that each change is made to images of its own, is the released code's.
    """

    flip_columns: bool = False
    rotation_deg: float = 0.0
    translation: float = 0.0
    channel_noise_sigma: float = 0.0

    @property
    def kinds(self) -> tuple[str, ...]:
        """Those of `KINDS` that are switched on."""
        switches = (
            *(self.flip_rows, self.flip_columns, self.rotation_deg, self.translation),
            self.channel_noise_sigma,
        )
        return tuple(kind for kind, switch in zip(KINDS, switches, strict=True) if switch)

    def warp(self, draws: Draws) -> Warp:
        """The geometric transform of each image."""
        rows, columns, turns, shifts, _ = (self._gets(kind, draws) for kind in KINDS)
        coins = draws.coins if draws.kind is None else torch.ones_like(draws.coins)
        return Warp(
            flip_rows=rows & coins[:, 0] & self.flip_rows,
            flip_columns=columns & coins[:, 1] & self.flip_columns,
            angle_rad=draws.turn * turns * (self.rotation_deg * pi / 180),
            shift=draws.shift * shifts[:, None] * self.translation,
        )

    def seen(self, channels: Tensor, draws: Draws) -> Tensor:
        """(N, C, H, W) input channels, with noise on the images that get it."""
        if not self.channel_noise_sigma:
            return channels
        chosen = zip(channels, draws.noise_seed, self._gets("channel_noise", draws), strict=True)
        noise = [_channel_noise(image, int(seed), gets=bool(gets)) for image, seed, gets in chosen]
        return channels + self.channel_noise_sigma * torch.stack(noise)

    def changed(self, batch: Batch, draws: Draws) -> Batch:
        """The batch with flipped, turned, shifted and noisy images."""
        batch = self.warp(draws)(batch)
        return replace(batch, channels=self.seen(batch.channels, draws))

    @staticmethod
    def _gets(kind: str, draws: Draws) -> Tensor:
        """(N,) bool; whether an image may get a change of `KINDS`."""
        if draws.kind is None:
            return torch.ones(len(draws.noise_seed), dtype=torch.bool)
        return draws.kind == KINDS.index(kind)


def _channel_noise(like: Tensor, seed: int, *, gets: bool) -> Tensor:
    """Gaussian noise with variance 1, shaped like `like` and on its device, or 0 for an image without noise.

    Its stream is another than that of the noise of the phasors with the same seed.
    """
    if not gets:
        return torch.zeros_like(like)
    own_seed, _ = np.random.SeedSequence((seed, 1)).generate_state(2, np.uint64)
    generator = torch.Generator(like.device).manual_seed(int(own_seed >> np.uint64(1)))
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
