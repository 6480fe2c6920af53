"""Simple solids: points on their surfaces, where rays meet them, and what is inside.

A solid fills a box of three extents around its centre, along its own axes, as the shapes of a preset do: box,
cylinder and cone along z (the cone's tip at +z), ellipsoids with equal axes only, and a sheet bent to a
circular arc of ±1 rad about z, concave on its +x side.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

_SHEET_RAD: Final = 1.0  # half the angle of the sheet's arc
_TINY = 1e-12
_BOX, _SPHERE, _CYLINDER, _CONE, _SHEET = "box", "sphere", "cylinder", "cone", "sheet"
# Which kind the shapes of presets are.
KIND_OF_SHAPE: Final = {
    "cube": _BOX,
    "parallelepiped": _BOX,
    "sphere": _SPHERE,
    "cylinder": _CYLINDER,
    "cone": _CONE,
    "concave_plane": _SHEET,
}
Samples = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Solid:
    """A placed solid.

    Attributes
    ----------
    shape : name of the shape in presets, a key of `KIND_OF_SHAPE`.
    size_m : extents along its own axes, metres. A sheet's first extent follows from its second, the chord.
    centre_m : (3,) metres, in camera axes.
    axes : (3, 3) rotation; its columns are the solid's own axes.
    """

    shape: str
    size_m: tuple[float, float, float]
    centre_m: NDArray[np.float64]
    axes: NDArray[np.float64]

    @property
    def kind(self) -> str:
        """Which formulas it follows."""
        return KIND_OF_SHAPE[self.shape]

    @property
    def is_sheet(self) -> bool:
        """Whether both sides of the surface can be lit, and the surface can hide itself."""
        return self.kind == _SHEET

    @property
    def turns(self) -> bool:
        """Whether a rotation changes it."""
        return self.kind != _SPHERE

    def moved(self, by_m: NDArray[np.float64], turned_rad: NDArray[np.float64] | None = None) -> Solid:
        """Moved by a vector and then turned about its centre by a rotation vector, in camera axes."""
        axes = self.axes if turned_rad is None else Rotation.from_rotvec(turned_rad).as_matrix() @ self.axes
        return replace(self, centre_m=self.centre_m + by_m, axes=axes)

    def stretched(self, exponents: NDArray[np.float64]) -> Solid:
        """With its free extents (`stretches`) multiplied by the exponential of (n,) numbers."""
        factors = np.exp(exponents @ self.stretches)
        x, y, z = (np.asarray(self.size_m) * factors).tolist()
        return replace(self, size_m=(x, y, z))

    @property
    def stretches(self) -> NDArray[np.float64]:
        """(n, 3) which extents change together; a cube stays a cube, and what is round stays round."""
        if self.shape == "cube" or self.kind == _SPHERE:
            return np.ones((1, 3))
        if self.kind == _BOX:
            return np.eye(3)
        return np.array([[1.0, 1, 0], [0, 0, 1]])

    def surface(self, fine: bool) -> Samples:
        """(S, 3) points and (S, 3) outward unit normals in camera axes, and (S,) their areas, m²."""
        points, normals, areas = _SAMPLES[self.kind](np.asarray(self.size_m), fine)
        return points @ self.axes.T + self.centre_m, normals @ self.axes.T, areas

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(S,) whether (S, 3) points are inside."""
        own, half = (points - self.centre_m) @ self.axes, np.asarray(self.size_m) / 2
        if self.kind == _BOX:
            return np.asarray((np.abs(own) < half).all(axis=1))
        if self.kind == _SPHERE:
            return np.asarray(np.linalg.norm(own, axis=1) < half[0])
        if self.kind == _SHEET:
            return np.zeros(len(points), bool)
        radius = half[0] * (1.0 if self.kind == _CYLINDER else 0.5 - own[:, 2] / self.size_m[2])
        return np.asarray((np.hypot(own[:, 0], own[:, 1]) < radius) & (np.abs(own[:, 2]) < half[2]))

    def first_hit(self, origin: Tensor, direction: Tensor) -> Tensor:
        """(...,) in lengths of `direction`, where rays first meet the surface ahead of them; else inf.

        `origin` and `direction`, (..., 3) in camera axes, broadcast. For an origin inside a box or a sphere,
        it is 0.
        """
        axes = torch.as_tensor(self.axes, dtype=direction.dtype)
        centre = torch.as_tensor(self.centre_m, dtype=direction.dtype)
        own, along = (origin - centre) @ axes, direction @ axes
        size = torch.as_tensor(self.size_m, dtype=direction.dtype)
        return _HITS[self.kind](own, torch.where(along.abs() < _TINY, _TINY, along), size)


