"""The wall in a measurement of a camera of which only the field of view is known.

Nothing is expected of the wall's place. The first start are the unwrapped distances at all frequencies. If
the camera's phase offsets are then not as small as they are known to be, any offsets are tried, also from
the distances of the lowest frequency with several offsets. If nothing explains the phases, the same is tried
with phasors conjugated, frequencies in another order, and the image stored column by column. As in
`itof.wall.phase_defects`, such an explanation counts only if it is much better.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from itof.arrays import Floats, Phasors
from itof.light import OFFSET_STD_RAD, phase_per_metre
from itof.pinhole import pixel_rays
from itof.wall.expected_wall import ExpectedWall, NumpyWall, radial_depth_of_plane
from itof.wall.phase_defects import CLEAR, GOOD, OBLONG_AXES, TURNS, order_text
from itof.wall.wall_fit import RobustFit, without_unit
from itof.wall.wall_search import best_fit, plane_from_nothing

_MOST_PIXELS = 2000  # of a trial
_OFFSETS = 8  # of the lowest frequency that are tried; each start may be wrong by a quarter of a wavelength
_FITTED = 2  # starts from which a plane is fitted
_MOST_FREQUENCIES = 4  # of which all orders are tried
_SUSPECT = 1e-4  # below this mismatch nothing else is tried: 14 mrad;
_WAVES = 5e-3  # if the offsets are as known, below this one: 0.1 rad, more than the waves of a camera


def see_wall(
    phasor: Phasors,
    frequencies_hz: Sequence[float],
    horizontal_fov_deg: float,
    offset_std_rad: float | Sequence[float] = OFFSET_STD_RAD,
) -> tuple[RobustFit, tuple[str, ...]] | None:
    """The fit of the wall that explains the phases (H, W, F) best; None if too few pixels hold light.

    Its expected wall is the one in the plane that was found. The texts say what must be wrong with the
    measurement so that the phases are those of a wall. There are none if the measurement as it stands shows
    the wall, or if nothing explains it. `offset_std_rad` is as in `itof.wall.wall_fit.fit_wall`.

    Raises
    ------
    ValueError : values that are not finite.
    """
    height, width, count = phasor.shape
    if not np.isfinite(phasor).all():
        raise ValueError("the phasors hold NaN or infinite values")
    if np.count_nonzero((phasor != 0).all(-1)) < 3 + count:
        return None
    largest = max(float(np.abs(phasor.real).max()), float(np.abs(phasor.imag).max()))
    unit = phasor.astype(np.complex128) / largest  # whose squares are numbers, also from complex64
    known = tuple(np.broadcast_to(offset_std_rad, (count,)).tolist())
    whole = _Trial(unit, tuple(frequencies_hz), pixel_rays(width, height, horizontal_fov_deg), known)
    try:
        right, fit, defects = _explained(whole)
        # with all pixels, and with the return of pixels that see an area
        wall = ExpectedWall.of_plane(fit.plane_per_m, width, height, whole.frequencies_hz, horizontal_fov_deg)
        z = without_unit(right.phasor, wall)
        return best_fit(z, wall, offset_std_rad=fit.known_rad), defects
    except ValueError:  # almost all of the light is in too few pixels
        return None


def _explained(whole: _Trial) -> tuple[_Trial, RobustFit, tuple[str, ...]]:
    """The measurement with that put right which makes it fit much better, its fit, and what was wrong."""
    best, fit = whole, _best(whole.thinned())
    defects: tuple[str, ...] = ()
    if fit.mismatch > (_WAVES if fit.distance_is_known else _SUSPECT):
        limit = min(GOOD, CLEAR * fit.mismatch)
        for parts, other in _others(whole):
            trial = _best(other.thinned())
            if trial.mismatch < limit:
                limit, best, fit, defects = trial.mismatch, other, trial, parts
    return best, fit, defects


@dataclass(frozen=True)
class _Trial:
    """Phasors (H, W, F), frequencies, rays (H, W, 3) of the pixels, and how large phase offsets may be."""

    phasor: Phasors
    frequencies_hz: tuple[float, ...]
    rays: Floats
    offset_std_rad: tuple[float, ...]

    def thinned(self) -> _Trial:
        lit = np.count_nonzero((self.phasor != 0).all(-1))  # the others count for nothing
        step = max(1, math.isqrt(lit // _MOST_PIXELS))
        thin = (slice(None, None, step),) * 2
        return replace(self, phasor=self.phasor[thin], rays=self.rays[thin])

    def wall(self, plane_per_m: Floats) -> NumpyWall:
        """A wall in this plane with the return of pixels that see one point each."""
        depth_m = radial_depth_of_plane(self.rays, plane_per_m)[..., None]
        slope = 2 * phase_per_metre(self.frequencies_hz)
        ahead = np.isfinite(depth_m)
        depth_m = np.where(ahead, depth_m, 1.0)
        direct = np.where(ahead, np.exp(1j * slope * depth_m) / depth_m**2, 0.0)
        return ExpectedWall(self.frequencies_hz, direct, self.rays, plane_per_m)


def _others(whole: _Trial) -> Iterator[tuple[tuple[str, ...], _Trial]]:
    """The measurement with something put right, and what."""
    count = len(whole.frequencies_hz)
    given = tuple(range(count))
    orders = itertools.permutations(given) if count <= _MOST_FREQUENCIES else [given, given[::-1]]
    for order, conjugated in itertools.product(orders, (False, True)):
        z = whole.phasor.conj() if conjugated else whole.phasor
        words = (TURNS[(conjugated, 1)], order_text(order, whole.frequencies_hz))
        # The phasors at place p are those of the frequency order[p].
        moved = replace(whole, phasor=z[..., np.argsort(order)])
        if parts := tuple(word for word in words if word):
            yield parts, moved
    for word, undo in OBLONG_AXES.items():
        yield (word,), replace(whole, phasor=undo(whole.phasor).reshape(whole.phasor.shape))


def _best(trial: _Trial) -> RobustFit:
    """The best fit from the most promising starts; the first one that fits ends the search.

    Raises
    ------
    ValueError : too few pixels see any of the planes.
    """
    starts, best, known = _starts(trial), None, trial.offset_std_rad
    for plane in itertools.chain([next(starts)], _promising(trial, starts)):
        try:
            fit = best_fit(trial.phasor, trial.wall(plane), offset_std_rad=known)
        except ValueError:  # too few pixels see this plane
            continue
        if best is None or fit.mismatch < best.mismatch:
            best = fit
        if best.distance_is_known or best.mismatch < _SUSPECT:
            break
        known = (np.inf,)
    if best is None:
        raise ValueError("too few pixels see a plane")
    return best


def _promising(trial: _Trial, starts: Iterator[Floats]) -> Iterator[Floats]:
    """The best of the other starts, computed only if one is asked for."""
    yield from sorted(starts, key=lambda plane: _promise(trial, plane))[:_FITTED]


def _promise(trial: _Trial, plane: Floats) -> float:
    """Mismatch of a plane with any phase offsets: small for a good start."""
    model = trial.wall(plane).direct * trial.phasor.conj()
    strength = np.abs(trial.phasor)[..., :1] ** 2 * (model != 0)
    turned = model / np.where(model != 0, np.abs(model), 1.0) * strength
    return float(1 - (np.abs(turned.sum(axis=(0, 1))) / np.abs(trial.phasor[..., :1] ** 2).sum()).mean())


def _starts(trial: _Trial) -> Iterator[Floats]:
    anywhere = ExpectedWall(trial.frequencies_hz, np.ones(trial.phasor.shape), trial.rays, np.zeros(3))
    yield plane_from_nothing(trial.phasor, anywhere)
    lowest = int(np.argmin(trial.frequencies_hz))
    alone, wall = trial.phasor[..., [lowest]], anywhere.at([lowest])
    for turn in np.exp(2j * np.pi * np.arange(_OFFSETS) / _OFFSETS):
        yield plane_from_nothing(turn * alone, wall)
