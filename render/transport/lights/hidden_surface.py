"""Sample points on the hidden surface: even, or denser where light from the wall arrives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from disk import NightError

if TYPE_CHECKING:
    import mitsuba as mi

HIDDEN_PREFIX = "hidden_object"
_CURVE_BITS = 10  # of each coordinate of the space-filling curve
_SOBOL_BITS = 30


class HiddenSurfaceError(NightError):
    """A hidden object has a mesh or a material that cannot be sampled."""


@dataclass(frozen=True)
class HiddenSurface:
    """All triangles of the hidden objects, object by object, in the order of a space-filling curve.

    The position in this order, measured in area, is one coordinate of a low-discrepancy sample. Points that
    are even along the curve are even in space, for any order of the triangles in the mesh file.

    Attributes
    ----------
    corners : (T, 3, 3) triangle corners, metres.
    normals : (T, 3) unit normals; the winding gives their direction.
    areas : (T,) square metres.
    reflectance : (T,) diffuse reflectance of the material.
    """

    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    areas: NDArray[np.float64]
    reflectance: NDArray[np.float64]


@dataclass(frozen=True)
class SurfacePoints:
    """M points, each with the area of the surface that it represents.

    Attributes
    ----------
    position, normal : (M, 3) float32, metres and unit vectors.
    area : (M,) square metres; a sum over points weighted with it estimates the integral over the surface.
    reflectance : (M,) diffuse reflectance at the point.
    shift : (M, 4) in [0, 1): shifts the wall points, so that every surface point has different ones (Cranley
        and Patterson, "Randomization of number theoretic methods for multiple integration", 1976).
    """

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    area: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    shift: NDArray[np.float64]


def hidden_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """Shapes of a scene whose id starts with ``hidden_object``."""
    return [shape for shape in scene.shapes() if shape.id().startswith(HIDDEN_PREFIX)]


def read_hidden_surface(scene: mi.Scene) -> HiddenSurface | None:
    """Triangles of all hidden objects; None if there is no hidden object.

    Triangles without area are left out, because they receive no light.

    Raises
    ------
    HiddenSurfaceError : a hidden object is not a mesh, has no area, has corners that are not finite, or has a
        material that is not two-sided diffuse.
    """
    return read_surface(hidden_shapes(scene))


def read_surface(shapes: Sequence[mi.Shape]) -> HiddenSurface | None:
    """Triangles of some shapes, as `read_hidden_surface` reads those of hidden objects."""
    parts = [_triangles(shape) for shape in shapes]
    if not parts:
        return None
    reflectance = np.concatenate([part[1] for part in parts])
    part = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    return triangle_surface(np.concatenate([part[0] for part in parts]), reflectance, part)


def triangle_surface(
    corners: NDArray[np.float64],
    reflectance: NDArray[np.float64] | None = None,
    part: NDArray[np.int64] | None = None,
) -> HiddenSurface:
    """Triangles (T, 3, 3) in the order of the curve, `part` (T,) by part; those without area are left out."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    parallelogram = np.linalg.norm(cross, axis=1)  # twice the area of the triangle
    keep = np.flatnonzero(parallelogram > 0)
    along = _curve_position(corners[keep].mean(axis=1))
    order = keep[np.argsort(along, kind="stable") if part is None else np.lexsort((along, part[keep]))]
    return HiddenSurface(
        corners[order],
        cross[order] / parallelogram[order, None],
        parallelogram[order] / 2,
        np.ones(len(order)) if reflectance is None else reflectance[order],
    )


def sample_surface(
    surface: HiddenSurface, count: int, seed: int, density: NDArray[np.float64]
) -> SurfacePoints:
    """Scrambled Sobol points on the surface with a given density.

    Parameters
    ----------
    count : number of points; powers of two give the most even set.
    seed : of the scrambling.
    density : (S,) relative density of points in S stretches of equal area along the curve, all above 0.
    """
    sample = sobol_points(6, count, seed)
    sample = sample[np.argsort(sample[:, 0])]  # neighbours in the list are neighbours in space
    total = surface.areas.sum()
    share = density / density.sum()
    edges = np.concatenate([[0.0], np.cumsum(share)])
    along = np.interp(sample[:, 0], edges, np.linspace(0, total, len(edges)))
    stretch = np.minimum((along / total * len(share)).astype(int), len(share) - 1)
    area = total / count / (share[stretch] * len(share))
    return _place(surface, along, sample[:, 1], area, sample[:, 2:])


