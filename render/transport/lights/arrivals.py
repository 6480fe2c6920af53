"""Arrivals: the light that points of a surface get from the emitters over the wall, or straight from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.transport.lights.hidden_surface import SurfacePoints, sobol_points

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class Incoming:
    """Which light of the emitters counts at a surface.

    Attributes
    ----------
    direct : whether that which comes straight from an emitter counts, too.
    over : the shapes over which it may come otherwise; None for all.
    """

    direct: bool = False
    over: Sequence[mi.Shape] | None = None


OVER_THE_WALL = Incoming()  # the emitters light no hidden object


def arrivals(
    scene: mi.Scene,
    points: SurfacePoints,
    wall_points: int,
    seed: int,
    incoming: Incoming = OVER_THE_WALL,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Irradiance and OPL (M, K) of the light that each point gets from the wall; K: wall points x emitters.

    Direct light adds one for each emitter.

    A wall point that receives the flux Φ sends E = Φ f cos a cos b / d², where f cos a is the BSDF of the
    wall times the cosine there. E is positive on the side of the normal and negative on the other side.
    """
    parts = [
        _arrivals_of(scene, emitter, points, wall_points, seed + number, incoming.over)
        for number, emitter in enumerate(scene.emitters())
    ]
    parts += [_direct_arrivals(scene, emitter, points) for emitter in scene.emitters() if incoming.direct]
    return np.hstack([part[0] for part in parts]), np.hstack([part[1] for part in parts])


def _direct_arrivals(
    scene: mi.Scene, emitter: mi.Emitter, points: SurfacePoints
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Irradiance and OPL (M, 1) of the light that comes straight from an emitter."""
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.arrays import upload_points
    from render.transport.kernels.visibility import unoccluded

    there = dr.zeros(mi.SurfaceInteraction3f, len(points.position))
    there.p, normal = mi.Point3f(upload_points(points.position)), upload_points(points.normal)
    emitted, weight = emitter.sample_direction(there, mi.Point2f(0.5))
    lit = (emitted.pdf != 0) & (weight.x > 0)
    lit = unoccluded(scene, there.p, mi.Normal3f(normal), emitted.p, emitted.n, lit)
    irradiance = dr.select(lit, weight.x * dr.dot(normal, emitted.d), 0)
    opl = dr.select(lit, emitted.dist, 0)
    dr.eval(irradiance, opl)
    return np.array(irradiance)[:, None], np.array(opl)[:, None]


def _arrivals_of(
    scene: mi.Scene,
    emitter: mi.Emitter,
    points: SurfacePoints,
    wall_points: int,
    seed: int,
    over: Sequence[mi.Shape] | None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.arrays import upload, upload_points
    from render.transport.kernels.rays import on_shapes
    from render.transport.kernels.visibility import unoccluded

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
    if over is not None:
        lit &= on_shapes(wall, list(over))
    lit = unoccluded(scene, wall.p, wall.n, position, normal, lit)
    irradiance = dr.select(lit, (flux * reflected).x * cosine / dr.square(distance), 0)
    opl = dr.select(lit, wall.t + distance, 0)
    dr.eval(irradiance, opl)
    shape = (len(points.position), wall_points)
    return np.array(irradiance).reshape(shape), np.array(opl).reshape(shape)


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

    from render.transport.kernels.arrays import upload

    u = [dr.gather(mi.Float, upload(column), sample) for column in sobol_points(4, count, seed).T]
    u = [value + move for value, move in zip(u, shift, strict=True)] if shift else u
    u = [dr.minimum(value - dr.floor(value), 1 - 2**-24) for value in u]
    ray, weight = emitter.sample_ray(0.0, 0.0, mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3]))
    return mi.Ray3f(ray), weight / dr.opaque(mi.Float, count)
