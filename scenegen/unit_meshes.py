"""Hidden objects as triangles in the unit box around the origin: Blender's meshes, made without Blender."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from scenegen.pose import rotation_matrix
from scenegen.scene import HiddenObject
from scenegen.shapes import Shape
from scenegen.triangles import scene_triangles

# Of the bent sheet, whose arc of ±1 rad fills the unit box: radii along x and y.
ARC_DEPTH, ARC_WIDTH = float(1 / (1 - np.cos(1.0))), float(0.5 / np.sin(1.0))
ARC_SEGMENTS = 64  # around every round primitive: a chord leaves a 0.28 m circle by 0.34 mm


@dataclass(frozen=True, eq=False)
class UnitMesh:
    """Triangles of a shape before it is scaled, turned and moved.

    Attributes
    ----------
    vertices : (V, 3) float32. No position occurs twice.
    triangles : (T, 3) int32 indices.
    outermost : (N,) int64 indices of vertices that have the same convex hull as all of them.
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    outermost: NDArray[np.int64]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of vertices and triangles."""
        return hashlib.sha256(self.vertices.tobytes() + self.triangles.tobytes()).hexdigest()

    @cached_property
    def hull(self) -> NDArray[np.float64]:
        """(N, 3) positions of the outermost vertices."""
        return self.vertices[self.outermost].astype(np.float64)

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from the origin; 1/2 to √3/2."""
        return float(np.linalg.norm(self.hull, axis=1).max())


@cache
def unit_mesh(shape: Shape) -> UnitMesh:
    """The mesh of a primitive; it fills the unit box, and its arrays cannot be written.

    Its vertices ascend in z, then y, then x, as in Blender's mesh. The triangles of solids turn anticlockwise
    seen from outside, those of the concave plane seen from its concave side, +x. The outermost vertices are
    all of them.
    """
    corners = _quads(shape)  # (Q, 4, 3)
    rounded = np.round(corners.reshape(-1, 3)[:, ::-1], 5) + 0.0  # adding 0 makes -0 and 0 the same
    _, first, place_of = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    quads = place_of.reshape(-1, 4)
    # Blender cuts a quad from its smallest vertex. At a pole two corners are one, and a triangle has no area.
    turned = np.take_along_axis(quads, (quads.argmin(axis=1)[:, None] + np.arange(4)) % 4, axis=1)
    triangles = turned[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    vertices = corners.reshape(-1, 3)[first].astype(np.float32)
    mesh = UnitMesh(vertices, triangles[has_area].astype(np.int32), np.arange(len(vertices)))
    for array in (mesh.vertices, mesh.triangles, mesh.outermost, mesh.hull):
        array.setflags(write=False)
    return mesh


def unit_mesh_of_part(part: HiddenObject, contents: bytes, origin: str) -> UnitMesh:
    """The mesh of a placed object, from its PLY file in the scene's folder; all its vertices are outermost.

    Raises
    ------
    MeshError : as `scenegen.triangles.scene_triangles`.
    """
    vertices, triangles = scene_triangles(contents, origin)
    unit = (vertices - part.location_m) @ rotation_matrix(part.rotation_deg) / part.size_m
    return UnitMesh(unit.astype(np.float32), triangles.astype(np.int32), np.arange(len(unit)))


def concave_arc(angle: float | NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and y of the concave plane at an angle of ±1 rad about z: an arc, scaled to the unit box."""
    return (1 - np.cos(angle)) / (1 - np.cos(1.0)) - 0.5, 0.5 * (np.sin(angle) / np.sin(1.0))


def _quads(shape: Shape) -> NDArray[np.float64]:
    """(Q, 4, 3) corners of the quads of a primitive."""
    if shape in ("cube", "parallelepiped"):
        top = np.array([[-0.5, -0.5, 0.5], [0.5, -0.5, 0.5], [0.5, 0.5, 0.5], [-0.5, 0.5, 0.5]])
        faces = [np.roll(top, axis, axis=1) for axis in range(3)]
        return np.stack([*faces, *(-face[::-1] for face in faces)])
    if shape == "concave_plane":
        x, y = concave_arc(np.linspace(-1, 1, ARC_SEGMENTS + 1))
        return _grid_quads(np.stack([np.stack([x, y, np.full_like(x, z)], axis=1) for z in (-0.5, 0.5)]))
    azimuth = np.linspace(0, 2 * np.pi, ARC_SEGMENTS + 1)
    rings = [
        np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full_like(azimuth, z)], axis=1)
        for radius, z in _profile(shape)
    ]
    return _grid_quads(np.stack(rings))


def _profile(shape: Shape) -> list[tuple[float, float]]:
    """Radius and z of the rings of a solid of revolution, from its lowest point to its highest."""
    if shape == "sphere":
        polar = np.linspace(0, np.pi, ARC_SEGMENTS // 2 + 1)
        return [(0.5 * float(np.sin(angle)), -0.5 * float(np.cos(angle))) for angle in polar]
    bottom, top = [(0.0, -0.5), (0.5, -0.5)], {"cylinder": [(0.5, 0.5), (0.0, 0.5)], "cone": [(0.0, 0.5)]}
    return bottom + top[shape]


def _grid_quads(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """(Q, 4, 3) corners of the quads of a grid of points (R, C, 3)."""
    corners = [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]]  # of (R - 1, C - 1, 3)
    return np.stack(corners, axis=2).reshape(-1, 4, 3)
