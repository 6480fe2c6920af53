"""What the network is fed: which channels, scaled by which constants of the training set."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import sqrt
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from itof import amplitude, network_channels, residual_channels
from model.order import rows_by_piece
from model.shards import Shards
from scenegen.preset import STRICT, Positive

Channels = Literal["paper", "residual", "paper+residual"]
CHANNELS: tuple[Channels, ...] = ("paper", "residual", "paper+residual")


@dataclass(frozen=True, config=STRICT)
class InputSpec:
    """How phasors become network channels; fitted once, kept with the run.

    ``paper`` is [A_0 / scale, Re_f / A_0, Im_f / A_0]: seven channels with three frequencies. ``residual``
    is what is left when the known phase of the wall's direct return is turned back (five channels with
    three frequencies), each divided by its standard deviation over the training scenes: it lifts the
    hidden 0.1-0.3 % to unit variance, without which a network learns little (DESIGN 4.9).

    Attributes
    ----------
    channels : which of the two sets, or both, paper first.
    frequencies_hz : F modulation frequencies, Hz.
    amplitude_scale : mean amplitude at the first frequency over the training scenes, in the phasors' unit.
    residual_scale : 2F - 1 standard deviations, without unit; empty when `channels` has no residual.

    Raises
    ------
    ValueError : a number of residual scales that does not fit.
    """

    channels: Channels
    frequencies_hz: Annotated[tuple[Positive, ...], Field(min_length=1)]
    amplitude_scale: Positive
    residual_scale: tuple[Positive, ...]

    def __post_init__(self) -> None:
        expected = self._residual_count if self.uses_residual else 0
        if len(self.residual_scale) != expected:
            raise ValueError(
                f"channels {self.channels} at {len(self.frequencies_hz)} frequencies need {expected} "
                f"residual scales, got {len(self.residual_scale)}"
            )

    @property
    def uses_residual(self) -> bool:
        """Whether the direct return is needed."""
        return "residual" in self.channels

    @property
    def channel_count(self) -> int:
        """C, the network's input channels."""
        return (self._paper_count if "paper" in self.channels else 0) + len(self.residual_scale)

    @property
    def _paper_count(self) -> int:
        return 1 + 2 * len(self.frequencies_hz)  # A_0, and two components a frequency

    @property
    def _residual_count(self) -> int:
        return 2 * len(self.frequencies_hz) - 1  # two components a frequency, less Re r_0

    def apply(self, phasor: ArrayLike, reference: ArrayLike | None = None) -> NDArray[np.float32]:
        """Network channels (..., C, H, W) of phasors (..., H, W, F).

        Parameters
        ----------
        reference : (H, W, F) direct return of the bare relay wall; needed by the residual channels alone.

        Raises
        ------
        ValueError : another number of frequencies, or no reference where one is needed.
        """
        z = np.asarray(phasor)
        if z.shape[-1] != len(self.frequencies_hz):
            raise ValueError(f"expected phasors at {len(self.frequencies_hz)} frequencies, got {z.shape[-1]}")
        parts = []
        if "paper" in self.channels:
            parts.append(network_channels(z, self.amplitude_scale))
        if self.uses_residual:
            if reference is None:
                raise ValueError(f"channels {self.channels} need the relay wall's direct return as reference")
            scale = np.asarray(self.residual_scale, dtype=np.float32)[:, None, None]  # (2F - 1, 1, 1)
            parts.append(residual_channels(z, reference) / scale)
        return np.concatenate(parts, axis=-3)

    def noise_std(self, sigma: float) -> NDArray[np.float32]:
        """(C,) standard deviation, in every channel, of sensor noise of `sigma` A_0 per phasor component.

        To first order, and with A_0 taken at its mean where it is the channel; a residual difference
        Re r_f - Re r_0 holds the noise of two components.
        """
        frequency_count = len(self.frequencies_hz)
        parts: list[float] = []
        if "paper" in self.channels:
            parts += [sigma] * self._paper_count
        if self.uses_residual:
            gain = [1.0] * frequency_count + [sqrt(2.0)] * (frequency_count - 1)
            parts += [sigma * g / scale for g, scale in zip(gain, self.residual_scale, strict=True)]
        return np.array(parts, dtype=np.float32)


def _phasors(shards: Shards, rows: Sequence[int]) -> Iterator[NDArray[np.complex128]]:
    """(H, W, F) phasors of one scene after the other."""
    for piece in rows_by_piece(rows, shards.manifest.scenes_per_piece):
        block = shards.read(piece)
        for row in piece:
            yield block.take([row]).complex_phasors()[0]


def fit_input_spec(channels: Channels, shards: Shards, rows: Sequence[int]) -> InputSpec:
    """Constants of the training scenes `rows`, read one piece of the shards at a time.

    Raises
    ------
    ValueError : no scenes, or scenes without any light.
    """
    if not rows:
        raise ValueError("the input channels are scaled by the training scenes, and there are none")
    amplitudes, means, squares = [], [], []
    for phasor in _phasors(shards, rows):
        amplitudes.append(amplitude(phasor[..., 0]).mean())
        if "residual" in channels:
            residual = residual_channels(phasor, shards.reference).astype(np.float64)  # (2F - 1, H, W)
            means.append(residual.mean(axis=(1, 2)))
            squares.append((residual**2).mean(axis=(1, 2)))
    if not np.mean(amplitudes) > 0:
        raise ValueError(f"the {len(rows)} training scenes hold no light at all: render them again")
    residual_scale: tuple[float, ...] = ()
    if "residual" in channels:
        variance = np.mean(squares, axis=0) - np.mean(means, axis=0) ** 2  # (2F - 1,)
        # A channel that never varies carries nothing, whatever it is divided by.
        residual_scale = tuple(float(np.sqrt(v)) if v > 0 else 1.0 for v in variance)
    return InputSpec(
        channels=channels,
        frequencies_hz=shards.manifest.frequencies_hz,
        amplitude_scale=float(np.mean(amplitudes)),
        residual_scale=residual_scale,
    )
