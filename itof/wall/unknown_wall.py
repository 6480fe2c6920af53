"""The wall in a measurement of a camera of which only the field of view is known.

Nothing is expected of the wall's place, nor of the camera's phase offsets. Planes are tried from several
starts: from the unwrapped distances at all frequencies, and from those of the lowest frequency with any
offset. If none explains the phases, the same is tried with phasors conjugated, frequencies in another order,
and the image stored column by column. As in `itof.wall.phase_defects`, such an explanation counts only if it
is much better.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from itof.light import phase_per_metre
from itof.pinhole import pixel_rays
from itof.wall.expected_wall import ExpectedWall, radial_depth_of_plane
from itof.wall.phase_defects import CLEAR, GOOD, OBLONG_AXES, TURNS, order_text
from itof.wall.wall_fit import WallFit, without_unit
from itof.wall.wall_search import best_fit, plane_from_nothing

_MOST_PIXELS = 2000  # of a trial
_OFFSETS = 8  # of the lowest frequency that are tried; each start may be wrong by a quarter of a wavelength
_FITTED = 2  # starts from which a plane is fitted
_MOST_FREQUENCIES = 4  # of which all orders are tried
_SUSPECT = 1e-4  # below this mismatch nothing else is tried: 14 mrad

Phasors = NDArray[Any]


@dataclass(frozen=True)
class SeenWall:
    """The wall that explains a measurement best.

    Attributes
    ----------
    wall : its plane as an expected wall, with its computed return.
    fit : of the measurement to this wall.
    mismatch : 1 - mean cosine of the phases that the fit leaves.
    defects : what must be wrong with the measurement so that the phases are those of a wall; empty if the
        measurement as it stands shows the wall, or if nothing explains it.
    """

    wall: ExpectedWall
    fit: WallFit
    mismatch: float
    defects: tuple[str, ...] = ()


def see_wall(phasor: Phasors, frequencies_hz: Sequence[float], horizontal_fov_deg: float) -> SeenWall | None:
    """The wall that explains the phases (H, W, F) best; None if too few pixels hold light.

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
    whole = _Trial(unit, tuple(frequencies_hz), pixel_rays(width, height, horizontal_fov_deg))
    try:
        return _refined(*_explained(whole), horizontal_fov_deg)
    except ValueError:  # almost all of the light is in too few pixels
        return None


def _explained(whole: _Trial) -> tuple[_Trial, SeenWall]:
    """The measurement with that put right which makes it fit much better, and its wall; or as it stands."""
    best, found = whole, _best(whole.thinned())
    if found.mismatch > _SUSPECT:
        limit = min(GOOD, CLEAR * found.mismatch)
        for parts, other in _others(whole):
            trial = _best(other.thinned())
            if trial.mismatch < limit:
                limit, best, found = trial.mismatch, other, replace(trial, defects=parts)
    return best, found


@dataclass(frozen=True)
class _Trial:
    """Phasors (H, W, F), their frequencies, and the rays (H, W, 3) of the pixels."""

    phasor: Phasors
    frequencies_hz: tuple[float, ...]
    rays: NDArray[np.float64]

    def thinned(self) -> _Trial:
        lit = np.count_nonzero((self.phasor != 0).all(-1))  # the others count for nothing
        step = max(1, math.isqrt(lit // _MOST_PIXELS))
        thin = (slice(None, None, step),) * 2
        return replace(self, phasor=self.phasor[thin], rays=self.rays[thin])

    def wall(self, plane_per_m: NDArray[np.float64]) -> ExpectedWall:
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


def _best(trial: _Trial) -> SeenWall:
    """The best fit from the most promising starts; the first one that fits ends the search.

    Raises
    ------
    ValueError : too few pixels see any of the planes.
    """
    best: SeenWall | None = None
    for plane in sorted(_starts(trial), key=lambda plane: _promise(trial, plane))[:_FITTED]:
        try:
            wall = trial.wall(plane)
            fit = best_fit(trial.phasor, wall)
        except ValueError:  # too few pixels see this plane
            continue
        found = SeenWall(wall, fit, _mismatch(fit))
        if best is None or found.mismatch < best.mismatch:
            best = found
        if best.mismatch < _SUSPECT:
            break
    if best is None:
        raise ValueError("too few pixels see a plane")
    return best


def _promise(trial: _Trial, plane: NDArray[np.float64]) -> float:
    """Mismatch of a plane with any phase offsets: small for a good start."""
    model = trial.wall(plane).direct * trial.phasor.conj()
    strength = np.abs(trial.phasor)[..., :1] ** 2 * (model != 0)
    turned = model / np.where(model != 0, np.abs(model), 1.0) * strength
    return float(1 - (np.abs(turned.sum(axis=(0, 1))) / np.abs(trial.phasor[..., :1] ** 2).sum()).mean())


def _starts(trial: _Trial) -> Iterator[NDArray[np.float64]]:
    anywhere = ExpectedWall(trial.frequencies_hz, np.ones(trial.phasor.shape), trial.rays, np.zeros(3))
    yield plane_from_nothing(trial.phasor, anywhere)
    lowest = int(np.argmin(trial.frequencies_hz))
    alone, wall = trial.phasor[..., [lowest]], anywhere.at([lowest])
    for turn in np.exp(2j * np.pi * np.arange(_OFFSETS) / _OFFSETS):
        yield plane_from_nothing(turn * alone, wall)


def _mismatch(fit: WallFit) -> float:
    agreement = np.tensordot(fit.weight, np.cos(fit.residual_rad), axes=2)  # (F,)
    return float(1 - agreement.mean())


def _refined(whole: _Trial, seen: SeenWall, horizontal_fov_deg: float) -> SeenWall:
    """The same with all pixels, and with the return of pixels that see an area."""
    height, width = whole.phasor.shape[:2]
    plane = seen.fit.plane_per_m
    wall = ExpectedWall.of_plane(plane, width, height, whole.frequencies_hz, horizontal_fov_deg)
    fit = best_fit(without_unit(whole.phasor, wall), wall)
    return replace(seen, wall=wall, fit=fit, mismatch=_mismatch(fit))
