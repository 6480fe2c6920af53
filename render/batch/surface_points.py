"""Points on the surfaces of unit shapes, with the area of each: the quadrature of the hidden surface.

A shape fills the unit box around the origin. Placed with the extents s, its points become diag(s) p, its
normals diag(1/s) n, and its areas det(s) |diag(1/s) n| as large (Nanson's formula). A primitive has more
points along the axes in which it is longer than the paper's.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.transport.lights.hidden_surface import spread_evenly, triangle_surface
from scenegen.shapes import Shape
from scenegen.unit_meshes import ARC_DEPTH, ARC_WIDTH, UnitMesh, concave_arc

Floats = NDArray[np.float64]
Finer = tuple[float, float, float]  # along x, y and z
_LONG: Final = 1.6  # extent over the mean extent above which a side is long: that of the parallelepiped
_MOST_LONGER: Final = 6  # levels: rods thinner than 1 : 50 need no more, and would fill the memory
_MESH_POINTS: Final = 100  # of a user's mesh at level 0
_KEPT: Final = 64  # meshes whose points are kept, and stretched primitives


@dataclass(frozen=True)
class UnitPoints:
    """(S, 3) points, (S, 3) outward unit normals and (S,) areas of a unit shape."""

    points: Floats
    normals: Floats
    areas: Floats

    def both_sides(self) -> UnitPoints:
        """The points of an open sheet, which has two sides."""
        return UnitPoints(
            np.concatenate([self.points, self.points]),
            np.concatenate([self.normals, -self.normals]),
            np.concatenate([self.areas, self.areas]),
        )


def surface_points(
    shape: Shape, level: int, mesh: UnitMesh, longer: tuple[int, int, int] = (0, 0, 0)
) -> UnitPoints:
    """The points of a primitive or of a user's mesh; twice as many with every `level`.

    `longer` are more levels along the axes of a primitive, as `longer_sides` has them.
    """
    return _primitive_points(shape, level, longer) if shape in _PRIMITIVES else _mesh_points(mesh, level)


def longer_sides(shape: Shape, size_m: Floats) -> tuple[int, int, int]:
    """Levels along each axis that an object with extents (3,) needs more than one of the paper's."""
    if shape not in _PRIMITIVES:
        return 0, 0, 0
    long_m = _LONG * math.prod(size_m) ** (1 / 3)
    x, y, z = (min(max(0, math.ceil(2 * math.log2(side / long_m))), _MOST_LONGER) for side in size_m.tolist())
    return x, y, z


@functools.lru_cache(_KEPT)
def _primitive_points(shape: Shape, level: int, longer: tuple[int, int, int]) -> UnitPoints:
    x, y, z = (2.0 ** ((level + more) / 2) for more in longer)
    return _PRIMITIVES[shape]((x, y, z))


@functools.lru_cache(_KEPT)
def _mesh_points(mesh: UnitMesh, level: int) -> UnitPoints:
    """Points of a mesh that represent equal areas, on both sides of it."""
    surface = triangle_surface(mesh.vertices[mesh.triangles].astype(np.float64))
    spread = spread_evenly(surface, _MESH_POINTS * 2**level)
    return UnitPoints(spread.position.astype(float), spread.normal.astype(float), spread.area).both_sides()


def _gauss(count: int) -> tuple[Floats, Floats]:
    """Nodes in (0, 1) and weights of Gauss and Legendre."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return (node + 1) / 2, weight / 2


def _box(finer: Finer) -> UnitPoints:
    nodes = [_gauss(round(2.9 * each)) for each in finer]
    points, normals, areas = [], [], []
    for axis in range(3):
        (u, wide), (v, high) = nodes[(axis + 1) % 3], nodes[(axis + 2) % 3]
        u, v = (each.ravel() - 0.5 for each in np.meshgrid(u, v))
        for side in (0.5, -0.5):
            face, normal = np.empty((len(u), 3)), np.zeros((len(u), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, u, v
            normal[:, axis] = 2 * side
            points.append(face)
            normals.append(normal)
            areas.append(np.outer(high, wide).ravel())
    return UnitPoints(*(np.concatenate(each) for each in (points, normals, areas)))


def _sphere(finer: Finer) -> UnitPoints:
    """Fibonacci's points, each with the same area."""
    count = round(50 * math.prod(finer) / min(finer))
    place = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * place / count, place * np.pi * (1 + math.sqrt(5))
    ring = np.sqrt(1 - z**2)
    normals = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    return UnitPoints(normals / 2, normals, np.full(count, np.pi / count))


def _frustum(finer: Finer, top: float) -> UnitPoints:
    """Cylinder (`top` 1) or cone (`top` 0): the side, and one or two discs."""
    wide = max(finer[:2])
    rise, around = round(2.9 * finer[2]), round(10 * wide)
    slant = math.hypot(1, (1 - top) / 2)
    up, weight = (each[:, None] for each in _gauss(rise))
    radius = (1 + (top - 1) * up) / 2
    angle = _turn(rise, around)
    points = [np.stack([radius * np.cos(angle), radius * np.sin(angle), up - 0.5 + 0 * angle], axis=-1)]
    normals = [np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, (1 - top) / 2)], axis=-1) / slant]
    areas = [weight * slant * radius * (2 * np.pi / around) + 0 * angle]
    rings, around = round(2.1 * min(finer[:2])), round(7 * wide)
    out, weight = (each[:, None] for each in _gauss(rings))
    angle = _turn(rings, around)
    for end in (-1.0, 1.0) if top else (-1.0,):
        disc = [out / 2 * np.cos(angle), out / 2 * np.sin(angle), np.full_like(angle, end / 2)]
        points.append(np.stack(disc, axis=-1))
        normals.append(np.broadcast_to([0.0, 0.0, end], (*angle.shape, 3)))
        areas.append(weight * out / 4 * (2 * np.pi / around) + 0 * angle)
    at, normal = (np.concatenate([each.reshape(-1, 3) for each in group]) for group in (points, normals))
    return UnitPoints(at, normal, np.concatenate([each.ravel() for each in areas]))


def _turn(rings: int, around: int) -> Floats:
    """(rings, around) even angles; each ring is turned by another part of a step."""
    offset = (np.arange(rings)[:, None] * (math.sqrt(5) - 1) / 2) % 1
    turned: Floats = (np.arange(around) + offset) * 2 * np.pi / around
    return turned


def _sheet(finer: Finer) -> UnitPoints:
    """A sheet bent to an arc of ±1 rad about z, concave on its +x side, with both sides."""
    across, up = round(8 * max(finer[:2])), round(4.5 * finer[2])
    node, weight = _gauss(across)
    height, share = _gauss(up)
    angle, z = np.meshgrid(2 * node - 1, height - 0.5)  # (up, across), ±1 rad
    points = np.stack([*concave_arc(angle), z], axis=-1).reshape(-1, 3)
    slope = np.stack([ARC_WIDTH * np.cos(angle), -ARC_DEPTH * np.sin(angle), 0 * angle], axis=-1)
    speed = np.linalg.norm(slope.reshape(-1, 3), axis=1)
    areas = np.outer(share, weight).ravel() * 2 * speed
    return UnitPoints(points, slope.reshape(-1, 3) / speed[:, None], areas).both_sides()


_PRIMITIVES: dict[Shape, Callable[[Finer], UnitPoints]] = {
    "cube": _box,
    "cylinder": lambda finer: _frustum(finer, 1.0),
    "sphere": _sphere,
    "cone": lambda finer: _frustum(finer, 0.0),
    "concave_plane": _sheet,
    "parallelepiped": _box,
}
