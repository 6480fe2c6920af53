"""Augmentation: turned, shifted, flipped and noisy copies of a batch, alike in input and truth."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from model.batches import Batch

AugmentationName = Literal["none", "flip", "paper"]
AUGMENTATIONS: tuple[AugmentationName, ...] = ("none", "flip", "paper")


@dataclass(frozen=True)
class Warp:
    """Geometric change of every image of a batch: flipped, then turned, then shifted.

    Attributes
    ----------
    flip_rows, flip_columns : (N,) bool.
    angle_rad : (N,) turn, from the image's right towards its down (clockwise on the screen).
    shift : (N, 2) move to the right and down, as fractions of width and height.
    """

    flip_rows: Tensor
    flip_columns: Tensor
    angle_rad: Tensor
    shift: Tensor

    def __call__(self, batch: Batch) -> Batch:
        """The warped batch.

        Inputs are interpolated bilinearly; beyond the frame they repeat the edge: the field on the wall is
        smooth, so that is its simplest continuation, where a reflection would show a second object's light
        that the truth knows nothing of. Truth is taken from the nearest pixel (between object and
        background there is no meaningful phasor or depth) and is background beyond the frame.
        """
        truth = torch.cat([batch.target, batch.radial_depth_m[:, None], batch.mask[:, None]], dim=1)
        channels, truth = self._flipped(batch.channels), self._flipped(truth)
        if bool(self.angle_rad.any()) or bool(self.shift.any()):
            grid = self._grid(channels)
            channels = functional.grid_sample(
                channels, grid, mode="bilinear", padding_mode="border", align_corners=False
            )
            truth = functional.grid_sample(
                truth, grid, mode="nearest", padding_mode="zeros", align_corners=False
            )
        return Batch(channels, target=truth[:, :2], radial_depth_m=truth[:, 2], mask=truth[:, 3])

    def _flipped(self, images: Tensor) -> Tensor:
        for flip, axis in ((self.flip_rows, -2), (self.flip_columns, -1)):
            chosen = flip.to(images.device)[:, None, None, None]
            images = torch.where(chosen, images.flip(axis), images)
        return images

    def _grid(self, images: Tensor) -> Tensor:
        """(N, H, W, 2) where each output pixel comes from: the inverse turn of the unshifted position.

        `grid_sample` measures in half widths and half heights, so the turn, which is rigid in pixels, gains
        the aspect ratio, and a shift by a fraction of the width counts twice.
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
class Augmentation:
    """What may happen to a training image; every part can be switched off.

    Attributes
    ----------
    flip_rows : flip top and bottom, every second image. An exact symmetry of the scene (DESIGN 4.11).
    flip_columns : flip left and right, every second image. Not a symmetry.
    rotation_deg : turn by up to this many degrees either way. Not a symmetry.
    translation : shift by up to this fraction of width and height either way. Not a symmetry.
    noise_std : (C,) standard deviation of Gaussian noise added to each input channel, in the channel's own
        unit (`InputSpec.noise_std` gives it for a sensor noise); None for no noise.
    """

    flip_rows: bool = False
    flip_columns: bool = False
    rotation_deg: float = 0.0
    translation: float = 0.0
    noise_std: Tensor | None = None

    def draw_warp(self, count: int, generator: torch.Generator) -> Warp:
        """Random warps of `count` images. The stream advances alike whatever is switched on."""
        flips = torch.rand(count, 2, generator=generator) < 0.5
        angle = 2 * torch.rand(count, generator=generator) - 1  # -1..1
        shift = 2 * torch.rand(count, 2, generator=generator) - 1
        return Warp(
            flip_rows=flips[:, 0] & self.flip_rows,
            flip_columns=flips[:, 1] & self.flip_columns,
            angle_rad=angle * (self.rotation_deg * pi / 180),
            shift=shift * self.translation,
        )

    def __call__(self, batch: Batch, generator: torch.Generator) -> Batch:
        """A randomly changed batch; `generator` lives on the CPU, so all devices see the same changes."""
        warped = self.draw_warp(len(batch.channels), generator)(batch)
        if self.noise_std is None:
            return warped
        noise = torch.randn(warped.channels.shape, generator=generator) * self.noise_std[:, None, None]
        channels = warped.channels + noise.to(warped.channels)
        return Batch(channels, warped.target, warped.radial_depth_m, warped.mask)


def augmentation_named(name: AugmentationName, noise_std: Tensor | None = None) -> Augmentation:
    """``none``; ``flip``: the one exact symmetry, top against bottom; ``paper``: all of the paper's.

    Source of the ranges: Caligiuri et al. 2024, sec. 5.1 (±180 degrees, ±0.2 of width and height, flips).
    """
    if name == "none":
        return Augmentation(noise_std=noise_std)
    if name == "flip":
        return Augmentation(flip_rows=True, noise_std=noise_std)
    return Augmentation(
        flip_rows=True, flip_columns=True, rotation_deg=180.0, translation=0.2, noise_std=noise_std
    )
