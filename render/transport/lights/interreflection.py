"""Arrivals by interreflection: light that met hidden objects more than once.

With three bounces, light goes from the emitter over the wall to a surface point, and from there over the wall
to the camera. Each further bounce is a vertex before the surface point, on a hidden object or on the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.transport.lights.hidden_surface import SurfacePoints, hidden_shapes

if TYPE_CHECKING:
    import mitsuba as mi

_RAYS = 64  # from each side of each point


def reflected_arrivals(
    scene: mi.Scene,
    points: SurfacePoints,
    extra_bounces: int,
    seed: int,
    *,
    shapes: Sequence[mi.Shape] | None = None,
    rays: int = _RAYS,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Irradiance at surface points by paths with 1 to `extra_bounces` further vertices, and their OPL.

    From each side of a point, R = `rays` cosine-distributed rays are traced backwards. Each vertex on one of
    the `shapes` (None: the hidden objects) adds the light that one random point of the lit surfaces sends
    over it. The ray continues with a direction sampled from the BSDF of the vertex. The estimate is unbiased:
    E = π / R times the sum of the radiance found. Of vertices on hidden objects alone, light that meets the
    wall twice in a row is left out; for a plane wall there is none.

    Parameters
    ----------
    points : M surface points.
    extra_bounces : bounces above three, at least 1.
    seed : of the random directions.

    Returns
    -------
    Irradiance (M, K), positive on the side of the normal and negative on the other; OPL (M, K), metres, from
    the emitter to the point. K is 2 R rays x `extra_bounces` x emitters.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.arrays import upload_points
    from render.transport.kernels.rays import on_shapes
    from render.transport.kernels.visibility import lifted

    both = 2 * rays  # even numbers in front of the surface, odd numbers behind it
    count = dr.opaque(mi.UInt32, both)
    lane = dr.arange(mi.UInt32, len(points.position) * both)
    point = lane // count
    random = mi.PCG32(len(points.position) * both, dr.opaque(mi.UInt64, seed))
    front = lane % 2 == 0
    position = dr.gather(mi.Point3f, upload_points(points.position), point)
    outward = dr.gather(mi.Point3f, upload_points(points.normal), point)
    side = dr.select(front, mi.Float(1), -1)
    normal = mi.Normal3f(outward * side)
    local = mi.warp.square_to_cosine_hemisphere(_two(random))
    direction = mi.Frame3f(normal).to_world(local)
    ray = mi.Ray3f(lifted(position, normal, position + direction), direction)
    throughput = mi.Float(dr.opaque(mi.Float, float(np.pi / rays)))
    travelled, active = mi.Float(0), mi.Bool(True)
    found: list[tuple[mi.Float, mi.Float]] = []
    for _ in range(extra_bounces):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        travelled += dr.select(active, si.t, 0)
        on_object = on_shapes(si, hidden_shapes(scene) if shapes is None else list(shapes))
        for emitter in scene.emitters():
            radiance, opl = _over_the_wall(scene, emitter, si, random, active & on_object)
            found.append((side * throughput * radiance, opl + travelled))
        sample, weight = si.bsdf(ray).sample(
            mi.BSDFContext(), si, random.next_float32(), _two(random), active
        )
        throughput *= dr.select(active, weight.x, 0)
        active &= throughput > 0
        direction = si.to_world(sample.wo)
        ray = mi.Ray3f(lifted(si.p, si.n, si.p + direction), direction)
    dr.eval(found)
    shape = (len(points.position), both)
    parts = [[np.array(values).reshape(shape) for values in pair] for pair in found]
    return np.hstack([part[0] for part in parts]), np.hstack([part[1] for part in parts])


def _over_the_wall(
    scene: mi.Scene, emitter: mi.Emitter, si: mi.SurfaceInteraction3f, random: mi.PCG32, active: mi.Bool
) -> tuple[mi.Float, mi.Float]:
    """Radiance along `si.wi` that `si` gets from one random point of the lit wall, and its OPL up to `si`."""
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.visibility import unoccluded

    ray, flux = emitter.sample_ray(0.0, 0.0, _two(random), _two(random), active)
    wall = scene.ray_intersect(mi.Ray3f(ray), active)
    gap = si.p - wall.p
    distance = dr.norm(gap)
    direction = gap / distance
    context = mi.BSDFContext(mi.TransportMode.Importance)
    sent = wall.bsdf().eval(context, wall, wall.to_local(direction), active & wall.is_valid())
    received = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(-direction), active)
    lit = active & wall.is_valid() & (sent.x > 0) & (received.x > 0)
    lit = unoccluded(scene, wall.p, wall.n, si.p, si.n, lit)
    radiance = dr.select(lit, (flux * sent * received).x / dr.square(distance), 0)
    return radiance, dr.select(lit, wall.t + distance, 0)


def _two(random: mi.PCG32) -> mi.Point2f:
    import mitsuba as mi

    return mi.Point2f(random.next_float32(), random.next_float32())
