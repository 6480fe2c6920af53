"""The nodes of a batch: points of the projector's film and of the hidden surfaces, lattices over the images.

Each scene has its own numbers of nodes: a level has about twice the points of the one before.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.batch.chebyshev import chebyshev
from render.batch.free_surface import free_parts
from render.batch.quadrics import is_convex
from render.batch.surface_points import UnitPoints, longer_sides, surface_points
from render.batch.tables import Scenes, rotated
from render.walls.corners import Corners
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
FILM: Final = tuple((round(5 * 2 ** (level / 2)), round(3.5 * 2 ** (level / 2))) for level in range(8))
_MOST_NODES: Final = 40  # of a lattice along a side
_LATTICE_STEP: Final = 1.2  # of its sizes
_FEWEST_NODES: Final = 6
_AT_FIRST: Final = 20.0  # error of polynomials of degree 0, about
_LIFT: Final = 5e-4  # of the largest extent: rays of a surface start above the chords of round meshes
_NO_SOLID: Final = 2**32 - 1  # of points that their own object can hide
_LEAST_REACH: Final = 1e-3  # of the largest m · r in an image: nodes beyond meet the wall at this distance


@dataclass(frozen=True)
class Nodes:
    """Flat arrays of nodes, those of each scene side by side.

    Attributes
    ----------
    scene : (M,) number of the scene.
    first, last : (N,) of each scene.
    values : (M, k) what the nodes are.
    """

    scene: Ints
    first: Ints
    last: Ints
    values: Floats

    @classmethod
    def of(cls, count: int, scene: Ints, values: Floats) -> Nodes:
        """Nodes in any order, of a batch of `count` scenes."""
        order = np.argsort(scene, kind="stable")
        ends = np.cumsum(np.bincount(scene, minlength=count))
        return cls(scene[order], np.concatenate([[0], ends[:-1]]), ends, values[order])


def film_nodes(scenes: Scenes, chosen: Ints, level: Ints) -> Nodes:
    """Places (x, y, z) on the relay walls that the projector lights, and the film area of each.

    `level` (n,) is that of the `chosen` scenes.
    """
    scene, values = [], []
    for one in np.unique(level):
        some = chosen[level == one]
        corners = scenes.corners.some(some)
        nodes, area = corners.film(scenes.box[some], *FILM[one])  # (n, L, 2), (n, L)
        at = on_wall(corners, nodes)
        values.append(np.concatenate([at, area[..., None]], -1).reshape(-1, 4))
        scene.append(np.repeat(some, area.shape[1]))
    return Nodes.of(len(scenes.scenes), np.concatenate(scene), np.concatenate(values))


def lattice_nodes(scenes: Scenes, chosen: Ints, sizes: Ints, few: bool = False) -> Nodes:
    """Places (x, y, z) on the relay walls, row by row, of lattices with `sizes` (n, 2) across and down.

    With `few`, those of `few_places` only.
    """
    scene, values = [], []
    for across, down in np.unique(sizes, axis=0):
        some = chosen[(sizes == (across, down)).all(1)]
        x, y = chebyshev(across)[0], chebyshev(down)[0]
        (left, right), (top, bottom) = scenes.box[some].reshape(-1, 2, 2, 1).transpose(1, 2, 0, 3)
        columns = (left + right) / 2 + (right - left) / 2 * x
        rows = (top + bottom) / 2 + (bottom - top) / 2 * y
        shape = (len(some), down, across)
        nodes = np.stack(
            [np.broadcast_to(columns[:, None], shape), np.broadcast_to(rows[..., None], shape)], -1
        ).reshape(len(some), -1, 2)
        if few:
            nodes = nodes[:, few_places(across, down)]
        values.append(on_wall(scenes.corners.some(some), nodes).reshape(-1, 3))
        scene.append(np.repeat(some, nodes.shape[1]))
    return Nodes.of(len(scenes.scenes), np.concatenate(scene), np.concatenate(values))


@functools.cache
def few_places(across: int, down: int) -> Ints:
    """Indices of a dozen nodes of a lattice, spread over it."""
    x, y = (
        np.round(np.linspace(0.7, count - 1.7, few)).astype(int) for count, few in ((across, 4), (down, 3))
    )
    return (y[:, None] * across + x).ravel()


def lattice_sizes(scenes: Scenes, error: float) -> Ints:
    """(N, 2) nodes across and down that polynomials need for an error of the hidden light.

    Along a line of the film, the squared distance of a wall point to a point s of the object is a quadratic
    polynomial over the square of a linear one. Polynomials of degree n err by ρ^-n, with the Bernstein
    ellipse ρ through its complex root (Trefethen, Approximation theory and practice, ch. 8). The
    points s are corners and middles of the object's box.
    """
    rates = np.full((len(scenes.scenes), 2), np.inf)
    box = scenes.box[:, None]  # (N, 1, 4)
    number = np.array([placed.scene for placed in scenes.objects])
    points = np.stack([placed.near_points for placed in scenes.objects])  # (M, 27, 3)
    plane = scenes.corners.plane[number][:, None]
    for axis, other in ((0, 1), (1, 0)):
        first, last = box[number, :, 2 * axis], box[number, :, 2 * axis + 1]
        for share in (0.0, 0.5, 1.0):
            along, start = np.zeros(points.shape), np.zeros(points.shape)
            along[..., axis], start[..., 2] = 1, 1
            at = box[number, :, 2 * other] * (1 - share) + box[number, :, 2 * other + 1] * share
            start[..., other] = at
            along, start = (v - points * (v * plane).sum(-1, keepdims=True) for v in (along, start))
            a, b, c = (along**2).sum(-1), (along * start).sum(-1), (start**2).sum(-1)
            root = (-b + 1j * np.sqrt(np.maximum(a * c - b**2, 0))) / a
            root = (2 * root - first - last) / (last - first)
            side = root + np.sqrt(root - 1) * np.sqrt(root + 1)
            np.minimum.at(rates[:, axis], number, np.abs(side).min(1))
    needed = np.log(_AT_FIRST / error) / np.log(np.maximum(rates, 1.01))
    steps = np.ceil(np.log(np.maximum(needed, _FEWEST_NODES) / _FEWEST_NODES) / np.log(_LATTICE_STEP))
    return finer_lattice(np.full(rates.shape, _FEWEST_NODES), steps)


def finer_lattice(sizes: Ints, steps: Floats | int = 1) -> Ints:
    """Lattices with more nodes along both sides, by so many steps."""
    finer: Ints = np.minimum(np.round(sizes * _LATTICE_STEP**steps), _MOST_NODES).astype(int)
    return finer


def surface_nodes(scenes: Scenes, chosen: Ints, level: Ints, meshes: Mapping[Shape, UnitMesh]) -> Nodes:
    """Place, area times reflectance, normal, lift and convex solid of the points of hidden surfaces (M, 9).

    Points that face no lit part of the wall are left out.
    """
    level_of = dict(zip(chosen.tolist(), level.tolist(), strict=True))
    groups: dict[tuple[Shape, int, tuple[int, int, int]], list[int]] = {}
    for place, placed in enumerate(scenes.objects):
        if placed.scene in level_of:
            kind = placed.shape, level_of[placed.scene], longer_sides(placed.shape, placed.size)
            groups.setdefault(kind, []).append(place)
    facing = _corners_of_walls(scenes)
    found = [
        _placed_points(surface_points(shape, one, meshes[shape], longer), scenes, np.array(places), facing)
        for (shape, one, longer), places in groups.items()
    ]
    place, values = (np.concatenate(each) for each in zip(*found, strict=True))
    order = np.argsort(place, kind="stable")  # object by object, in any batch
    scene = np.array([placed.scene for placed in scenes.objects])[place[order]]
    return Nodes.of(len(scenes.scenes), scene, values[order])


def on_wall(corners: Corners, nodes: Floats) -> Floats:
    """(N, M, 3) where rays through film places (N, M, 2) meet the walls' planes."""
    rays = np.concatenate([nodes, np.ones((*nodes.shape[:2], 1))], axis=-1)
    reach = (rays * corners.plane[:, None]).sum(-1, keepdims=True)
    at: Floats = rays / np.maximum(reach, _LEAST_REACH * np.abs(reach).max(1, keepdims=True))
    return at


