"""Augmentation: random brightness, noise, flips, rotations and shifts of the images of a batch."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from itof.weighted_reference import quotient
from model.data.batches import Batch, BatchMaker
from model.data.rows import RowBlock
from model.settings import TrainSettings


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
class Draws:
    """Random numbers for N images; they do not depend on which changes are switched on.

    Attributes
    ----------
    coins : (N, 2) bool, for the flips of rows and of columns.
    turn, brightness : (N,) in [-1, 1).
    shift : (N, 2) in [-1, 1).
    noise_seed : (N,) int64, seed of each image's noise, of the phasors and of the channels. Because every
        image has its own, its noise does not depend on its batch or process.
    kind : (N,) int64, place in `KINDS` of the one change of each image, or `UNCHANGED` for none of them;
        None if the augmentation decides.
    """

    coins: Tensor
    turn: Tensor
    shift: Tensor
    brightness: Tensor
    noise_seed: Tensor
    kind: Tensor | None = None

    @classmethod
    def of(cls, count: int, generator: torch.Generator) -> Draws:
        """Draws for `count` images; `generator` is on the CPU, so that all devices get the same draws."""
        uniform = 2 * torch.rand(count, 4, generator=generator) - 1
        return cls(
            coins=torch.rand(count, 2, generator=generator) < 0.5,
            turn=uniform[:, 0],
            shift=uniform[:, 1:3],
            brightness=uniform[:, 3],
            noise_seed=torch.randint(2**62, (count,), generator=generator),
        )

    def __getitem__(self, which: slice | list[int]) -> Draws:
        arrays = [getattr(self, field.name) for field in fields(self)]
        return Draws(*(None if array is None else array[which] for array in arrays))  # type: ignore[arg-type]


KINDS = ("flip_rows", "flip_columns", "rotation", "shift", "channel_noise")  # the paper's changes
UNCHANGED = len(KINDS)


@dataclass(frozen=True)
class Augmentation:
    """Random changes of training images; the defaults change nothing.

    Brightness and noise of the phasors change the measurement. The input channels are then computed from it,
    `Warp` transforms channels and ground truth, and the noise of the channels is added at last, so that no
    interpolation makes it smaller.

    Attributes
    ----------
    flip_rows : flip top and bottom with probability 1/2; exact (docs/science/design.md, Symmetry).
    flip_columns : flip left and right with probability 1/2. Not a symmetry.
    rotation_deg : rotate by up to this angle in either direction, degrees. Not a symmetry.
    translation : shift by up to this fraction of width and height in either direction. Not a symmetry.
    amplitude_spread : s; multiply all phasors of an image by one factor between 1 / (1 + s) and 1 + s,
        uniform in its logarithm. Exact: another exposure or emitter power has the same effect.
    least_reflectance : multiply the hidden light of an image by one factor between this and 1, uniform.
        Exact for light of three bounces: it meets the object once, so it is proportional to its reflectance.
    noise_sigma : standard deviation of Gaussian noise on each phasor component, as a fraction of the pixel's
        amplitude at the first frequency.
    channel_noise_sigma : standard deviation of Gaussian noise on every input channel, in the channel's own
        unit. In the paper's channels, 1 is about 170 times the hidden light of a pixel; in the residual
        channels, which have unit variance, it is as much as the hidden light (notebook/training.md).
    channel_noise_fraction : probability with which an image gets the noise of the channels.
    change_fraction : if it is not 0, an image gets at most one change of `KINDS`, each with this probability;
        `channel_noise_fraction` is then 1. With 0, changes are independent, and an image may get several.
        Draws that say the kind of change of an image (`model.data.enlarged_set`) take its place.

    Source: Caligiuri et al. 2024, sec. 4.2 (flips, rotation, translation, and noise with deviation 1). That
    the noise is on the channels, and that each change is made to images of its own, is the released code's.
    """

    flip_rows: bool = False
    flip_columns: bool = False
    rotation_deg: float = 0.0
    translation: float = 0.0
    amplitude_spread: float = 0.0
    least_reflectance: float = 1.0
    noise_sigma: float = 0.0
    channel_noise_sigma: float = 0.0
    channel_noise_fraction: float = 1.0
    change_fraction: float = 0.0

    @classmethod
    def of(cls, settings: TrainSettings) -> Augmentation:
        """The augmentation that the settings of a run specify."""
        return cls(**{field.name: getattr(settings, field.name) for field in fields(cls)})

    def warp(self, draws: Draws) -> Warp:
        """The geometric transform of each image."""
        flip_rows, flip_columns = draws.coins[:, 0], draws.coins[:, 1]
        turn, shift = draws.turn, draws.shift
        kinds = self._kinds(draws)
        if kinds is not None:
            flip_rows, flip_columns = kinds == KINDS.index("flip_rows"), kinds == KINDS.index("flip_columns")
            turn = turn * (kinds == KINDS.index("rotation"))
            shift = shift * (kinds == KINDS.index("shift"))[:, None]
        return Warp(
            flip_rows=flip_rows & self.flip_rows,
            flip_columns=flip_columns & self.flip_columns,
            angle_rad=turn * (self.rotation_deg * pi / 180),
            shift=shift * self.translation,
        )

    @property
    def kinds(self) -> tuple[str, ...]:
        """Those of `KINDS` that are switched on."""
        switches = (
            *(self.flip_rows, self.flip_columns, self.rotation_deg, self.translation),
            self.channel_noise_sigma,
        )
        return tuple(kind for kind, switch in zip(KINDS, switches, strict=True) if switch)

    def _kinds(self, draws: Draws) -> Tensor | None:
        """(N,) place in `KINDS` of the one change of each image, `UNCHANGED` or more for none.

        None if changes are independent.
        """
        if draws.kind is not None or not self.change_fraction:
            return draws.kind
        shares = torch.tensor([_share(int(seed), 4) for seed in draws.noise_seed], dtype=torch.float64)
        return (shares / self.change_fraction).floor().long()

    def darkened(self, phasor: Tensor, reference: Tensor | None, draws: Draws) -> Tensor:
        """(N, H, W, F) phasors with the hidden light of darker objects.

        The direct light is `reference` (N, H, W, F) with the amplitude of `phasor`. The real part of the
        hidden light at the first frequency is in that amplitude and stays. No residual channel depends on it;
        the paper's amplitude channel does, by up to 0.2 %.
        """
        if reference is None:
            return phasor
        shares = [_share(int(seed), 2) for seed in draws.noise_seed]
        part = torch.tensor(shares, device=phasor.device) * (1 - self.least_reflectance)
        bright = quotient(torch, phasor[..., :1].abs(), reference[..., :1].abs())
        return phasor - part[:, None, None, None] * (phasor - reference * bright)

    def measured(self, phasor: Tensor, draws: Draws) -> Tensor:
        """(N, H, W, F) phasors with random brightness and noise."""
        if self.amplitude_spread > 0:
            gain = (1 + self.amplitude_spread) ** draws.brightness  # (N,)
            phasor = phasor * gain.to(phasor.device)[:, None, None, None]
        if self.noise_sigma > 0:
            noise = torch.stack([_noise(phasor[0], int(seed)) for seed in draws.noise_seed])
            phasor = phasor + self.noise_sigma * phasor[..., :1].abs() * noise
        return phasor

    def seen(self, channels: Tensor, draws: Draws) -> Tensor:
        """(N, C, H, W) input channels, with noise on the images that get it."""
        if not (self.channel_noise_sigma > 0 and self.channel_noise_fraction > 0):
            return channels
        fractions = [self.channel_noise_fraction] * len(draws.noise_seed)
        kinds = self._kinds(draws)
        if kinds is not None:
            fractions = (kinds == KINDS.index("channel_noise")).double().tolist()
        noise = [
            _channel_noise(channels[0], int(seed), fraction)
            for seed, fraction in zip(draws.noise_seed, fractions, strict=True)
        ]
        return channels + self.channel_noise_sigma * torch.stack(noise)

    def __call__(self, rows: RowBlock, maker: BatchMaker, draws: Draws) -> Batch:
        """The batch of `rows`, each row changed by its draws, then measured by the camera of `maker`."""
        phasor = rows.phasors
        if self.least_reflectance < 1:
            known = rows.reference if rows.reference is not None else maker.reference(phasor)
            direct = None if known is None else maker.inputs.parted(known)[0]
            phasor = self.darkened(phasor, direct, draws)
        phasor = self.measured(phasor, draws)
        if maker.camera is not None:
            phasor = maker.camera(phasor, draws.noise_seed.tolist())
        batch = self.warp(draws)(maker.batch(rows, phasor))
        return replace(batch, channels=self.seen(batch.channels, draws))


def _share(seed: int, stream: int) -> float:
    """A number in [0, 1); streams 2 and 4 are others than those of the noise and of the camera (1 and 3)."""
    return float(np.random.default_rng(np.random.SeedSequence((seed, stream))).random())


def _noise(like: Tensor, seed: int) -> Tensor:
    """Complex Gaussian noise with variance 1 in *each* component, shaped like `like` and on its device."""
    generator = torch.Generator(like.device).manual_seed(seed)
    components = torch.randn(*like.shape, 2, generator=generator, device=like.device)
    return torch.view_as_complex(components)


def _channel_noise(like: Tensor, seed: int, fraction: float) -> Tensor:
    """Gaussian noise with variance 1, shaped like `like` and on its device, or 0.

    It is 0 with probability 1 - `fraction`. Its stream is another than that of `_noise` with the same seed.
    """
    own_seed, coin = np.random.SeedSequence((seed, 1)).generate_state(2, np.uint64)
    if int(coin) >= fraction * 2**64:
        return torch.zeros_like(like)
    generator = torch.Generator(like.device).manual_seed(int(own_seed >> np.uint64(1)))
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
