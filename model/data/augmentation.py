"""Augmentation: random brightness, noise and flips of the images of a batch."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from model.data.batches import Batch, BatchMaker
from model.data.rows import RowBlock


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
    kind : (N,) int64, the one change of the paper that each image gets (`model.paper.augmentation.KINDS`);
        None if an image may get several.
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


@dataclass(frozen=True)
class Augmentation:
    """Random changes of training images; the defaults change nothing.

    Brightness and noise of the phasors change the measurement; the input channels are then computed from it.
    The changes of the paper are `model.paper.augmentation.PaperAugmentation`.

    Attributes
    ----------
    flip_rows : flip top and bottom with probability 1/2; exact (docs/science/design.md, Symmetry).
    amplitude_spread : s; multiply all phasors of an image by one factor between 1 / (1 + s) and 1 + s,
        uniform in its logarithm. Exact: another exposure or emitter power has the same effect.
    noise_sigma : standard deviation of Gaussian noise on each phasor component, as a fraction of the pixel's
        amplitude at the first frequency.
    largest_noise_sigma : if not 0, each image has its own deviation between `noise_sigma` and this, uniform
        in its logarithm.
    """

    flip_rows: bool = False
    amplitude_spread: float = 0.0
    noise_sigma: float = 0.0
    largest_noise_sigma: float = 0.0

    def measured(self, phasor: Tensor, draws: Draws) -> Tensor:
        """(N, H, W, F) phasors with random brightness and noise."""
        if self.amplitude_spread > 0:
            gain = (1 + self.amplitude_spread) ** draws.brightness  # (N,)
            phasor = phasor * gain.to(phasor.device)[:, None, None, None]
        if self.noise_sigma > 0:
            noise = torch.stack([self._noise(phasor[0], int(seed)) for seed in draws.noise_seed])
            phasor = phasor + phasor[..., :1].abs() * noise
        return phasor

    def _noise(self, like: Tensor, seed: int) -> Tensor:
        """Noise of an image over its amplitude, shaped like `like` and on its device."""
        sigma = self.noise_sigma
        if self.largest_noise_sigma > 0:
            share = float(torch.rand(1, generator=torch.Generator().manual_seed(seed + 1)))
            sigma *= (self.largest_noise_sigma / sigma) ** share
        return sigma * _noise(like, seed)

    def changed(self, batch: Batch, draws: Draws) -> Batch:
        """The batch with half of its images upside down."""
        if not self.flip_rows:
            return batch
        return flipped(batch, draws.coins[:, 0], -2)

    def __call__(self, rows: RowBlock, maker: BatchMaker, draws: Draws) -> Batch:
        """The batch of `rows`, each row changed by its draws, then measured by the camera of `maker`."""
        phasor = self.measured(rows.phasors, draws)
        if maker.camera is not None:
            phasor = maker.camera(phasor, draws.noise_seed.tolist())
        return self.changed(maker.batch(rows, phasor), draws)


def flipped(batch: Batch, chosen: Tensor, axis: int) -> Batch:
    """The batch with the images that (N,) bool `chosen` says flipped along an axis, -2 or -1.

    Input and ground truth change alike.
    """

    def of(images: Tensor) -> Tensor:
        which = chosen.to(images.device).view(-1, *(1,) * (images.ndim - 1))
        return torch.where(which, images.flip(axis), images)

    return Batch(*(of(getattr(batch, field.name)) for field in fields(Batch)))


def _noise(like: Tensor, seed: int) -> Tensor:
    """Complex Gaussian noise with variance 1 in *each* component, shaped like `like` and on its device."""
    generator = torch.Generator(like.device).manual_seed(seed)
    components = torch.randn(*like.shape, 2, generator=generator, device=like.device)
    return torch.view_as_complex(components)
