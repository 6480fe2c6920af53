"""The measurement matrix Φ: from time-resolved pixels to iToF phasors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from disk.frequency_text import megahertz
from itof.light import SPEED_OF_LIGHT, phase_per_metre
from itof.splat import Splat, splat_transfer


@dataclass(frozen=True)
class MeasurementMatrix:
    """Φ for one time axis and one set of frequencies; build it once and apply it to many pixels.

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    bin_count : T, number of time bins.
    bin_width_m : bin width in *optical path length* (out and back), metres.
    start_opl_m : optical path length where the first bin begins, metres.
    splat : how returns were put into bins (`itof.splat`): ``point``, Φ is exp(j 2π f tau_t); ``tent`` or
        ``quadratic``, it divides by sinc²(f w / c) or sinc³(f w / c). What Φ cannot undo is
        `itof.splat_residue`.

    Raises
    ------
    ValueError : no frequencies, no bins, a width that is not positive, or a frequency at or above
        c / (2 bin_width_m), which these bins cannot resolve.

    Source: Caligiuri et al. 2024, sec. 3.2 (c_mf = Φ x); cosines, sines and bin centres are our choice.
    """

    frequencies_hz: tuple[float, ...]
    bin_count: int
    bin_width_m: float
    start_opl_m: float = 0.0
    splat: Splat = "point"

    def __post_init__(self) -> None:
        if not self.frequencies_hz:
            raise ValueError("a measurement needs at least one modulation frequency, got none")
        if self.bin_count < 1 or not self.bin_width_m > 0:
            raise ValueError(
                f"a time axis needs bins of positive width, got {self.bin_count} bins of {self.bin_width_m} m"
            )
        phase_per_metre(self.frequencies_hz)
        limit_hz = SPEED_OF_LIGHT / (2 * self.bin_width_m)  # Nyquist: at least two bins a period
        too_fast = [f for f in self.frequencies_hz if f >= limit_hz]
        if too_fast:
            raise ValueError(
                f"bins of {self.bin_width_m} m cannot resolve {megahertz(too_fast[0])}: "
                f"use frequencies below {megahertz(limit_hz)} or narrower bins"
            )

    @property
    def bin_centres_m(self) -> NDArray[np.float64]:
        """(T,) optical path length of every bin's centre, metres."""
        return self.start_opl_m + (np.arange(self.bin_count) + 0.5) * self.bin_width_m

    @property
    def rows(self) -> NDArray[np.float64]:
        """(2F, T) real matrix Φ: F rows of cosines, then F rows of sines."""
        turns = phase_per_metre(self.frequencies_hz)  # (F,)
        angle_rad = np.outer(turns, self.bin_centres_m)  # (F, T)
        rows = np.stack([np.cos(angle_rad), np.sin(angle_rad)])  # (2, F, T)
        rows /= splat_transfer(self.frequencies_hz, self.bin_width_m, self.splat)[:, None]
        return rows.reshape(-1, self.bin_count)  # (2F, T)

    def apply(self, transient: ArrayLike) -> NDArray[np.complex128]:
        """Phasors of `transient` (..., T): (..., F) complex in the same unit, summed in float64.

        Raises
        ------
        ValueError : the last axis does not have T entries.
        """
        x = np.asarray(transient, dtype=np.float64)
        if x.ndim == 0 or x.shape[-1] != self.bin_count:
            raise ValueError(f"expected {self.bin_count} time bins on the last axis, got shape {x.shape}")
        return _joined(x @ self.rows.T)

    def apply_streaming(self, row_blocks: Iterable[NDArray[np.float32]]) -> NDArray[np.complex128]:
        """Phasors of an image that arrives in blocks of rows, each (rows, W, T): (H, W, F) complex.

        Only one block is in memory at a time.
        """
        return np.concatenate(list(self._apply_each(row_blocks)), axis=0)

    def _apply_each(self, row_blocks: Iterable[NDArray[np.float32]]) -> Iterator[NDArray[np.complex128]]:
        rows = self.rows.T
        for block in row_blocks:
            # One image row at a time is converted: a float64 copy of a block would need twice its memory.
            yield _joined(np.stack([row.astype(np.float64) @ rows for row in block]))


def phasors(
    transient: ArrayLike, frequencies_hz: Sequence[float], bin_width_m: float, *, start_opl_m: float = 0.0
) -> NDArray[np.complex128]:
    """Complex iToF phasors of time-resolved pixels.

    z_f = sum_t transient[..., t] * exp(+2j π f tau_t),  tau_t = (start_opl_m + (t + 1/2) bin_width_m) / c

    Parameters
    ----------
    transient : (..., T) float array, radiant energy per bin of optical path length.
    frequencies_hz : F modulation frequencies, Hz.
    bin_width_m : bin width in *optical path length* (out and back), metres.

    Returns
    -------
    (..., F) complex array, in the unit of `transient`.

    Raises
    ------
    ValueError : a frequency at or above c / (2 bin_width_m), which these bins cannot resolve.

    Source: Caligiuri et al. 2024, sec. 3.2 (c_mf = Φ x); cosines, sines and bin centres are our choice.
    """
    x = np.asarray(transient)
    return MeasurementMatrix(tuple(frequencies_hz), x.shape[-1], bin_width_m, start_opl_m).apply(x)


def _joined(components: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Products (..., 2F) with the cosines, then the sines of Φ as (..., F) complex phasors."""
    real, imaginary = np.split(components, 2, axis=-1)
    return real + 1j * imaginary
