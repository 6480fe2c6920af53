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

from itof import phase_per_metre
from render.transport.hidden_surface import (
    HiddenSurface,
    HiddenSurfaceError,
    SurfacePoints,
    sample_surface,
    sobol_points,
    spread_evenly,
)

if TYPE_CHECKING:
    import mitsuba as mi

_STRETCHES = 512  # of the surface, for the pilot that finds where light arrives
_PILOT_POINTS = 8  # in each stretch
_PILOT_WALL_POINTS = 32
_FLOOR = 0.25  # share of the points that is spread evenly; so no point has a weight above 4


@dataclass(frozen=True)
class Lights:
    """N virtual lights on the hidden surface: one-sided Lambertian emitters, each with K arrivals.

    Attributes
    ----------
    position, normal : (N, 3) float32, metres and unit vectors; light leaves on the side of the normal.
    energy : (N, K) radiant intensity along the normal of each arrival, W/sr.
    opl_m : (N, K) optical path length of each arrival from the emitter to the light, metres.
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    energy: NDArray[np.float64]
    opl_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.position)

    def phasors(self, frequencies_hz: tuple[float, ...]) -> NDArray[np.complex128]:
        """(N, F) complex intensity, W/sr: sum over arrivals of energy exp(j 2π f L / c)."""
        turns = phase_per_metre(frequencies_hz)
        return np.stack([(self.energy * np.exp(1j * k * self.opl_m)).sum(axis=1) for k in turns], axis=-1)

    def packets(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Arrivals merged into `count` packets of equal energy for each light: (N, count) energy and OPL.

        The OPL of a packet is the mean OPL of its energy. So the energy and the mean OPL of a light are
        exact, and a phasor loses (k w)^2 / 24 of its amplitude, where w is the OPL interval of a packet.
        """
        order = np.argsort(self.opl_m, axis=1)
        energy = np.take_along_axis(self.energy, order, axis=1)
        moment = energy * np.take_along_axis(self.opl_m, order, axis=1)
        total = energy.sum(axis=1)
        packet_opl_m = np.empty((len(self), count))
        for light in range(len(self)):
            reached = np.concatenate([[0.0], np.cumsum(energy[light])])
            moments = np.concatenate([[0.0], np.cumsum(moment[light])])
            edges = np.linspace(0, reached[-1], count + 1)
            packet_opl_m[light] = np.diff(np.interp(edges, reached, moments)) * (count / total[light])
        packet_energy = np.repeat(total[:, None] / count, count, axis=1)
        return packet_energy.astype(np.float32), packet_opl_m.astype(np.float32)


def light_density(scene: mi.Scene, surface: HiddenSurface, seed: int) -> NDArray[np.float64]:
    """Where to place surface points: (S,) relative density of points in S stretches of the surface.

    Three quarters of the density are proportional to the light from the wall, which a pilot with few wall
    points measures. One quarter is even.

    Raises
    ------
    HiddenSurfaceError : no light from the wall reaches the hidden objects.
    """
    pilot = spread_evenly(surface, _STRETCHES * _PILOT_POINTS)
    lit = np.abs(_arrivals(scene, pilot, _PILOT_WALL_POINTS, seed)[0]).sum(axis=1)
    if not lit.any():
        raise HiddenSurfaceError(
            "no hidden object can be seen from the lit wall: move it, or remove it from the scene"
        )
    density = (lit * pilot.reflectance).reshape(_STRETCHES, _PILOT_POINTS).mean(axis=1)
    mean = density.mean()
    return (1 - _FLOOR) * density / (mean if mean > 0 else 1.0) + _FLOOR


def make_lights(
    scene: mi.Scene,
    surface: HiddenSurface,
    density: NDArray[np.float64],
    count: int,
    wall_points: int,
    seed: int,
    max_bounces: int = 3,
) -> Lights:
    """Lights at `count` surface points, each with arrivals from `wall_points` points of the lit wall.

    A point that is lit on both sides gives two lights, an unlit point none.

    Parameters
    ----------
    density : (S,) where to place the points (`light_density`).
    count : number of surface points.
    wall_points : number of wall points for each surface point and emitter.
    seed : of both samples.
    max_bounces : above 3, arrivals by interreflection are added.
    """
    streams = np.random.SeedSequence([seed, 0]).generate_state(3)
    points = sample_surface(surface, count, int(streams[0]), density)
    irradiance, opl_m = _arrivals(scene, points, wall_points, int(streams[1]))
    if max_bounces > 3:
        from render.transport.interreflection import reflected_arrivals

        more = reflected_arrivals(scene, points, max_bounces - 3, int(streams[2]))
        irradiance, opl_m = np.hstack([irradiance, more[0]]), np.hstack([opl_m, more[1]])
    return _two_sided(points, irradiance, opl_m)


