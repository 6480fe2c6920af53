"""Light that is split over time bins. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import mitsuba as mi

from render.transport.kernels.wall_light import light_transport


class TimeAxis:
    """A time axis as opaque DrJit numbers: bin count, 1 / bin width, start of the first bin."""

    DRJIT_STRUCT: ClassVar = {"count": mi.UInt32, "per_metre": mi.Float, "start": mi.Float}

    def __init__(self, count: int = 1, bin_width_m: float = 1.0, start_opl_m: float = 0.0) -> None:
        self.count = dr.opaque(mi.UInt32, count)
        self.per_metre = dr.opaque(mi.Float, 1 / bin_width_m)
        self.start = dr.opaque(mi.Float, start_opl_m)


def splat_quadratic(
    bins: mi.Float | mi.Float64,
    first: mi.UInt32,
    axis: TimeAxis,
    opl: mi.Float,
    energy: mi.Float,
    quantum: mi.Float64 | None = None,
) -> mi.Float:
    """Add `energy` at `opl` to the three nearest bins of the pixel whose bins begin at `first`.

    The shares are those of a quadratic B-spline (`itof.splat`): they are never negative and sum to 1. DrJit's
    scatter drops NaN without a message, so NaN is replaced by infinity, which stops the render. Returns the
    energy that falls outside the time axis.

    Parameters
    ----------
    quantum : None if no two lanes add to the same bins. Otherwise `bins` are float64, and shares are rounded
        to multiples of this power of two. Sums below 2^53 of them are exact, so the order of the lanes, which
        depends on the number of threads, does not matter.
    """
    energy = dr.select(dr.isnan(energy), dr.inf, energy)
    place = (opl - axis.start) * axis.per_metre  # in bins from the start of the axis
    nearest = dr.floor(place)
    off = place - nearest - 0.5  # from the centre of the nearest bin, in bins
    limit = mi.Int32(axis.count)
    shares = (-1, dr.square(0.5 - off) / 2), (0, 0.75 - dr.square(off)), (1, dr.square(0.5 + off) / 2)
    lost = mi.Float(0)
    for step, share in shares:
        index = mi.Int32(nearest) + step
        inside = (index >= 0) & (index < limit)
        part, mode = energy * share, dr.ReduceMode.NoConflicts
        lost += dr.select(inside, 0, part)
        if quantum is not None:
            part, mode = dr.round(mi.Float64(part) / quantum) * quantum, dr.ReduceMode.Auto
        dr.scatter_reduce(dr.ReduceOp.Add, bins, part, first + mi.UInt32(index), inside & (energy != 0), mode)
    return lost


@dr.syntax
def splat_samples(
    opl: mi.Float,
    energy: mi.Float,
    sample: mi.UInt32,
    end: mi.UInt32,
    first: mi.UInt32,
    axis: TimeAxis,
    bins: mi.Float,
) -> tuple[mi.Float, mi.Float]:
    """Add the samples from `sample` to `end` of each lane to the bins that begin at `first`.

    One lane adds all samples of a pixel in their order: if several threads added to the same bins, the sums
    would depend on which came first. Returns the energy that arrived, and that which arrived outside the time
    axis.
    """
    arrived, lost = mi.Float(0), mi.Float(0)
    while sample < end:
        part = dr.gather(mi.Float, energy, sample)
        path = dr.gather(mi.Float, opl, sample)
        lost += splat_quadratic(bins, first, axis, path, part)
        arrived += part
        sample += 1
    return arrived, lost


@dr.syntax
def splat_trapezoids(
    energy: mi.Float64,
    middle: mi.Float64,
    across: mi.Float64,
    down: mi.Float64,
    cell: mi.UInt32,
    end: mi.UInt32,
    first: mi.UInt32,
    axis: TimeAxis,
    bins: mi.Float,
) -> mi.Float64:
    """Add the cells from `cell` to `end` of each lane to the bins that begin at `first`.

    The light of a cell is spread evenly over a parallelogram, of which the place on the time axis changes by
    `across` and `down` from side to side, around `middle`; all three in bins. With F, the quadratic B-spline
    integrated twice, the share of the bin at the distance u is

        [F(u + (a + b)/2) - F(u + (a - b)/2) - F(u - (a - b)/2) + F(u - (a + b)/2)] / (a b).

    Returns the energy that falls outside the time axis.
    """
    lost = mi.Float64(0)
    while cell < end:
        light, place = dr.gather(mi.Float64, energy, cell), dr.gather(mi.Float64, middle, cell)
        a, b = dr.gather(mi.Float64, across, cell), dr.gather(mi.Float64, down, cell)
        reach = (a + b) / 2 + 1.5
        index = mi.Int32(dr.ceil(place - reach - 0.5))
        last = mi.Int32(dr.floor(place + reach - 0.5))
        while index <= last:
            off = mi.Float64(index) + 0.5 - place
            part = _twice_integrated(off + (a + b) / 2) - _twice_integrated(off + (a - b) / 2)
            part += _twice_integrated(off - (a + b) / 2) - _twice_integrated(off - (a - b) / 2)
            part *= light / (a * b)
            inside = (index >= 0) & (index < mi.Int32(axis.count))
            lost += dr.select(inside, 0, part)
            where = first + mi.UInt32(index)
            dr.scatter_reduce(
                dr.ReduceOp.Add, bins, mi.Float(part), where, inside & (part > 0), dr.ReduceMode.NoConflicts
            )
            index += 1
        cell += 1
    return lost


def _twice_integrated(u: mi.Float64) -> mi.Float64:
    """Quadratic B-spline, integrated twice from minus infinity: (u + |u|) / 2 beyond its ends."""
    off = dr.abs(u)
    outer, inner = dr.square(dr.maximum(1.5 - off, 0)), dr.square(dr.maximum(0.5 - off, 0))
    return dr.maximum(u, 0) + (dr.square(outer) - 3 * dr.square(inner)) / 24


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
    weight: mi.Float,
    later: mi.Float,
    first: mi.UInt32,
    axis: TimeAxis,
    bins: mi.Float,
) -> tuple[mi.Float, mi.Float]:
    """Add every packet of every light to the bins that begin at `first`, which differs from lane to lane.

    `energy` and `opl` are (lights, packets) in C order. `weight` multiplies the energy of each lane, and
    `later` (metres) is added to its paths. Returns the energy that arrived, and that which arrived outside
    the time axis.
    """
    bsdf = si.bsdf()
    light, arrived, lost = mi.UInt32(0), mi.Float(0), mi.Float(0)
    while (light < count) & si.is_valid():
        transport, distance = light_transport(scene, si, bsdf, position, normal, light)
        travelled = distance + si.t + later
        packet = light * packets
        last = packet + dr.select(transport > 0, packets, 0)
        while packet < last:
            part = weight * transport * dr.gather(mi.Float, energy, packet)
            path = travelled + dr.gather(mi.Float, opl, packet)
            lost += splat_quadratic(bins, first, axis, path, part)
            arrived += part
            packet += 1
        light += 1
    return arrived, lost


@dr.syntax
def splat_relative(
    scene: mi.Scene,
    si: mi.SurfaceInteraction3f,
    centre: mi.Point3f,
    position: mi.Point3f,
    normal: mi.Point3f,
    energy: mi.Float,
    opl: mi.Float,
    packets: mi.UInt32,
    first_light: mi.UInt32,
    last_light: mi.UInt32,
    first: mi.UInt32,
    axis: TimeAxis,
    bins: mi.Float,
) -> None:
    """Add the packets of some lights to the nearest bins, without the path that light from `centre` takes.

    The time axis is that of OPL less the distance from `centre` to the surface and from there to the camera.
    """
    bsdf = si.bsdf()
    centre_m = dr.norm(centre - si.p)
    light = mi.UInt32(first_light)
    while (light < last_light) & si.is_valid():
        transport, distance = light_transport(scene, si, bsdf, position, normal, light)
        packet = light * packets
        last = packet + dr.select(transport > 0, packets, 0)
        while packet < last:
            path = distance - centre_m + dr.gather(mi.Float, opl, packet)
            index = mi.UInt32(dr.clip((path - axis.start) * axis.per_metre, 0, mi.Float(axis.count) - 1))
            part = transport * dr.gather(mi.Float, energy, packet)
            dr.scatter_reduce(dr.ReduceOp.Add, bins, part, first + index, part > 0, dr.ReduceMode.NoConflicts)
            packet += 1
        light += 1


def add_shifted(
    values: mi.Float,
    tap: mi.UInt32,
    weights: list[mi.Float],
    quantum: mi.Float,
    relative: TimeAxis,
    amplitude: mi.Float,
    shift: mi.Float,
    pixel: mi.UInt32,
    axis: TimeAxis,
    window: int,
    bins: mi.Float,
) -> tuple[mi.Float, mi.Float]:
    """Add curves over a relative time axis to the bins of pixels, each delayed by its own `shift` (metres).

    A curve is the sum of as many successive curves of `values` as there are `weights`, from the number `tap`
    on. There is one lane for each of `window` bins of each curve; between samples, a curve is linear.
    `tap`, `weights`, `quantum`, `amplitude`, `shift` and `pixel` belong to the curves. Light is rounded to
    multiples of `quantum`. Returns what arrived and what was lost, by lane.
    """
    lane, size = dr.arange(mi.UInt32, dr.width(amplitude) * window), dr.opaque(mi.UInt32, window)
    curve, step = lane // size, lane % size
    start = dr.gather(mi.Float, shift, curve) + relative.start
    index = mi.Int32(dr.floor((start - axis.start) * axis.per_metre)) + mi.Int32(step)
    centre = axis.start + (mi.Float(index) + 0.5) / axis.per_metre
    place = (centre - start) * relative.per_metre - 0.5
    below = dr.floor(place)
    number, limit = mi.Int32(below), mi.Int32(relative.count)
    share = place - below
    value, first = mi.Float(0), dr.gather(mi.UInt32, tap, curve) * relative.count
    for offset, part in ((0, 1 - share), (1, share)):
        at = number + offset
        known = (at >= 0) & (at < limit)
        for row, weight in enumerate(weights):
            sample = dr.gather(mi.Float, values, first + row * relative.count + mi.UInt32(at), known)
            value += part * dr.gather(mi.Float, weight, curve) * sample
    # splines overshoot a little where the curve is nearly zero; no bin holds negative light
    value, grain = value * dr.gather(mi.Float, amplitude, curve), dr.gather(mi.Float, quantum, curve)
    value = dr.maximum(dr.round(value / grain) * grain, 0)
    inside = (index >= 0) & (index < mi.Int32(axis.count))
    first = dr.gather(mi.UInt32, pixel, curve) * axis.count
    dr.scatter_reduce(
        dr.ReduceOp.Add, bins, value, first + mi.UInt32(index), inside, dr.ReduceMode.NoConflicts
    )
    return value, dr.select(inside, 0, value)