def _corners_of_walls(scenes: Scenes) -> Floats:
    """(N, 4, 3) corners of the wall's part that the image shows: of points that face none, no light comes."""
    box = scenes.box
    nodes = np.stack([box[:, [0, 1, 0, 1]], box[:, [2, 2, 3, 3]]], axis=-1)
    return on_wall(scenes.corners, nodes)


def _placed_points(points: UnitPoints, scenes: Scenes, places: Ints, walls: Floats) -> tuple[Ints, Floats]:
    """Object (M,) and rows (M, 9) of `surface_nodes` of n of the objects, all of one shape."""
    some = [scenes.objects[place] for place in places]
    axes, size = np.stack([each.axes for each in some]), np.stack([each.size for each in some])
    centre, number = np.stack([each.centre for each in some]), np.array([each.scene for each in some])
    at = rotated(axes, points.points * size[:, None]) + centre[:, None]
    normal = points.normals / size[:, None]  # (n, S, 3)
    length = np.linalg.norm(normal, axis=-1)
    area = points.areas * size.prod(1)[:, None] * length  # (n, S)
    normal = rotated(axes, normal / length[..., None])
    others = [[each for each in scenes.objects_of(one.scene) if each is not one] for one in some]
    free, at = free_parts(at, normal, area, others)
    reflected = free * area * np.array([each.reflectance for each in some])[:, None]
    own = places if is_convex(some[0].shape) else np.full(len(some), _NO_SOLID)
    of_object = np.stack([_LIFT * size.max(1), own], axis=-1)[:, None]  # (n, 1, 2)
    rows = [at, reflected[..., None], normal, np.broadcast_to(of_object, (*area.shape, 2))]
    table = np.concatenate(rows, axis=-1)
    kept = _faces(table, walls[number]) & (free > 0)
    return np.repeat(places, kept.sum(1)), table[kept]


def _faces(rows: Floats, wall: Floats) -> NDArray[np.bool_]:
    """(..., M) which points (..., M, 9) face a corner (..., 4, 3) of the wall's part that the image shows."""
    normal = rows[..., 4:7]
    towards = normal @ np.swapaxes(wall, -1, -2) - (rows[..., :3] * normal).sum(-1)[..., None]
    return np.asarray((towards > 0).any(-1))
