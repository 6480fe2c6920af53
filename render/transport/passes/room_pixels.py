"""Light on pixels that show the room, from the relay wall and the hidden objects: of two or three bounces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import phase_per_metre
from render.transport.film.pixels import LANES, Grid, PixelRule, group_sums
from render.transport.lights.arrivals import Incoming, arrivals
from render.transport.lights.hidden_surface import SurfacePoints
from render.transport.lights.interreflection import reflected_arrivals
from render.transport.lights.run_statistics import relative_bound
from render.transport.passes.direct_pass import DirectImage
from render.transport.passes.direct_samples import seen_surfaces
from render.transport.passes.edge_points import choose_points

if TYPE_CHECKING:
    import mitsuba as mi

_FEWEST, _MOST = 2**5, 2**7  # paths to each node, of a run
_RUNS = 8
_LEAST_ERROR = 3e-3  # of this light: it is two or three bounces, and seldom all that counts


@dataclass(frozen=True)
class RoomNodes:
    """M nodes of pixels that show some shapes.

    Attributes
    ----------
    points, weights, pixel : (M, 2) film positions, (M,) shares of the pixel, (M,) row-major index of it.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    pixel: NDArray[np.int64]

    @classmethod
    def of(
        cls, scene: mi.Scene, shapes: list[mi.Shape], grid: Grid, rule: PixelRule, direct: DirectImage
    ) -> RoomNodes:
        """Those of an image, whose direct return knows which surface each pixel shows."""
        import drjit as dr
        import mitsuba as mi

        codes = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in shapes]
        whole = np.flatnonzero(np.isin(direct.surface, codes))
        cut = choose_points(direct)
        shown = np.isin(seen_surfaces(scene, cut.points), codes)
        return cls(
            np.concatenate([grid.points(whole, rule.pixel_nodes).reshape(-1, 2), cut.points[shown]]),
            np.concatenate([np.tile(rule.pixel_weights, len(whole)), cut.weights[shown]]),
            np.concatenate([np.repeat(whole, rule.count), cut.pixels[cut.group][shown]]),
        )

    def light(
        self,
        scene: mi.Scene,
        frequencies_hz: tuple[float, ...],
        wall: mi.Shape,
        objects: list[mi.Shape],
        seed: int,
        allowed: NDArray[np.float64],
    ) -> tuple[NDArray[np.int64], NDArray[np.complex128], NDArray[np.float64]]:
        """Pixels (P,), their light (P, F) from relay wall and objects, and a bound (F,) of its error's norm.

        It comes from an emitter over the relay wall, or over any surface and then the wall or an object.
        There are more paths until the error is `allowed`.
        """
        pixels, place = np.unique(self.pixel, return_inverse=True)
        received = _Received.at(scene, self.points)
        count = _FEWEST
        while True:
            seeds = np.random.SeedSequence([seed, 2, count]).generate_state(_RUNS).tolist()
            runs = []
            for each in seeds:
                z = np.concatenate(list(received.phasors(scene, frequencies_hz, wall, objects, each, count)))
                runs.append(group_sums(z * self.weights[:, None], place, len(pixels)))
            values = np.stack(runs)  # (R, P, F)
            mean = values.mean(axis=0)
            missed = relative_bound(values) * np.linalg.norm(mean, axis=0)
            enough = np.maximum(allowed, _LEAST_ERROR * np.linalg.norm(mean, axis=0))
            if (missed <= enough).all() or count >= _MOST:
                return pixels, mean, missed
            count = min(_MOST, count * 4)


@dataclass(frozen=True)
class _Received:
    """M points on diffuse surfaces that the camera sees: their side, their reflectance, their distance."""

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    reflectance: NDArray[np.float64]
    travelled_m: NDArray[np.float64]

    @classmethod
    def at(cls, scene: mi.Scene, points: NDArray[np.float64]) -> _Received:
        """Those behind film positions (M, 2)."""
        import drjit as dr
        import mitsuba as mi

        from render.transport.kernels import arrays, rays

        si = rays.camera_hits(scene, *(arrays.upload(column) for column in points.T))
        side = dr.copysign(mi.Float(1), si.wi.z)
        reflected = si.bsdf().eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, side)).x * dr.pi
        normal = si.n * side
        dr.eval(si.p, normal, reflected, si.t)
        where, facing = (np.array(each).reshape(3, -1).T for each in (si.p, normal))
        albedo, travelled = (np.array(each, dtype=np.float64) for each in (reflected, si.t))
        return cls(where, facing, albedo, travelled)

    def phasors(
        self,
        scene: mi.Scene,
        frequencies_hz: tuple[float, ...],
        wall: mi.Shape,
        objects: list[mi.Shape],
        seed: int,
        count: int,
    ) -> Iterator[NDArray[np.complex128]]:
        """Blocks of (M, F) phasors, by `count` paths of each kind to each point."""
        shift = np.random.default_rng(seed).random((len(self.position), 4))
        turns = phase_per_metre(frequencies_hz)
        blocks = np.array_split(np.arange(len(self.position)), -(-len(self.position) * count // LANES))
        for number, block in enumerate(blocks):
            own = (self.position[block], self.normal[block], np.ones(len(block)), self.reflectance[block])
            points = SurfacePoints(*own, shift[block])
            found = (
                arrivals(scene, points, count, seed, Incoming(over=[wall])),
                reflected_arrivals(
                    scene, points, 1, (seed + number) % 2**32, shapes=[wall, *objects], rays=count
                ),
            )
            z = np.zeros((len(block), len(turns)), complex)
            for irradiance, opl_m in found:
                lit = np.clip(irradiance, 0, None).astype(float)  # what arrives behind the point is negative
                path_m = opl_m.astype(float) + self.travelled_m[block][:, None]
                for place, turn in enumerate(turns):
                    z[:, place] += (lit * np.exp(1j * turn * path_m)).sum(axis=1)
            yield z * (self.reflectance[block] / np.pi)[:, None]
