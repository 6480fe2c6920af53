"""Rays from the camera, and what they meet. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from render.transport.kernels.arrays import upload
from render.transport.kernels.visibility import clearance, unoccluded


def pixel_samples(
    size: tuple[int, int], rows: tuple[int, int], nodes: NDArray[np.floating], weights: NDArray[np.floating]
) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.Float]:
    """Film x and y in [0, 1], pixel index and weight of all samples, ordered by pixel and then by node.

    Parameters
    ----------
    size : image width and height, pixels.
    rows : first row, and the row after the last.
    nodes : (n, 2) x and y in the pixel, from 0 to 1.
    weights : (n,) weights of the nodes.
    """
    width, height = size
    count = dr.opaque(mi.UInt32, len(nodes))
    columns = dr.opaque(mi.UInt32, width)
    lane = dr.arange(mi.UInt32, (rows[1] - rows[0]) * width * len(nodes))
    pixel, node = lane // count, lane % count
    row = pixel // columns + dr.opaque(mi.UInt32, rows[0])
    x = mi.Float(pixel % columns) + dr.gather(mi.Float, upload(nodes[:, 0]), node)
    y = mi.Float(row) + dr.gather(mi.Float, upload(nodes[:, 1]), node)
    weight = dr.gather(mi.Float, upload(weights), node)
    return x / dr.opaque(mi.Float, width), y / dr.opaque(mi.Float, height), pixel, weight


def camera_hits(scene: mi.Scene, x: mi.Float, y: mi.Float) -> mi.SurfaceInteraction3f:
    """First surfaces on the rays through film positions (x, y in [0, 1]); `t` starts at the pinhole."""
    sensor = scene.sensors()[0]
    ray, _ = sensor.sample_ray(0.0, 0.0, mi.Point2f(x, y), mi.Point2f(0.5))
    ray = mi.Ray3f(ray)
    ray.o = sensor.world_transform().translation()  # Mitsuba starts at the near clip plane
    return scene.ray_intersect(ray)


def on_shapes(si: mi.SurfaceInteraction3f | mi.PreliminaryIntersection3f, shapes: list[mi.Shape]) -> mi.Bool:
    """Whether each ray met one of `shapes`.

    The comparison uses opaque registry numbers. `si.shape == mi.ShapePtr(shape)` would make the number, which
    differs from scene to scene, a literal in the kernel.
    """
    met = dr.reinterpret_array(mi.UInt32, si.shape)
    found = dr.zeros(mi.Bool, dr.width(met))
    for shape in shapes:
        number = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))
        found |= met == dr.opaque(mi.UInt32, int(number[0]))
    return found & si.is_valid()


def surface_codes(si: mi.SurfaceInteraction3f) -> mi.UInt32:
    """A number for the shape that each ray met; 0 where it met none, or one that reflects nothing.

    A black surface reflects nothing towards its normal and nothing like a mirror. Neither does a perfect
    mirror, which no ray between two points can use.
    """
    bsdf, context = si.bsdf(), mi.BSDFContext()
    up = mi.Vector3f(0, 0, dr.copysign(mi.Float(1), si.wi.z))
    reflected = dr.zeros(mi.Float, dr.width(si.t))
    for direction in (up, mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)):
        reflected += bsdf.eval(context, si, direction, si.is_valid()).x
    number = dr.reinterpret_array(mi.UInt32, si.shape)
    return dr.select(si.is_valid() & (reflected > 0), number, 0)


def direct_return(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, sample: mi.Point2f
) -> tuple[mi.Float, mi.Float]:
    """Radiance (W m^-2 sr^-1) of the one-bounce return, and its optical path length (metres).

    A camera at the place of the emitter sees no shadow. A shadow ray starts above the surface and would find
    some along edges, where a pixel has hundreds of times the hidden signal.
    """
    emitted, weight = scene.sample_emitter_direction(si, sample, False, si.is_valid())
    lit = si.is_valid() & (emitted.pdf != 0)
    apart = dr.norm(si.p + si.to_world(si.wi) * si.t - emitted.p) > clearance(si.p)
    lit &= ~apart | unoccluded(scene, si.p, si.n, emitted.p, emitted.n, lit & apart)
    reflected = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(emitted.d), lit)
    return dr.select(lit, (reflected * weight).x, 0), dr.select(lit, si.t + emitted.dist, 0)
