"""Sums over lights: the hidden signal at points of the film."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import phase_per_metre
from render.transport.film.pixels import LANES
from render.transport.lights.light_pass import Lights

if TYPE_CHECKING:
    import mitsuba as mi

_BUSY_LANES = 2**14  # keep the threads of a machine busy; with fewer, several lanes share a point
_WIDEST = 6  # power of two of the most lanes that share a point


def gather_lights(
    scene: mi.Scene, points: NDArray[np.float64], frequencies_hz: tuple[float, ...], lights: Lights
) -> NDArray[np.complex128]:
    """(P, F) phasors of the hidden signal, the mean over all runs, radiance in W m^-2 sr^-1.

    Parameters
    ----------
    points : (P, 2) film positions, x and y from 0 to 1. A ray through a point that meets nothing gives zero.
    """
    return gather_ranges(scene, points, frequencies_hz, lights, lights.starts[[0, -1]])[0] / lights.runs


def gather_runs(
    scene: mi.Scene, points: NDArray[np.float64], frequencies_hz: tuple[float, ...], lights: Lights
) -> NDArray[np.complex128]:
    """(R, P, F) phasors of the hidden signal by each run of lights."""
    return gather_ranges(scene, points, frequencies_hz, lights, lights.starts)


def gather_ranges(
    scene: mi.Scene,
    points: NDArray[np.float64],
    frequencies_hz: tuple[float, ...],
    lights: Lights,
    starts: NDArray[np.int64],
) -> NDArray[np.complex128]:
    """(R, P, F) sums over ranges of the lights; `starts` (R + 1,): first of each range, and the end."""
    ranges = len(starts) - 1
    if not len(lights) or not len(points):
        return np.zeros((ranges, len(points), len(frequencies_hz)), complex)
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, rays, wall_light

    intensity = lights.phasors(frequencies_hz)
    position, normal = arrays.upload_points(lights.position), arrays.upload_points(lights.normal)
    real, imaginary = arrays.upload(intensity.real), arrays.upload(intensity.imag)
    turns = [dr.opaque(mi.Float, float(k)) for k in phase_per_metre(frequencies_hz)]
    first, last = arrays.upload_indices(starts[:-1]), arrays.upload_indices(starts[1:])
    comb = 2 ** int(np.clip(np.log2(_BUSY_LANES / (len(points) * ranges)), 0, _WIDEST))
    step, count = dr.opaque(mi.UInt32, comb), dr.opaque(mi.UInt32, ranges)
    blocks = []
    for block in np.array_split(points, -(-len(points) * ranges * comb // LANES)):
        lane, size = dr.arange(mi.UInt32, len(block) * ranges * comb), dr.opaque(mi.UInt32, len(block))
        # Neighbouring lanes are neighbouring points where there are enough points: their rays to one light
        # are traced together.
        point, run, tooth = lane % size, lane // size % count, lane // (size * count)
        x, y = (dr.gather(mi.Float, arrays.upload(column), point) for column in block.T)
        si = rays.camera_hits(scene, x, y)
        limits = (dr.gather(mi.UInt32, first, run) + tooth, dr.gather(mi.UInt32, last, run), step)
        re, im = wall_light.gather_phasors(scene, si, position, normal, real, imaginary, turns, *limits)
        dr.eval(re, im)
        z = np.stack([np.array(a) + 1j * np.array(b) for a, b in zip(re, im, strict=True)], axis=-1)
        blocks.append(z.reshape(comb, ranges, len(block), -1).sum(axis=0))
    return np.concatenate(blocks, axis=1)


def gather_carrier(
    scene: mi.Scene,
    points: NDArray[np.float64],
    frequencies_hz: tuple[float, ...],
    centre: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """(P, F) phasors of one light of intensity 1 at `centre` (3,) that nothing occludes.

    It has what the hidden signal has of the wall behind each point: BSDF, bumps and texture, and the
    optical path to the camera. The ratio of both varies slowly over the wall.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, rays, wall_light

    turns = [dr.opaque(mi.Float, float(k)) for k in phase_per_metre(frequencies_hz)]
    there = mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in centre))
    blocks = [np.zeros((0, len(turns)), complex)]
    for block in np.array_split(points, -(-len(points) // LANES)) if len(points) else ():
        si = rays.camera_hits(scene, *(arrays.upload(column) for column in block.T))
        re, im = wall_light.carrier_phasors(si, there, turns)
        dr.eval(re, im)
        blocks.append(
            np.stack([np.array(a) + 1j * np.array(b) for a, b in zip(re, im, strict=True)], axis=-1)
        )
    return np.concatenate(blocks)


def carrier_amplitude(
    scene: mi.Scene, points: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(P,) magnitude of `gather_carrier`, which is the same at all frequencies."""
    return carrier_paths(scene, points, centre)[0]


def carrier_path_m(
    scene: mi.Scene, points: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Optical path lengths of the light of `gather_carrier` over the points that it reaches, metres."""
    amplitude, path_m = carrier_paths(scene, points, centre)
    return path_m[amplitude > 0]


def carrier_paths(
    scene: mi.Scene, points: NDArray[np.float64], centre: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(P,) magnitude of `gather_carrier` and (P,) optical path length of its light, metres."""
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, rays, wall_light

    there = mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in centre))
    blocks = [(np.zeros(0), np.zeros(0))]
    for block in np.array_split(points, -(-len(points) // LANES)) if len(points) else ():
        si = rays.camera_hits(scene, *(arrays.upload(column) for column in block.T))
        found = wall_light.carrier_path(si, there)
        dr.eval(found)
        blocks.append((np.array(found[0], dtype=np.float64), np.array(found[1], dtype=np.float64)))
    amplitude, path_m = (np.concatenate(column) for column in zip(*blocks, strict=True))
    return amplitude, path_m
