"""Points on the hidden surface: spread evenly, and more of them where the wall's light falls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from scenegen import NightError

if TYPE_CHECKING:
    import mitsuba as mi

HIDDEN_PREFIX = "hidden_object"
_CURVE_BITS = 10  # of each coordinate along the space-filling curve


class HiddenSurfaceError(NightError):
    """A hidden object that cannot be sampled."""


@dataclass(frozen=True)
class HiddenSurface:
    """All triangles of the hidden objects, one object after the other, along a space-filling curve.

    Positions along that order, in units of area, are one coordinate of a low-discrepancy sample: points that
    are stratified along the curve are stratified in space, whatever order the mesh file has.

    Attributes
    ----------
    corners : (T, 3, 3) triangle corners, metres.
    normals : (T, 3) unit normals, by winding.
    areas : (T,) square metres.
    reflectance : (T,) diffuse reflectance of the object a triangle belongs to.
    """

    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    areas: NDArray[np.float64]
    reflectance: NDArray[np.float64]


@dataclass(frozen=True)
class SurfacePoints:
    """Points with the share of the surface each stands for.

    Attributes
    ----------
    position, normal : (M, 3) float32, metres and unit.
    area : (M,) square metres: the sum over points is an estimate of the integral over the surface.
    reflectance : (M,) of the surface there.
    shift : (M, 4) in [0, 1): turns the wall points, so that every point sees others (Cranley and Patterson,
        "Randomization of number theoretic methods for multiple integration", 1976).
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
    """Triangles of all hidden objects; None when there is no hidden object.

    Triangles without area are left out: no light can fall on them.

    Raises
    ------
    HiddenSurfaceError : a hidden object that is no mesh, has no area or corners that are not finite, or
        whose material is not diffuse.
    """
    parts = [_triangles(shape) for shape in hidden_shapes(scene)]
    if not parts:
        return None
    corners = np.concatenate([part[0] for part in parts])
    reflectance = np.concatenate([part[1] for part in parts])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    keep = np.flatnonzero(twice_area > 0)
    part = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    order = keep[np.lexsort((_curve_position(corners[keep].mean(axis=1)), part[keep]))]
    return HiddenSurface(
        corners[order],
        cross[order] / twice_area[order, None],
        twice_area[order] / 2,  # half a parallelogram, not a path length
        reflectance[order],
    )


def sample_surface(
    surface: HiddenSurface, count: int, seed: int, density: NDArray[np.float64]
) -> SurfacePoints:
    """Scrambled Sobol points on the surface, in proportion to a density.

    Parameters
    ----------
    count : how many; powers of two are spread best.
    seed : of the scrambling.
    density : (S,) relative density of points in S stretches of equal area along the curve, above 0.
    """
    sample = sobol_points(6, count, seed)
    total = surface.areas.sum()
    share = density / density.sum()
    edges = np.concatenate([[0.0], np.cumsum(share)])
    along = np.interp(sample[:, 0], edges, np.linspace(0, total, len(edges)))
    stretch = np.minimum((along / total * len(share)).astype(int), len(share) - 1)
    area = total / count / (share[stretch] * len(share))
    return _place(surface, along, sample[:, 1], area, sample[:, 2:])


def spread_evenly(surface: HiddenSurface, count: int) -> SurfacePoints:
    """One point in the middle of each of `count` stretches of equal area along the curve."""
    total = surface.areas.sum()
    along = (np.arange(count) + 0.5) / count * total
    rolling = np.arange(count)[:, None] * np.sqrt([2, 3, 5, 7, 11]) % 1  # irrational: neighbours lie apart
    return _place(surface, along, rolling[:, 0], np.full(count, total / count), rolling[:, 1:])


def sobol_points(dimensions: int, count: int, seed: int) -> NDArray[np.float64]:
    """(count, dimensions) first points of a scrambled Sobol sequence, in [0, 1)."""
    powers = max(count - 1, 0).bit_length()  # the sequence is made for powers of two, and used from its start
    return qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed)).random_base2(powers)[:count]


def _place(
    surface: HiddenSurface,
    along: NDArray[np.float64],
    across: NDArray[np.float64],
    area: NDArray[np.float64],
    shift: NDArray[np.float64],
) -> SurfacePoints:
    """Points at positions `along` the curve (in area) and `across` their triangle (0 to 1)."""
    ends = np.cumsum(surface.areas)
    face = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    # What is left of the first coordinate within its triangle is uniform again.
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
    return corners, np.full(len(faces), _diffuse_reflectance(shape))


def _diffuse_reflectance(shape: mi.Shape) -> float:
    """Reflectance of a two-sided, uniform diffuse material, read by evaluating it."""
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
            f"the material of hidden object {shape.id()} is not two-sided diffuse, and many-light can do no "
            "other: render with --method path"
        )
    return values[0]


def _curve_position(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Position of points along a three-dimensional Morton curve through their bounding box."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    cell = ((points - low) / span * (2**_CURVE_BITS - 1)).astype(np.int64)  # (T, 3)
    position = np.zeros(len(points), np.int64)
    for bit in range(_CURVE_BITS):
        for axis in range(3):
            position |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return position