def _arrivals(
    scene: mi.Scene, points: SurfacePoints, wall_points: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Irradiance and OPL (M, K) of the light that each point gets from the wall; K: wall points x emitters.

    A wall point that receives the flux Φ sends E = Φ f cos a cos b / d², where f cos a is the BSDF of the
    wall times the cosine there. E is positive on the side of the normal and negative on the other side.
    """
    parts = [
        _arrivals_of(scene, emitter, points, wall_points, seed + number)
        for number, emitter in enumerate(scene.emitters())
    ]
    return np.hstack([part[0] for part in parts]), np.hstack([part[1] for part in parts])


def _arrivals_of(
    scene: mi.Scene, emitter: mi.Emitter, points: SurfacePoints, wall_points: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import upload, upload_points

    count = dr.opaque(mi.UInt32, wall_points)
    lane = dr.arange(mi.UInt32, len(points.position) * wall_points)
    point, sample = lane // count, lane % count
    shift = [dr.gather(mi.Float, upload(column), point) for column in points.shift.T]
    ray, flux = emitted_rays(emitter, wall_points, seed, sample, shift)
    wall = scene.ray_intersect(ray)
    position = dr.gather(mi.Point3f, upload_points(points.position), point)
    normal = dr.gather(mi.Point3f, upload_points(points.normal), point)
    gap = position - wall.p
    distance = dr.norm(gap)
    direction = gap / distance
    context = mi.BSDFContext(mi.TransportMode.Importance)
    reflected = wall.bsdf(ray).eval(context, wall, wall.to_local(direction), wall.is_valid())
    cosine = -dr.dot(normal, direction)
    lit = wall.is_valid() & (dr.max(reflected) > 0)
    lit &= ~scene.ray_test(wall.spawn_ray_to(position), lit)
    irradiance = dr.select(lit, (flux * reflected).x * cosine / dr.square(distance), 0)
    opl = dr.select(lit, wall.t + distance, 0)
    dr.eval(irradiance, opl)
    shape = (len(points.position), wall_points)
    return (
        np.array(irradiance, dtype=np.float64).reshape(shape),
        np.array(opl, dtype=np.float64).reshape(shape),
    )


def emitted_rays(
    emitter: mi.Emitter, count: int, seed: int, sample: mi.UInt32, shift: Sequence[mi.Float] = ()
) -> tuple[mi.Ray3f, mi.Spectrum]:
    """Rays from an emitter along scrambled Sobol points, and the flux of each ray, W.

    Parameters
    ----------
    count : size of the Sobol set.
    seed : of the scrambling.
    sample : which point of the set each lane takes.
    shift : four numbers in [0, 1) for each lane, added to the point modulo 1.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import upload

    u = [dr.gather(mi.Float, upload(column), sample) for column in sobol_points(4, count, seed).T]
    u = [value + move for value, move in zip(u, shift, strict=True)] if shift else u
    u = [dr.minimum(value - dr.floor(value), 1 - 2**-24) for value in u]
    ray, weight = emitter.sample_ray(0.0, 0.0, mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3]))
    return mi.Ray3f(ray), weight / dr.opaque(mi.Float, count)


def _two_sided(points: SurfacePoints, irradiance: NDArray[np.float64], opl_m: NDArray[np.float64]) -> Lights:
    """Lights of one side each, from arrivals that are positive in front and negative behind the surface."""
    scale = (points.area * points.reflectance / np.pi)[:, None]  # Lambert: intensity = area ρ E / π
    irradiance = np.where(scale > 0, irradiance, 0.0)  # a black surface reflects no light
    sides = [np.clip(irradiance, 0, None), np.clip(-irradiance, 0, None)]
    kept = [side.sum(axis=1) > 0 for side in sides]
    return Lights(
        np.concatenate([points.position[keep] for keep in kept]),
        np.concatenate([sign * points.normal[keep] for keep, sign in zip(kept, (1, -1), strict=True)]),
        np.concatenate([(side * scale)[keep] for keep, side in zip(kept, sides, strict=True)]),
        np.concatenate([opl_m[keep] for keep in kept]),
    )


def no_lights() -> Lights:
    """The empty set of lights, for a scene without a hidden object."""
    nothing = np.zeros((0, 3), np.float32)
    return Lights(nothing, nothing, np.zeros((0, 1)), np.zeros((0, 1)))