def _quadrature(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Nodes and weights of Gauss and Legendre on [0, 1]."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return (node + 1) / 2, weight / 2


def _box_samples(size_m: NDArray[np.float64], fine: bool) -> Samples:
    node, weight = _quadrature(6 if fine else 4)
    u, v = (each.ravel() - 0.5 for each in np.meshgrid(node, node))
    share = np.outer(weight, weight).ravel()
    points, normals, areas = [], [], []
    for axis in range(3):
        one, two = (axis + 1) % 3, (axis + 2) % 3
        for side in (0.5, -0.5):
            face, normal = np.empty((len(u), 3)), np.zeros((len(u), 3))
            face[:, axis], face[:, one], face[:, two], normal[:, axis] = side, u, v, 2 * side
            points.append(face * size_m)
            normals.append(normal)
            areas.append(share * size_m[one] * size_m[two])
    return np.concatenate(points), np.concatenate(normals), np.concatenate(areas)


def _sphere_samples(size_m: NDArray[np.float64], fine: bool) -> Samples:
    """Fibonacci's points, each with the same area."""
    count = 300 if fine else 100
    place = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * place / count, place * np.pi * (1 + math.sqrt(5))
    ring = np.sqrt(1 - z**2)
    normals = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
    radius = size_m[0] / 2
    return radius * normals, normals, np.full(count, 4 * np.pi * radius**2 / count)


def _frustum_samples(size_m: NDArray[np.float64], fine: bool, top: float) -> Samples:
    """Cylinder (`top` 1) or cone (`top` 0): the side, and one or two discs."""
    radius, height = size_m[0] / 2, size_m[2]
    rise, around = (8, 24) if fine else (5, 16)
    slant = math.hypot(height, radius * (1 - top))
    node, weight = _quadrature(rise)
    angle, up = np.meshgrid((np.arange(around) + 0.5) * 2 * np.pi / around, node)  # (rise, around)
    at = radius * (1 + (top - 1) * up)
    points = [np.stack([at * np.cos(angle), at * np.sin(angle), height * (up - 0.5)], axis=-1)]
    tilt = height / slant, radius * (1 - top) / slant
    normals = [
        np.stack([tilt[0] * np.cos(angle), tilt[0] * np.sin(angle), np.full_like(at, tilt[1])], axis=-1)
    ]
    areas = [weight[:, None] * slant * at * (2 * np.pi / around)]
    rings, around = (5, 16) if fine else (3, 10)
    node, weight = _quadrature(rings)
    angle, out = np.meshgrid((np.arange(around) + 0.5) * 2 * np.pi / around, node)
    for end in (-1.0, 1.0) if top else (-1.0,):
        x, y = radius * out * np.cos(angle), radius * out * np.sin(angle)
        points.append(np.stack([x, y, np.full_like(x, end * height / 2)], axis=-1))
        normals.append(np.broadcast_to([0.0, 0.0, end], (*x.shape, 3)))
        areas.append(weight[:, None] * radius**2 * out * (2 * np.pi / around))
    flat = [np.concatenate([each.reshape(-1, 3) for each in group]) for group in (points, normals)]
    return flat[0], flat[1], np.concatenate([each.ravel() for each in areas])


def _sheet_samples(size_m: NDArray[np.float64], fine: bool) -> Samples:
    radius, middle = _arc(size_m[1])
    across, up = (24, 12) if fine else (12, 6)  # many, because the sheet can be in its own shadow
    node, weight = _quadrature(across)
    height, share = _quadrature(up)
    angle, z = np.meshgrid(_SHEET_RAD * (2 * node - 1), size_m[2] * (height - 0.5))  # (up, across)
    x, y = middle - radius * np.cos(angle), radius * np.sin(angle)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    normals = np.stack([np.cos(angle), -np.sin(angle), np.zeros_like(angle)], axis=-1).reshape(-1, 3)
    areas = np.outer(share, weight).ravel() * 2 * _SHEET_RAD * radius * size_m[2]
    return points, normals, areas


def _arc(chord: float) -> tuple[float, float]:
    """Radius of the sheet's arc, and the x of the arc's centre; the sheet is centred at its sagitta."""
    radius = chord / (2 * math.sin(_SHEET_RAD))
    return radius, radius * (1 + math.cos(_SHEET_RAD)) / 2


def _box_hit(own: Tensor, along: Tensor, size: Tensor) -> Tensor:
    one, two = (-size / 2 - own) / along, (size / 2 - own) / along
    enter, leave = torch.minimum(one, two).amax(-1), torch.maximum(one, two).amin(-1)
    return torch.where((enter <= leave) & (leave > 0), enter.clamp(min=0), math.inf)


def _sphere_hit(own: Tensor, along: Tensor, size: Tensor) -> Tensor:
    a, b, c = (along**2).sum(-1), (own * along).sum(-1), (own**2).sum(-1) - (size[0] / 2) ** 2
    root = torch.sqrt((b**2 - a * c).clamp(min=0))
    hit = (b**2 >= a * c) & (root > b)
    return torch.where(hit, ((-b - root) / a).clamp(min=0), math.inf)


def _frustum_hit(own: Tensor, along: Tensor, size: Tensor, top: float) -> Tensor:
    (x, y, z), (u, v, w) = own.unbind(-1), along.unbind(-1)
    half, slope = size[2] / 2, (top - 1) * size[0] / 2 / size[2]
    middle = size[0] / 4 * (1 + top)  # the radius halfway up
    at = middle + slope * z
    a, b = u**2 + v**2 - (slope * w) ** 2, x * u + y * v - slope * w * at
    c = x**2 + y**2 - at**2
    hits = [(t, (z + t * w).abs() <= half) for t in _roots(a, b, c)]
    for end in (-1.0, 1.0) if top else (-1.0,):
        t = (end * half - z) / w
        hits.append((t, (x + t * u) ** 2 + (y + t * v) ** 2 <= (size[0] / 2) ** 2))
    return _nearest(hits)


def _sheet_hit(own: Tensor, along: Tensor, size: Tensor) -> Tensor:
    radius, middle = _arc(float(size[1]))
    (x, y, z), (u, v, w) = own.unbind(-1), along.unbind(-1)
    x = x - middle
    a, b, c = u**2 + v**2, x * u + y * v, x**2 + y**2 - radius**2
    edge = -radius * math.cos(_SHEET_RAD)
    hits = [(t, ((z + t * w).abs() <= size[2] / 2) & (x + t * u <= edge)) for t in _roots(a, b, c)]
    return _nearest(hits)


def _roots(a: Tensor, b: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
    """Roots of a t² + 2 b t + c, NaN if there are none."""
    root = torch.sqrt(b**2 - a * c)
    a = torch.where(a.abs() < _TINY, _TINY, a)
    return (-b - root) / a, (-b + root) / a


def _nearest(hits: list[tuple[Tensor, Tensor]]) -> Tensor:
    """Smallest t above 0 that is on the surface; comparisons with NaN are false."""
    valid = [torch.where(on & (t > 0), t, math.inf) for t, on in hits]
    return torch.stack(valid).amin(0)


_SAMPLES: dict[str, Callable[[NDArray[np.float64], bool], Samples]] = {
    _BOX: _box_samples,
    _SPHERE: _sphere_samples,
    _CYLINDER: lambda size_m, fine: _frustum_samples(size_m, fine, 1.0),
    _CONE: lambda size_m, fine: _frustum_samples(size_m, fine, 0.0),
    _SHEET: _sheet_samples,
}
_HITS: dict[str, Callable[[Tensor, Tensor, Tensor], Tensor]] = {
    _BOX: _box_hit,
    _SPHERE: _sphere_hit,
    _CYLINDER: lambda own, along, size: _frustum_hit(own, along, size, 1.0),
    _CONE: lambda own, along, size: _frustum_hit(own, along, size, 0.0),
    _SHEET: _sheet_hit,
}
