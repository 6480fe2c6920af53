"""What the amplitudes of a measurement say about it: dark, dead, even or saturated pixels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from itof.arrays import Bools, Floats, Phasors
from itof.wall.expected_wall import NumpyWall
from itof.wall.finding import Finding

EVEN: Final = 0.1  # spread of an amplitude or a phase over that of the wall's return
DEAD_NOTED: Final = 0.01  # share of dark pixels amid lit ones
SATURATED_NOTED: Final = 0.01  # share of pixels with the same largest amplitude
_LEAST_SPREAD = 0.02  # of the expected amplitude: if it is even, an even image says nothing
_SAME = 1e-6  # relative; rounding of complex64
_NOT_SAME = 1.02  # ratio of expected amplitudes that no rounding explains


def brightness_findings(phasor: Phasors, wall: NumpyWall) -> Iterator[Finding]:
    """Findings about the amplitudes of one measurement (H, W, F)."""
    lit = (phasor != 0).all(-1)
    seen = lit & (wall.direct != 0).all(-1)
    if np.count_nonzero(seen) < 3 + len(wall.frequencies_hz):
        yield Finding("no-wall", "no wall found: no pixel holds light, or almost none", True)
        return
    dead = float(_amid_lit(lit).mean())
    if dead > DEAD_NOTED:
        words = f"{100 * dead:.2g} % of the pixels are dark amid lit ones: damaged pixels?"
        yield Finding("dead-pixels", words, False)
    strength, expected = (np.abs(each[seen][:, 0]).astype(np.float64) for each in (phasor, wall.direct))
    if _spread(expected) > _LEAST_SPREAD and _spread(strength) < EVEN * _spread(expected):
        words = "the amplitude is the same in all pixels: saturated, or phases without amplitudes?"
        yield Finding("even-amplitude", words, True)
        return
    full = strength >= (1 - _SAME) * strength.max()
    if full.mean() > SATURATED_NOTED and expected[full].max() > _NOT_SAME * expected[full].min():
        words = f"{100 * full.mean():.2g} % of the pixels have the same largest amplitude: saturated?"
        yield Finding("saturated", words, False)


def _spread(values: Floats) -> float:
    return float(values.std() / values.mean())


def _amid_lit(lit: Bools) -> Bools:
    """Dark pixels with lit ones on both sides in their row or column; beside a wall's edge there are none."""
    between = np.zeros_like(lit)
    for axis in (0, 1):
        before = np.logical_or.accumulate(lit, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(lit, axis), axis=axis), axis)
        between |= before & after
    return between & ~lit
