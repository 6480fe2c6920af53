"""The numbers of a pixel in a transient file: stretches of its time axis, beyond which it has no light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from itof.light import phase_per_metre
from itof.measurement import MeasurementMatrix
from itof.splat import Splat


class StretchError(ValueError):
    """The first bin of a stretch is no bin of the time axis, or the stretch ends beyond it."""


@dataclass(frozen=True)
class Stretches:
    """Which bins the numbers of a pixel are.

    Attributes
    ----------
    counts : number of bins of each of S stretches. Where stretches overlap, their bins add up.
    first_bin : where the only stretch begins in all pixels. None: each pixel has its own first bins, which
        are the first S of its numbers; the bins of all stretches follow.
    """

    counts: tuple[int, ...]
    first_bin: int | None = None

    @property
    def numbers(self) -> int:
        """Numbers of a pixel."""
        return sum(self.counts) + (len(self.counts) if self.first_bin is None else 0)

    def parts(
        self, rows: NDArray[np.float32], bin_count: int
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float32]]]:
        """First bin (rows, W) and bins (rows, W, K) of each stretch.

        Parameters
        ----------
        rows : (rows, W, numbers).
        bin_count : T, of the time axis.

        Raises
        ------
        StretchError : the numbers are damaged.
        """
        place = len(self.counts) if self.first_bin is None else 0
        for stretch, count in enumerate(self.counts):
            if self.first_bin is None:
                first = rows[..., stretch]
            else:
                first = np.full(rows.shape[:2], self.first_bin, np.float32)
            if not ((first >= 0) & (first <= bin_count - count) & (first == np.floor(first))).all():
                raise StretchError(f"a pixel has bins that are none of its {bin_count}")
            yield first.astype(np.int64), rows[..., place : place + count]
            place += count

    def unpacked(self, rows: NDArray[np.float32], bin_count: int) -> NDArray[np.float32]:
        """(rows, W, T) all bins of pixels, from their numbers (rows, W, numbers).

        Raises
        ------
        StretchError : the numbers are damaged.
        """
        if self.first_bin == 0 and self.counts == (bin_count,):
            return rows
        dense = np.zeros((*rows.shape[:2], bin_count), np.float32)
        y, x = np.indices(rows.shape[:2])
        for first, bins in self.parts(rows, bin_count):
            sliding_window_view(dense, bins.shape[2], axis=2, writeable=True)[y, x, first] += bins
        return dense

    def phasors(
        self,
        rows: NDArray[np.float32],
        frequencies_hz: Sequence[float],
        axis: tuple[int, float, float],
        splat: Splat,
    ) -> NDArray[np.complex128]:
        """(rows, W, F) phasors of pixels, from their numbers (rows, W, numbers), as `MeasurementMatrix`.

        Parameters
        ----------
        axis : T; bin width and start, metres.

        Raises
        ------
        StretchError : the numbers are damaged.
        ValueError : as of `MeasurementMatrix`.
        """
        bin_count, bin_width_m, start_opl_m = axis
        turns = phase_per_metre(frequencies_hz) * bin_width_m
        total = np.zeros((*rows.shape[:2], len(turns)), complex)
        for first, bins in self.parts(rows, bin_count):
            phi = MeasurementMatrix(tuple(frequencies_hz), bins.shape[2], bin_width_m, start_opl_m, splat)
            total += phi.apply_streaming([bins]) * np.exp(1j * turns * first[..., None])
        return total
