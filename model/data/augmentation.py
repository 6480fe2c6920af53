"""Augmentation: turned, shifted, flipped and noisy copies of a batch, alike in input and truth."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import pi

import torch
from torch import Tensor
from torch.nn import functional

from model.data.batches import Batch, BatchMaker
from model.data.rows import RowBlock
from model.settings import TrainSettings


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
class Draws:
    """What chance decided for each of N images, whatever is switched on.

    Attributes
    ----------
    coins : (N, 2) bool, flips of rows and of columns.
    turn, brightness : (N,) in [-1, 1).
    shift : (N, 2) in [-1, 1).
    noise_seed : (N,) int64, of each image's own stream of noise: an image's noise does not depend on the
        batch or the process that it is in.
    """

    coins: Tensor
    turn: Tensor
    shift: Tensor
    brightness: Tensor
    noise_seed: Tensor

    @classmethod
    def of(cls, count: int, generator: torch.Generator) -> Draws:
        """Draws for `count` images; `generator` lives on the CPU, so all devices see the same changes."""
        uniform = 2 * torch.rand(count, 4, generator=generator) - 1  # -1..1
        return cls(
            coins=torch.rand(count, 2, generator=generator) < 0.5,
            turn=uniform[:, 0],
            shift=uniform[:, 1:3],
            brightness=uniform[:, 3],
            noise_seed=torch.randint(2**62, (count,), generator=generator),
        )

    def __getitem__(self, which: slice | list[int]) -> Draws:
        return Draws(*(getattr(self, field.name)[which] for field in fields(self)))


@dataclass(frozen=True)
class Augmentation:
    """What may happen to a training image; every part can be switched off.

    The measurement is changed first (brightness, noise), then its channels and the truth are warped.

    Attributes
    ----------
    flip_rows : flip top and bottom, every second image. An exact symmetry (docs/design.md, Symmetry).
    flip_columns : flip left and right, every second image. Not a symmetry.
    rotation_deg : turn by up to this many degrees either way. Not a symmetry.
    translation : shift by up to this fraction of width and height either way. Not a symmetry.
    amplitude_spread : s, all phasors of an image times one factor from 1 / (1 + s) to 1 + s, even in its
        logarithm; what another exposure or emitter power would do, so exact.
    noise_sigma : standard deviation of Gaussian sensor noise on each phasor component, as a fraction of the
        pixel's amplitude at the first frequency.

    Source of the first four: Caligiuri et al. 2024, sec. 5.1.
    """

    flip_rows: bool = False
    flip_columns: bool = False
    rotation_deg: float = 0.0
    translation: float = 0.0
    amplitude_spread: float = 0.0
    noise_sigma: float = 0.0

    @classmethod
    def of(cls, settings: TrainSettings) -> Augmentation:
        """What the settings of a run ask for."""
        return cls(**{field.name: getattr(settings, field.name) for field in fields(cls)})

    def warp(self, draws: Draws) -> Warp:
        """The geometric part, for each image."""
        return Warp(
            flip_rows=draws.coins[:, 0] & self.flip_rows,
            flip_columns=draws.coins[:, 1] & self.flip_columns,
            angle_rad=draws.turn * (self.rotation_deg * pi / 180),
            shift=draws.shift * self.translation,
        )

    def measured(self, phasor: Tensor, draws: Draws) -> Tensor:
        """(N, H, W, F) phasors as a noisy sensor with another exposure would have measured them."""
        if self.amplitude_spread > 0:
            gain = (1 + self.amplitude_spread) ** draws.brightness  # (N,)
            phasor = phasor * gain.to(phasor.device)[:, None, None, None]
        if self.noise_sigma > 0:
            noise = torch.stack([_noise(phasor[0], int(seed)) for seed in draws.noise_seed])
            phasor = phasor + self.noise_sigma * phasor[..., :1].abs() * noise
        return phasor

    def __call__(self, rows: RowBlock, maker: BatchMaker, draws: Draws) -> Batch:
        """The batch of `rows`, changed as chance decided for each of them."""
        return self.warp(draws)(maker.batch(rows, self.measured(maker.measured(rows), draws)))


def _noise(like: Tensor, seed: int) -> Tensor:
    """Complex Gaussian noise of unit variance in *each* component, of the shape and device of `like`."""
    generator = torch.Generator(like.device).manual_seed(seed)
    components = torch.randn(*like.shape, 2, generator=generator, device=like.device)
    return torch.view_as_complex(components)
