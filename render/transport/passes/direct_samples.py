"""Rays through the film: the direct return at points, and which surface is seen there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import phase_per_metre
from render.transport.film.pixels import LANES, Grid, PixelRule

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class DirectSamples:
    """The direct return at N points of the film.

    Attributes
    ----------
    radiance : (N,) W m^-2 sr^-1.
    opl_m : (N,) optical path length, metres; 0 where nothing returns.
    surface : (N,) number of the surface that is seen; 0 is none, or one that reflects nothing.
    """

    radiance: NDArray[np.float32]
    opl_m: NDArray[np.float32]
    surface: NDArray[np.uint32]

    def at(self, points: NDArray[np.int64]) -> DirectSamples:
        """The direct return at some of the points, by index."""
        return DirectSamples(self.radiance[points], self.opl_m[points], self.surface[points])

    @classmethod
    def joined(cls, parts: Sequence[DirectSamples]) -> DirectSamples:
        """The points of all parts, one part after the other."""
        columns = ((part.radiance, part.opl_m, part.surface) for part in parts)
        return cls(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def direct_phasors_of(samples: DirectSamples, frequencies_hz: tuple[float, ...]) -> NDArray[np.complex128]:
    """(N, F) phasors of the direct return at points."""
    turns = phase_per_metre(frequencies_hz)
    return samples.radiance[:, None] * np.exp(1j * samples.opl_m.astype(float)[:, None] * turns)


def sample_direct(scene: mi.Scene, points: NDArray[np.float64], seed: int) -> DirectSamples:
    """The direct return at film positions (N, 2)."""
    import drjit as dr

    from render.transport.kernels import arrays, rays

    nothing = np.zeros(0, np.float32)
    parts = [(nothing, nothing, np.zeros(0, np.uint32))]
    for number, block in enumerate(_split(points)):
        x, y = (arrays.upload(column) for column in block.T)
        si = rays.camera_hits(scene, x, y)
        radiance, opl = rays.direct_return(scene, si, _random(len(block), seed, number))
        surface = rays.surface_codes(si)
        dr.eval(radiance, opl, surface)
        parts.append((np.array(radiance), np.array(opl), np.array(surface)))
    return DirectSamples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def direct_lanes(
    scene: mi.Scene, grid: Grid, rows: tuple[int, int], rule: PixelRule, seed: int
) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.Float, mi.UInt32]:
    """Radiance, OPL, pixel index, weight and surface of all nodes in some rows."""
    import drjit as dr

    from render.transport.kernels import rays

    x, y, pixel, weight = rays.pixel_samples(
        (grid.width, grid.height), rows, rule.pixel_nodes, rule.pixel_weights
    )
    si = rays.camera_hits(scene, x, y)
    radiance, opl = rays.direct_return(scene, si, _random(dr.width(x), seed, rows[0]))
    return radiance, opl, pixel, weight, rays.surface_codes(si)


def seen_surfaces(scene: mi.Scene, points: NDArray[np.float64]) -> NDArray[np.uint32]:
    """(N,) number of the surface that is seen at film positions (N, 2).

    0 is none, or one that reflects nothing.
    """
    import drjit as dr

    from render.transport.kernels import arrays, rays

    parts = [np.zeros(0, np.uint32)]
    for block in _split(points):
        x, y = (arrays.upload(column) for column in block.T)
        surface = rays.surface_codes(rays.camera_hits(scene, x, y))
        dr.eval(surface)
        parts.append(np.array(surface))
    return np.concatenate(parts)


def _split(points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    if len(points):
        yield from np.array_split(points, -(-len(points) // LANES))


def _random(lanes: int, seed: int, number: int) -> mi.Point2f:
    """Random samples. Only emitters with an extent use them; a projector is a point."""
    import drjit as dr
    import mitsuba as mi

    stream = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    random = mi.PCG32(lanes, dr.opaque(mi.UInt64, stream))
    return mi.Point2f(random.next_float32(), random.next_float32())
