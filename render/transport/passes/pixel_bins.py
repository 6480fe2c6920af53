"""Where the bins of a part of the light are among the numbers of a block of pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout
from itof.exr.stretches import Stretches

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis


@dataclass(frozen=True)
class PixelBins:
    """The bins of a part of the light.

    Attributes
    ----------
    first : (pixels,) first bin of each pixel of the image.
    axis : the time axis, with as many bins as a pixel has of this part.
    place : of the first of them among the numbers of a pixel.
    numbers : of a pixel.
    """

    first: NDArray[np.int64]
    axis: TimeAxis
    place: int
    numbers: int

    def begin(self, pixels: NDArray[np.int64], before: int) -> mi.UInt32:
        """Places of the first bins of pixels in a block before which there are so many pixels."""
        from render.transport.kernels import arrays

        return arrays.upload_indices((pixels - before) * self.numbers + self.place)

    def low(self, pixels: NDArray[np.int64]) -> mi.Int32:
        """First bins of pixels."""
        import mitsuba as mi

        from render.transport.kernels import arrays

        return mi.Int32(arrays.upload_indices(self.first[pixels]))


def pixel_bins(
    ends: list[tuple[NDArray[np.float64], NDArray[np.float64]]], layout: TransientLayout
) -> tuple[Stretches, list[PixelBins]]:
    """A stretch for each part of the light, which holds what a pixel has of it on the time axis.

    Parameters
    ----------
    ends : first and last place of the light of each part, both (pixels,), in bins from the start of the time
        axis; the first is infinite in a pixel without light.
    """
    from render.transport.kernels.time_bins import TimeAxis

    firsts, counts = [], []
    for low, high in ends:
        lit = low < high
        first = np.where(lit, np.floor(low), 0)
        count = int(np.clip((np.ceil(high) - first)[lit].max(initial=1), 1, layout.bin_count))
        firsts.append(np.clip(first, 0, layout.bin_count - count).astype(np.int64))
        counts.append(count)
    stretches = Stretches(tuple(counts))
    places = len(counts) + np.cumsum([0, *counts[:-1]])
    return stretches, [
        PixelBins(
            first,
            TimeAxis(count, layout.bin_width_m, layout.start_opl_m),
            int(place),
            stretches.numbers,
        )
        for first, count, place in zip(firsts, counts, places, strict=True)
    ]