def spread_evenly(surface: HiddenSurface, count: int) -> SurfacePoints:
    """Points on the surface in the middle of `count` stretches of equal area along the curve."""
    total = surface.areas.sum()
    along = (np.arange(count) + 0.5) / count * total
    # Multiples of irrational numbers modulo 1 are spread evenly, and neighbours are far apart.
    rolling = np.arange(count)[:, None] * np.sqrt([2, 3, 5, 7, 11]) % 1
    return _place(surface, along, rolling[:, 0], np.full(count, total / count), rolling[:, 1:])


def joined(parts: Iterable[SurfacePoints]) -> SurfacePoints:
    """All points of several sets."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return SurfacePoints(*(np.concatenate(column) for column in columns))


def sobol_points(dimensions: int, count: int, seed: int) -> NDArray[np.float64]:
    """(count, dimensions) first points of a Sobol sequence in [0, 1), with a random digital shift.

    The shift makes every point uniformly distributed, and keeps the points even.
    """
    powers = max(count - 1, 0).bit_length()  # Sobol points are even from the start up to a power of two
    shift = np.random.default_rng(seed).integers(0, 2**_SOBOL_BITS, dimensions)
    return ((_sobol(dimensions, powers)[:count] ^ shift) + 0.5) / 2**_SOBOL_BITS


@cache
def _sobol(dimensions: int, powers: int) -> NDArray[np.int64]:
    """(2^powers, dimensions) Sobol points as integers of `_SOBOL_BITS` bits, linearly scrambled."""
    engine = qmc.Sobol(dimensions, bits=_SOBOL_BITS, scramble=True, rng=np.random.default_rng(0))
    points = np.floor(engine.random_base2(powers) * 2**_SOBOL_BITS).astype(np.int64)
    points.setflags(write=False)
    return points


def _place(
    surface: HiddenSurface,
    along: NDArray[np.float64],
    across: NDArray[np.float64],
    area: NDArray[np.float64],
    shift: NDArray[np.float64],
) -> SurfacePoints:
    """Points at positions `along` the curve (square metres) and `across` their triangle (0 to 1)."""
    ends = np.cumsum(surface.areas)
    face = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    # The rest of the first coordinate is uniform within the triangle, so it is used as a second one there.
    within = np.clip((along - (ends[face] - surface.areas[face])) / surface.areas[face], 0, 1)
    root = np.sqrt(within)
    u, v = 1 - root, across * root
    a, b, c = np.moveaxis(surface.corners[face], 1, 0)
    position = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return SurfacePoints(
        position.astype(np.float32),
        surface.normals[face].astype(np.float32),
        area,
        surface.reflectance[face],
        shift,
    )


def _triangles(shape: mi.Shape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import mitsuba as mi

    if not shape.is_mesh():
        raise HiddenSurfaceError(
            f"hidden object {shape.id()} is a {type(shape).__name__}, not a mesh: export it as a mesh, "
            "or render with --method path"
        )
    parameters = mi.traverse(shape)
    vertices = np.array(parameters["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    corners = vertices[faces]
    if not len(faces) or not np.isfinite(corners).all():
        raise HiddenSurfaceError(
            f"hidden object {shape.id()} has no triangles, or corners that are not finite: repair the mesh"
        )
    edges = corners[:, 1:] - corners[:, :1]
    if not np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).any():
        raise HiddenSurfaceError(
            f"hidden object {shape.id()} has only degenerate triangles (no area): repair the mesh"
        )
    return corners, np.full(len(faces), surface_reflectance(shape))


def surface_reflectance(shape: mi.Shape) -> float:
    """Reflectance of a two-sided diffuse material, from three evaluations of its BSDF.

    Raises
    ------
    HiddenSurfaceError : the three values differ, so the material is not two-sided diffuse.
    """
    import mitsuba as mi

    bsdf = shape.bsdf()
    si = mi.SurfaceInteraction3f()
    values = []
    for incoming, outgoing in (
        ((0, 0, 1), (0, 0, 1)),
        ((0.6, 0, 0.8), (0, -0.6, 0.8)),
        ((0, 0, -1), (0.6, 0, -0.8)),
    ):
        si.wi = mi.Vector3f(*incoming)
        cosine = abs(outgoing[2])
        values.append(float(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(*outgoing)).x[0]) * np.pi / cosine)
    if max(values) - min(values) > 1e-4 * max(values):
        raise HiddenSurfaceError(
            f"the material of hidden object {shape.id()} is not two-sided diffuse, which many-light needs: "
            "render with --method path"
        )
    return values[0]


def _curve_position(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Position of points along a three-dimensional Morton curve in their bounding box."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    cell = ((points - low) / span * (2**_CURVE_BITS - 1)).astype(np.int64)  # (T, 3)
    position = np.zeros(len(points), np.int64)
    for bit in range(_CURVE_BITS):
        for axis in range(3):
            position |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return position
