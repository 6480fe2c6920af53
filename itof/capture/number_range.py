"""The range of raw numbers: whether they can be those of the converter, and where they stop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from itof.arrays import Numbers
from itof.capture.raw_frames import RawFrames
from itof.capture.sidecar import CaptureError, Sidecar

_TOP = 0.01  # of the range, below its end, in which numbers are counted
_FEWEST = 20  # equal numbers at the end,
_PILE = 20.0  # and over the mean count of a number near it
_LEVELS = 200  # different numbers: fewer tell nothing
_SAMPLE = 2**20  # numbers that tell the levels


def refuse_range(raw: RawFrames, sidecar: Sidecar) -> None:
    """Refuse raw numbers above those of the converter, or that stop where the sidecar knows no saturation.

    Raises
    ------
    CaptureError : this is so; the message has the bits that the numbers show.
    """
    levels = np.unique(raw.values.reshape(-1)[:: max(1, raw.values.size // _SAMPLE)]).astype(np.float64)
    step = _smallest_step(levels)
    largest = float(raw.values.max())
    if sidecar.layout == "taps" and sidecar.bits is not None and sidecar.saturation_dn is None:
        most = 2**sidecar.bits - 1
        if largest > most:
            words = f"give the true bits: {int(largest).bit_length()}?"
            if step >= (largest + 1) / (most + 1):
                words = f"all are multiples of {step}, left-aligned: give saturation_dn = {step * most}"
            hold = f"the frames hold {largest:g}, and {sidecar.bits} bits hold at most {most}"
            raise CaptureError(f"{raw.source}: {hold}: {words}")
    for end in _stops(raw.values, levels, sidecar.layout == "differences"):
        if sidecar.saturation is None or abs(end) < sidecar.saturation:
            bits = int(abs(end) // step).bit_length()
            full = abs(end) == step * (2**bits - 1)  # of a converter without a sign
            of = f" ({bits} bits{', left-aligned' if step > 1 else ''})" if full else ""
            key = f"bits = {bits}" if full and step == 1 and sidecar.layout == "taps" else ""
            raise CaptureError(
                f"{raw.source}: the numbers stop at {end:g}{of}, which many reach: pixels are saturated that "
                f"the sidecar does not know: give {key or f'saturation_dn = {abs(end):g}'}"
            )


def _smallest_step(levels: NDArray[np.float64]) -> int:
    """The power of two of which all numbers are multiples; 1 if they are no whole numbers."""
    if (levels != np.round(levels)).any() or np.abs(levels).max() >= 2**53:
        return 1
    bits = int(np.bitwise_or.reduce(np.abs(levels).astype(np.int64)))
    return bits & -bits or 1


def _stops(values: Numbers, levels: NDArray[np.float64], both: bool) -> Iterator[float]:
    """Largest number, and smallest one of `both`, if far more values have it than numbers near it."""
    low, high = float(values.min()), float(values.max())
    if len(levels) < _LEVELS:
        return
    for end in (high, low) if both else (high,):
        near = values[np.abs(values - end) <= _TOP * (high - low)]
        at_end = np.count_nonzero(near == end)
        others = (len(near) - at_end) / max(len(np.unique(near)) - 1, 1)
        if at_end >= max(_FEWEST, _PILE * others):
            yield end
