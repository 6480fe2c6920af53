"""The light pass: the light that arrives at points of the hidden surface, with its optical path lengths.

Every point has *arrivals*, pairs of irradiance and optical path length of light that comes from the emitters
over the wall. They are valid for any modulation frequency and any time axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from itof import phase_per_metre
from render.transport.lights.arrivals import OVER_THE_WALL, Incoming, arrivals
from render.transport.lights.hidden_surface import (
    HiddenSurface,
    HiddenSurfaceError,
    SurfacePoints,
    joined,
    sample_surface,
    spread_evenly,
)

if TYPE_CHECKING:
    import mitsuba as mi

_STRETCHES = 512  # of the surface, for the pilot that finds where light arrives
_PILOT_POINTS = 8  # in each stretch
_PILOT_WALL_POINTS = 16
_WEAK = 0.8  # of the mean energy of a light
_FLOOR = 0.15  # share of the points that is spread evenly; so no point has a weight above 7


@dataclass(frozen=True)
class Lights:
    """N virtual lights on the hidden surface: one-sided Lambertian emitters, each with K arrivals.

    The lights belong to R runs, which are independent estimates of the same hidden signal. Each has its own
    random points, and its lights alone send the whole signal.

    Attributes
    ----------
    position, normal : (N, 3) float32, metres and unit vectors; light leaves on the side of the normal.
    energy : (N, K) radiant intensity along the normal of each arrival, W/sr.
    opl_m : (N, K) optical path length of each arrival from the emitter to the light, metres.
    starts : (R + 1,) index of the first light of each run, and N.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    energy: NDArray[np.float32]
    opl_m: NDArray[np.float32]
    starts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.position)

    @property
    def runs(self) -> int:
        """Number of independent runs."""
        return len(self.starts) - 1

    @property
    def centre(self) -> NDArray[np.float64]:
        """(3,) mean position, weighted with the intensities, metres."""
        if not len(self):
            return np.zeros(3)
        weights = self.energy.sum(axis=1, dtype=np.float64)
        return np.average(self.position, axis=0, weights=weights)

    @property
    def reach_m(self) -> float:
        """Largest distance of a light from `centre`, metres."""
        return float(np.linalg.norm(self.position - self.centre, axis=1).max())

    def phasors(self, frequencies_hz: tuple[float, ...]) -> NDArray[np.complex128]:
        """(N, F) complex intensity, W/sr: sum over arrivals of energy exp(j 2π f L / c)."""
        import drjit as dr
        import mitsuba as mi

        from render.transport.kernels.arrays import upload

        energy, opl_m = upload(self.energy), upload(self.opl_m)
        turned = [dr.sincos(dr.opaque(mi.Float, float(k)) * opl_m) for k in phase_per_metre(frequencies_hz)]
        parts = [(energy * cosine, energy * sine) for sine, cosine in turned]
        dr.eval(parts)
        sums = [[np.array(part).reshape(self.energy.shape).sum(axis=1) for part in pair] for pair in parts]
        return np.stack([real + 1j * imaginary for real, imaginary in sums], axis=-1)

    def joined(self, more: Lights) -> Lights:
        """These lights and those of further runs, which have as many arrivals."""
        return Lights(
            np.concatenate([self.position, more.position]),
            np.concatenate([self.normal, more.normal]),
            np.concatenate([self.energy, more.energy]),
            np.concatenate([self.opl_m, more.opl_m]),
            np.concatenate([self.starts, more.starts[1:] + len(self)]),
        )

    def packets(self, count: int, seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Packets that stand for the arrivals of each light: (N, Q) energy and OPL, with Q at most `count`.

        Each packet has the Q-th part of the energy of its light and the OPL of one arrival. The arrivals are
        chosen at equal steps of their cumulative energy (systematic sampling), from a random start for each
        light. So the mean of every function of the OPL, a phasor or a histogram, is exact.

        Parameters
        ----------
        seed : of the random starts.
        """
        count = min(count, self.energy.shape[1])
        order = np.argsort(self.opl_m, axis=1)
        reached = np.cumsum(np.take_along_axis(self.energy, order, axis=1), axis=1, dtype=np.float64)
        start = np.random.default_rng(seed).random((len(self), 1))
        chosen = np.empty((len(self), count), np.int64)
        for packet in range(count):
            chosen[:, packet] = (reached <= (packet + start) / count * reached[:, -1:]).sum(axis=1)
        chosen = np.minimum(chosen, self.energy.shape[1] - 1)
        opl_m = np.take_along_axis(self.opl_m, np.take_along_axis(order, chosen, axis=1), axis=1)
        return np.repeat(reached[:, -1:] / count, count, axis=1).astype(np.float32), opl_m


class NoLightError(HiddenSurfaceError):
    """No light reaches a surface."""


def light_density(
    scene: mi.Scene, surface: HiddenSurface, seed: int, incoming: Incoming = OVER_THE_WALL
) -> NDArray[np.float64]:
    """Where to place surface points: (S,) relative density of points in S stretches of the surface.

    Most of the density is proportional to the light from the wall, which a pilot with few wall points
    measures. The rest is even. A stretch counts as bright as the brightest of it and its two neighbours: a
    lit part that the pilot has missed would get few points of much weight.

    Raises
    ------
    NoLightError : no light from the wall reaches the hidden objects.
    HiddenSurfaceError : light that is not finite does.
    """
    pilot = spread_evenly(surface, _STRETCHES * _PILOT_POINTS)
    lit = np.abs(arrivals(scene, pilot, _PILOT_WALL_POINTS, seed, incoming)[0]).sum(axis=1)
    if not np.isfinite(lit).all():
        raise HiddenSurfaceError("the light on the hidden objects is not finite: check the emitters")
    if not lit.any():
        raise NoLightError(
            "no hidden object can be seen from the lit relay wall: widen the gap that the middle wall "
            "leaves, or move the objects"
        )
    mean = (lit * pilot.reflectance).reshape(_STRETCHES, _PILOT_POINTS).mean(axis=1)
    density = maximum_filter1d(mean, 3, mode="nearest")
    total = density.mean()
    return (1 - _FLOOR) * density / (total if total > 0 else 1.0) + _FLOOR


def make_lights(
    scene: mi.Scene,
    surface: HiddenSurface,
    density: NDArray[np.float64],
    count: int,
    wall_points: int,
    seeds: Sequence[int],
    max_bounces: int = 3,
    incoming: Incoming = OVER_THE_WALL,
) -> Lights:
    """Lights of independent runs: at `count` surface points each, with light from `wall_points` wall points.

    A point that is lit on both sides gives two lights, an unlit point none.

    Parameters
    ----------
    density : (S,) where to place the points (`light_density`).
    count : number of surface points of a run.
    wall_points : number of wall points for each surface point and emitter.
    seeds : one for each run; of its surface points and of the shifts of its wall points.
    max_bounces : above 3, arrivals by interreflection are added.
    """
    points = joined(sample_surface(surface, count, seed, density) for seed in seeds)
    wall_seed, ray_seed = (int(n) for n in np.random.SeedSequence([*seeds, 0]).generate_state(2))
    irradiance, opl_m = arrivals(scene, points, wall_points, wall_seed, incoming)
    if max_bounces > 3:
        from render.transport.lights.interreflection import reflected_arrivals

        more = reflected_arrivals(scene, points, max_bounces - 3, ray_seed)
        irradiance, opl_m = np.hstack([irradiance, more[0]]), np.hstack([opl_m, more[1]])
    return _thinned(_two_sided(points, irradiance, opl_m, len(seeds)), ray_seed)


def _two_sided(
    points: SurfacePoints, irradiance: NDArray[np.float32], opl_m: NDArray[np.float32], runs: int
) -> Lights:
    """Lights of one side each, from arrivals that are positive in front and negative behind the surface."""
    scale = (points.area * points.reflectance / np.pi)[:, None]  # Lambert: intensity = area ρ E / π
    sides = [np.clip(irradiance, 0, None), np.clip(-irradiance, 0, None)]
    found, sign = [], []
    for side, direction in zip(sides, (1, -1), strict=True):
        # a black surface reflects no light
        found.append(np.flatnonzero((side.sum(axis=1) > 0) & (scale[:, 0] > 0)))
        sign.append(np.full(len(found[-1]), direction))
    point, front = np.concatenate(found), np.concatenate(sign)
    order = np.argsort(point, kind="stable")  # points are in the order of their runs
    point, front = point[order], front[order]
    energy = np.where((front > 0)[:, None], sides[0][point], sides[1][point]) * scale[point]
    return Lights(
        points.position[point],
        points.normal[point] * front[:, None].astype(np.float32),
        energy.astype(np.float32),
        opl_m[point],
        np.searchsorted(point, np.linspace(0, len(points.position), runs + 1)),
    )


def _thinned(lights: Lights, seed: int) -> Lights:
    """Fewer weak lights, each with more energy: in the mean, the signal stays as it is.

    Every light costs as much in the gather pass. A light with less than `_WEAK` of the mean energy of its run
    is kept with a probability proportional to its energy (systematic sampling along the surface).
    """
    power = lights.energy.sum(axis=1, dtype=np.float64)
    starts = np.random.default_rng(seed).random(lights.runs)
    kept, share, counts = [], [], [0]
    for start, first, last in zip(starts, lights.starts[:-1], lights.starts[1:], strict=True):
        mine = power[first:last]
        chance = np.minimum(1, mine / (_WEAK * mine.mean())) if len(mine) else mine
        reached = start + np.cumsum(chance)
        chosen = np.flatnonzero(np.floor(reached) > np.floor(reached - chance))
        kept.append(first + chosen)
        share.append(chance[chosen])
        counts.append(len(chosen))
    index = np.concatenate(kept)
    energy = lights.energy[index] / np.concatenate(share)[:, None].astype(np.float32)
    where = np.cumsum(counts)
    return Lights(lights.position[index], lights.normal[index], energy, lights.opl_m[index], where)
