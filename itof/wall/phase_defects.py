"""What makes a measurement unlike the return of its relay wall: conventions of phase, frequency and axes.

A defect is found by trial. The phases of the measurement are compared with those of the expected wall, with
the image turned or mirrored, the phasors conjugated or multiplied by -1 or ±j, and the frequencies in another
order or wrong by a factor of two. The *mismatch* of a trial is 1 - Re(mean of e^{j (phase - expected)}): half
the mean square of the phase error as long as it is small. A trial counts only if it explains the phases much
better than the measurement as it stands. So nothing is said where the wall does not tell: mirrored rows of a
level camera, or mirrored columns of a camera that looks straight at the wall.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof.arrays import Floats, Phasors
from itof.wall.expected_wall import NumpyWall
from itof.wall.wall_fit import MOST_PIXELS

Undo = Callable[[Phasors], Phasors]

SUSPECT: Final = 5e-4  # below this mismatch nothing is tried: 32 mrad, 13 mm of wall at 60 MHz
GOOD: Final = 0.02  # largest mismatch of a trial that counts: 0.2 rad; a wall 5 cm off has 0.008 at 60 MHz
CLEAR: Final = 1 / 16  # and over the mismatch without it: a quarter of the phase error
_ALIKE = 4.0  # trials whose mismatches differ by less explain the phases equally well,
_NEGLIGIBLE = 1e-4  # and so do those below this: noise and hidden light
_MOST_DEFECTS = 2  # at a time

AXES: Final[dict[str, Undo]] = {
    "": lambda z: z,
    "the image seems mirrored left to right": lambda z: z[:, ::-1],
    "the image seems mirrored top to bottom": lambda z: z[::-1],
    "the image seems turned by half a turn": lambda z: z[::-1, ::-1],
}
OBLONG_AXES: Final[dict[str, Undo]] = {
    "the image seems stored column by column": lambda z: z.reshape(z.shape[1], z.shape[0], -1).swapaxes(0, 1),
}
SQUARE_AXES: Final[dict[str, Undo]] = {
    "rows and columns of the image seem exchanged": lambda z: z.swapaxes(0, 1),
    "the image seems turned by a quarter turn to the right": lambda z: np.rot90(z, 1),
    "the image seems turned by a quarter turn to the left": lambda z: np.rot90(z, -1),
    "rows and columns of the image seem exchanged and reversed": lambda z: np.rot90(z, 2).swapaxes(0, 1),
}
# What is wrong if the phasors are right after they are conjugated (or not) and multiplied by the number.
TURNS: Final[dict[tuple[bool, complex], str]] = {
    (False, 1): "",
    (True, 1): "the phase falls with distance: conjugate?",
    (False, -1): "the phasors have the wrong sign, all phases are off by half a turn: multiply by -1?",
    (True, -1): "the real part has the wrong sign: multiply it by -1?",
    (False, -1j): "all phases are too large by a quarter turn: multiply by -1j?",
    (False, 1j): "all phases are too small by a quarter turn: multiply by 1j?",
    (True, 1j): "real and imaginary part seem exchanged",
    (True, -1j): "real and imaginary part seem exchanged and of the wrong sign",
}
FACTORS: Final[dict[float, str]] = {
    1.0: "",
    2.0: "the phases are twice those of the wall: frequencies_hz too small, or the wall twice as far?",
    0.5: "the phases are half those of the wall: frequencies_hz too large, or the wall half as far?",
}


@dataclass(frozen=True)
class PhaseDefect:
    """An explanation of a measurement by what is wrong with it.

    Attributes
    ----------
    parts : what is wrong, one text for each defect; usually one.
    mismatch : that of the measurement with all of this put right.
    """

    parts: tuple[str, ...]
    mismatch: float


def mismatch(phasor: Phasors, wall: NumpyWall, *, free_offsets: bool = False) -> float:
    """1 - Re(mean of e^{j (phase - expected)}), weighted by |d|² over pixels, and over the frequencies.

    With `free_offsets`, each frequency may have any phase offset.
    """
    agreement = np.diag(_agreement(phasor, wall, 1.0, conjugated=False))
    return float(1 - (np.abs(agreement) if free_offsets else agreement.real).mean())


def find_defects(
    phasor: Phasors, wall: NumpyWall, *, free_offsets: bool = False, scaled: bool = True
) -> tuple[PhaseDefect, ...]:
    """The defects that explain the phases (H, W, F); several if they explain them equally well.

    With `free_offsets`, each frequency may have any phase offset, as in a camera that was never calibrated;
    wrong signs and quarter turns are then not told. Without `scaled`, phases that are twice or half those of
    the wall are no defect. Empty if nothing explains the phases much better than the measurement does as it
    stands.
    """
    before = mismatch(phasor, wall, free_offsets=free_offsets)
    if before < SUSPECT:
        return ()
    trials = [each for each in _trials(phasor, wall, free_offsets, scaled) if each.parts]
    best = min(each.mismatch for each in trials)
    if best > min(GOOD, CLEAR * before):
        return ()
    limit = min(max(_ALIKE * best, _NEGLIGIBLE), CLEAR * before)
    alike = [each for each in trials if each.mismatch <= limit]
    fewest = min(len(each.parts) for each in alike)
    return tuple(each for each in alike if len(each.parts) == fewest)


def alternatives(defects: Sequence[PhaseDefect]) -> str:
    """Equally good explanations as one text."""
    return ", or ".join(" and ".join(each.parts) for each in defects)


def _trials(phasor: Phasors, wall: NumpyWall, free_offsets: bool, scaled: bool) -> Iterator[PhaseDefect]:
    """Every combination of up to two defects."""
    height, width, count = phasor.shape
    axes = AXES | (SQUARE_AXES if height == width else OBLONG_AXES)
    # A single frequency does not tell a factor from a distance.
    factors = FACTORS if scaled and count > 1 else {1.0: ""}
    for (axis, undo), conjugated, factor in itertools.product(axes.items(), (False, True), factors):
        agreement = _agreement(undo(phasor), wall, factor, conjugated=conjugated)
        for (conjugate, times), turn in TURNS.items():
            if conjugate != conjugated or (free_offsets and times != 1):
                continue
            scores = np.abs(agreement) if free_offsets else (times * agreement).real
            for order in _orders(scores):
                names = (axis, turn, FACTORS[factor], order_text(order, wall.frequencies_hz))
                parts = tuple(name for name in names if name)
                if len(parts) <= _MOST_DEFECTS:
                    yield PhaseDefect(parts, float(1 - scores[range(count), order].mean()))


def _orders(scores: Floats) -> Iterator[tuple[int, ...]]:
    """The order of the frequencies as given and, if every expected one is found, the best one."""
    given, best = tuple(range(len(scores))), tuple(scores.argmax(axis=1).tolist())
    yield given
    if best != given and set(best) == set(given):
        yield best


def _agreement(
    phasor: Phasors, wall: NumpyWall, factor: float, *, conjugated: bool
) -> NDArray[np.complex128]:
    """(F, F) weighted means of e^{j (phase at a - factor · expected phase at b)}."""
    step = math.isqrt(max(1, phasor[..., 0].size // MOST_PIXELS))
    thin = (slice(None, None, step),) * 2
    phasor, direct, depth_m = phasor[thin], wall.direct[thin], wall.radial_depth_m[thin]
    lit = np.isfinite(depth_m) & (phasor != 0).all(-1) & (direct != 0).all(-1)
    if not lit.any():
        return np.zeros((phasor.shape[-1],) * 2, dtype=np.complex128)
    strength = np.abs(direct[lit][:, 0]).astype(np.float64)  # (n,)
    weight = (strength / strength.max()) ** 2
    phases = np.angle(phasor[lit].astype(np.complex128))  # (n, F)
    expected = np.angle(direct[lit]) if factor == 1 else factor * depth_m[lit][:, None] * wall.slope
    turned = np.exp(-1j * phases if conjugated else 1j * phases) * (weight / weight.sum())[:, None]
    agreement: NDArray[np.complex128] = turned.T @ np.exp(-1j * expected)
    return agreement


def order_text(order: tuple[int, ...], frequencies_hz: tuple[float, ...]) -> str:
    """What is wrong if the phasors given for each frequency are those of ``order``; empty if nothing."""
    moved = [place for place, other in enumerate(order) if place != other]
    if not moved:
        return ""
    given = [frequencies_hz[place] for place in moved]
    if len(moved) == 2:
        return f"frequencies {megahertz(*given, between=' and ')} seem exchanged"
    true = [frequencies_hz[order[place]] for place in moved]
    return f"the frequencies seem to be in another order: {megahertz(*given)} look like {megahertz(*true)}"
