"""DrJit kernels of the many-light method. Import this module late, after a Mitsuba variant is set.

Numbers that change from scene to scene are passed as arrays or through `dr.opaque`: a Python number becomes a
literal in the kernel, which is then compiled again (docs/design.md, DrJit).
"""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64  # bytes, as in the arrays that DrJit allocates


def upload(values: NDArray[np.floating]) -> mi.Float:
    """Numpy values as a DrJit array, from aligned memory.

    On the CPU, DrJit uses the memory of the numpy array, and the alignment is part of the kernel: with
    another alignment, the kernel would be compiled again.
    """
    flat = np.ascontiguousarray(values, dtype=np.float32).ravel()
    room = np.empty(flat.nbytes + _ALIGNMENT, np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    aligned = room[start : start + flat.nbytes].view(np.float32)
    aligned[:] = flat
    return mi.Float(aligned)


def upload_points(values: NDArray[np.floating]) -> mi.Point3f:
    """(N, 3) numpy values as N points."""
    return mi.Point3f(*(upload(column) for column in np.asarray(values).T))


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


def camera_hits(scene: mi.Scene, x: mi.Float, y: mi.Float) -> mi.SurfaceInteraction3f:
    """First surfaces on the rays through film positions (x, y in [0, 1]); `t` starts at the pinhole."""
    sensor = scene.sensors()[0]
    ray, _ = sensor.sample_ray(0.0, 0.0, mi.Point2f(x, y), mi.Point2f(0.5))
    ray = mi.Ray3f(ray)
    ray.o = sensor.world_transform().translation()  # Mitsuba starts at the near clip plane
    return scene.ray_intersect(ray)


def direct_return(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, sample: mi.Point2f
) -> tuple[mi.Float, mi.Float]:
    """Radiance (W m^-2 sr^-1) of the one-bounce return, and its optical path length (metres)."""
    emitted, weight = scene.sample_emitter_direction(si, sample, True, si.is_valid())
    lit = si.is_valid() & (emitted.pdf != 0)
    reflected = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(emitted.d), lit)
    return dr.select(lit, (reflected * weight).x, 0), dr.select(lit, si.t + emitted.dist, 0)


def light_transport(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    bsdf: mi.BSDFPtr,
    position: mi.Point3f,
    normal: mi.Point3f,
    light: mi.UInt32,
) -> tuple[mi.Float, mi.Float]:
    """Radiance towards the camera per intensity of a light, f cos a cos b / d² V, and its distance d."""
    there = dr.gather(mi.Point3f, position, light)
    gap = there - si.p
    squared = dr.squared_norm(gap)
    distance = dr.sqrt(squared)
    direction = gap / distance
    cosine = -dr.dot(dr.gather(mi.Point3f, normal, light), direction)
    local = si.to_local(direction)
    seen = si.is_valid() & (cosine > 0)
    reflected = bsdf.eval(mi.BSDFContext(), si, local, seen).x
    seen &= reflected > 0
    seen &= ~scene.ray_test(si.spawn_ray_to(there), seen)
    return dr.select(seen, reflected * cosine / squared, 0), distance


@dr.syntax
def gather_phasors(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    position: mi.Point3f,
    normal: mi.Point3f,
    real: mi.Float,
    imaginary: mi.Float,
    phase_per_metre: list[mi.Float],
    count: mi.UInt32,
) -> tuple[list[mi.Float], list[mi.Float]]:
    """Real and imaginary parts of sum over lights of transport x intensity x exp(j k (d + t)), by frequency.

    `real` and `imaginary` are the complex intensities of the lights, (lights, frequencies) in C order.
    """
    frequency_count = len(phase_per_metre)
    total_re = [mi.Float(0) for _ in range(frequency_count)]
    total_im = [mi.Float(0) for _ in range(frequency_count)]
    bsdf = si.bsdf()
    light = mi.UInt32(0)
    while light < count:
        transport, distance = light_transport(scene, si, bsdf, position, normal, light)
        opl = distance + si.t
        for index in range(frequency_count):
            sine, cosine = dr.sincos(phase_per_metre[index] * opl)
            re = dr.gather(mi.Float, real, light * frequency_count + index)
            im = dr.gather(mi.Float, imaginary, light * frequency_count + index)
            total_re[index] += transport * (re * cosine - im * sine)
            total_im[index] += transport * (re * sine + im * cosine)
        light += 1
    return total_re, total_im


@dr.syntax
def splat_lights(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    position: mi.Point3f,
    normal: mi.Point3f,
    energy: mi.Float,
    opl: mi.Float,
    packets: mi.UInt32,
    count: mi.UInt32,
    axis: TimeAxis,
    bins: mi.Float,
) -> None:
    """Add every packet of every light to the bins of the pixels; lane n is pixel n.

    `energy` and `opl` are (lights, packets) in C order.
    """
    bsdf = si.bsdf()
    first = dr.arange(mi.UInt32, dr.width(si.t)) * axis.count
    light = mi.UInt32(0)
    while light < count:
        transport, distance = light_transport(scene, si, bsdf, position, normal, light)
        travelled = distance + si.t
        packet = light * packets
        last = packet + dr.select(transport > 0, packets, 0)
        while packet < last:
            arrived = travelled + dr.gather(mi.Float, opl, packet)
            splat_tent(
                bins,
                first,
                axis,
                arrived,
                transport * dr.gather(mi.Float, energy, packet),
                dr.ReduceMode.NoConflicts,
            )
            packet += 1
        light += 1


class TimeAxis:
    """A time axis as opaque DrJit numbers: bin count, 1 / bin width, start of the first bin."""

    DRJIT_STRUCT: ClassVar = {"count": mi.UInt32, "per_metre": mi.Float, "start": mi.Float}

    def __init__(self, count: int = 1, bin_width_m: float = 1.0, start_opl_m: float = 0.0) -> None:
        self.count = dr.opaque(mi.UInt32, count)
        self.per_metre = dr.opaque(mi.Float, 1 / bin_width_m)
        self.start = dr.opaque(mi.Float, start_opl_m)


def splat_tent(
    bins: mi.Float,
    first: mi.UInt32,
    axis: TimeAxis,
    opl: mi.Float,
    energy: mi.Float,
    mode: dr.ReduceMode,
) -> None:
    """Add `energy` at `opl` to the two nearest bin centres of the pixel whose bins begin at `first`.

    Energy outside the time axis is lost. DrJit's scatter drops NaN without a message, so NaN is replaced by
    infinity, which stops the render.
    """
    energy = dr.select(dr.isnan(energy), dr.inf, energy)
    centre = (opl - axis.start) * axis.per_metre - 0.5  # bin index; integers are bin centres
    lower = dr.floor(centre)
    upper_share = centre - lower
    limit = mi.Int32(axis.count)
    for step, share in ((0, 1 - upper_share), (1, upper_share)):
        index = mi.Int32(lower) + step
        inside = (index >= 0) & (index < limit) & (energy != 0)
        dr.scatter_reduce(dr.ReduceOp.Add, bins, energy * share, first + mi.UInt32(index), inside, mode)
