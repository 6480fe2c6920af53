"""The hidden light of many scenes over their direct light, with an error that is asked for and kept.

A point w of the wall in direction r gets the flux Φ of its part of the projector's film and sends irradiance
to a point s of a hidden surface with the area A and the reflectance R. It lights every wall point x of the
image:

    E_f(s) = sum_w Φ_w f(r_w, s - w) cos_w cos_s / |s - w|² exp(j k_f (t_w + |s - w|))
    hidden_f(x) = sum_s R A_s / π E_f(s) f(s - x, r_x) cos_x cos_s / |s - x|² exp(j k_f (|s - x| + t_x))

over the direct light f(r_x, r_x) cos_x Φ / t_x², with visibility as 0 or 1. The ratio is computed at the
nodes of a Chebyshev lattice over the part of the image that shows the relay wall; polynomials carry it to the
pixels.

Two sets of nodes give the error. The sums are compared, at a dozen nodes, with sums over half the surface
points and twice the film points. The last third of the polynomials tells what the lattice lacks. Both are
errors of the light, not of the ratio: they count with the direct light of their pixels. A scene whose error
is too large gets more of the nodes that it lacks.

Source: the estimator of docs/science/renderer.md, with fixed nodes in place of random ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.batch.chebyshev import chebyshev, interpolation
from render.batch.quadrature import (
    FILM,
    Ints,
    Nodes,
    few_places,
    film_nodes,
    finer_lattice,
    lattice_nodes,
    lattice_sizes,
    surface_nodes,
)
from render.batch.quadrics import is_convex
from render.batch.tables import Scenes
from scenegen.scene import Scene
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

Floats = NDArray[np.float64]
Ratios = NDArray[np.complex128]
_COARSER: Final = 0.8  # error of the sums over their difference to those of the other nodes
_TAIL: Final = 0.5  # error of the lattice over the norm of the last third of its polynomials
_LEAST: Final = 0.5  # of the wanted error: what the estimate is at least, so that the bound holds in 95 %
_FIRST_ERROR: Final = 0.04  # for which the points begin with these levels:
_CONVEX, _SHEET_OR_MESH, _SEVERAL = 1, 2, 2
_FINEST: Final = 8  # level of the surface points
_MOST_PASSES: Final = 8
_TINY: Final = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class _Effort:
    """Levels of surface and film points (n,), and sizes of the lattices (n, 2), of some scenes."""

    surface: Ints
    film: Ints
    lattice: Ints

    @classmethod
    def first(cls, scenes: Scenes, error: float) -> _Effort:
        """Where the search for an error begins."""
        steps = int(np.ceil(np.log2(max(_FIRST_ERROR / error, 1e-3))))
        surface = np.array([first_level(scene) for scene in scenes.scenes]) + steps
        film = np.full(len(surface), 1 + -(-steps // 2))
        film = np.clip(film, 0, len(FILM) - 2)
        return cls(np.clip(surface, 1, _FINEST), film, lattice_sizes(scenes, error))

    def some(self, chosen: Ints) -> _Effort:
        """The effort for some of the scenes."""
        return _Effort(self.surface[chosen], self.film[chosen], self.lattice[chosen])

    def more(self, chosen: Ints, points: NDArray[np.bool_], lattice: NDArray[np.bool_]) -> None:
        """More nodes for some of the scenes."""
        self.surface[chosen] = np.minimum(self.surface[chosen] + points, _FINEST)
        self.film[chosen] = np.minimum(self.film[chosen] + points, len(FILM) - 2)
        self.lattice[chosen] = finer_lattice(self.lattice[chosen], lattice[:, None].astype(float))


@dataclass(frozen=True)
class HiddenRatios:
    """Computes hidden over direct light.

    Attributes
    ----------
    meshes : unit meshes of all shapes.
    width, height : of the images, pixels.
    error : wanted error of the hidden light, relative to it.
    """

    meshes: Mapping[Shape, UnitMesh]
    width: int
    height: int
    error: float

    def of(self, scenes: Scenes) -> tuple[NDArray[np.complex64], Floats]:
        """(N, H, W, F) hidden over direct light, and the error (N,), which may be above the wanted one.

        Both are 0 of an empty corner.
        """
        count = len(scenes.scenes)
        shape = (count, self.height, self.width, len(scenes.batch.phase_per_metre))
        over_direct = np.zeros(shape, np.complex64)
        error = np.zeros(count)
        left = np.array([n for n, scene in enumerate(scenes.scenes) if scene.hidden_objects], int)
        if not len(left):
            return over_direct, error
        effort = _Effort.first(scenes, self.error)
        for _ in range(_MOST_PASSES):
            tried = effort.some(left)
            values, of_points, of_lattice = self._evaluated(scenes, left, tried)
            error[left] = np.hypot(np.hypot(of_points, of_lattice), _LEAST * self.error)
            self._interpolate(scenes, left, tried.lattice, values, over_direct)
            short = ~(error[left] <= self.error)  # also where it is no number
            effort.more(left[short], *_lacking(of_points[short], of_lattice[short]))
            again = effort.some(left)
            more = (again.surface > tried.surface) | (again.lattice > tried.lattice).any(1)
            left = left[short & more]
            if not len(left):
                break
        return over_direct, error

    def _evaluated(
        self, scenes: Scenes, chosen: Ints, effort: _Effort
    ) -> tuple[list[Ratios], Floats, Floats]:
        """Ratios (nodes, F) at the lattices of the chosen scenes; their errors by points and by lattice."""
        levels = ((effort.surface, effort.film), (effort.surface - 1, effort.film + 1))
        found: list[list[Ratios]] = []
        lights: list[list[Floats]] = []  # direct light at these nodes
        for (surface, film), few in zip(levels, (False, True), strict=True):
            seen = lattice_nodes(scenes, chosen, effort.lattice, few)
            z, direct_light = ratios(scenes, chosen, surface, film, seen, self.meshes)
            parts = [slice(seen.first[one], seen.last[one]) for one in chosen]
            found.append([z[part] for part in parts])
            lights.append([direct_light[part, None] for part in parts])
        fine, other = found
        of_points = np.zeros(len(chosen))
        for place, (across, down) in enumerate(effort.lattice.tolist()):
            there, two = fine[place][few_places(across, down)], other[place]
            difference, *sizes = (_norm(each * lights[1][place]) for each in (there - two, there, two))
            of_points[place] = _COARSER * difference / max(*sizes, _TINY)
        return fine, of_points, _TAIL * _tails(fine, lights[0], effort.lattice)

    def _interpolate(
        self, scenes: Scenes, chosen: Ints, sizes: Ints, values: Sequence[Ratios], out: NDArray[np.complex64]
    ) -> None:
        """Put the ratios at the pixel centres into `out` (N, H, W, F)."""
        for across, down in np.unique(sizes, axis=0):
            places = np.flatnonzero((sizes == (across, down)).all(1))
            some = chosen[places]
            box, corners = scenes.box[some], scenes.corners.some(some)
            x, y = corners.pixel_centres(self.width, self.height)
            middle, half = box[:, ::2] + box[:, 1::2], box[:, 1::2] - box[:, ::2]
            columns = interpolation(across, (2 * x - middle[:, :1]) / half[:, :1])  # (n, W, across)
            rows = interpolation(down, (2 * y - middle[:, 1:]) / half[:, 1:])  # (n, H, down)
            nodes = np.stack([values[place] for place in places]).reshape(len(some), down, -1)
            nodes = np.matmul(rows, nodes).reshape(len(some), self.height, across, -1)
            out[some] = np.matmul(columns[:, None], nodes)


def ratios(
    scenes: Scenes,
    chosen: Ints,
    surface_level: Ints,
    film_level: Ints,
    seen: Nodes,
    meshes: Mapping[Shape, UnitMesh],
) -> tuple[Ratios, Floats]:
    """(M, F) hidden over direct light at the nodes `seen`, and (M,) direct light over the projector's.

    Scenes that are not `chosen` have no hidden light.
    """
    import drjit as dr
    import mitsuba as mi

    from render.batch.kernels import hidden as kernels
    from render.transport.kernels.arrays import upload, upload_indices, upload_points

    film = film_nodes(scenes, chosen, film_level)
    surface = surface_nodes(scenes, chosen, surface_level, meshes)
    batch = scenes.batch
    lit, back = (
        kernels.wall_records(batch, upload_indices(nodes.scene), upload_points(nodes.values[:, :3]))
        for nodes in (film, seen)
    )
    table, own = upload(surface.values[:, :8]), upload_indices(surface.values[:, 8].astype(np.int64))
    scene = upload_indices(surface.scene)
    flux = upload(film.values[:, 3])
    dr.eval(lit, back)
    index = dr.arange(mi.UInt32, len(surface.scene))
    ends = [dr.gather(mi.UInt32, upload_indices(each), scene) for each in (film.first, film.last)]
    real, imaginary = kernels.irradiance(batch, scene, table, own, index, lit, flux, *ends)
    sent = kernels.sent(real, imaginary, dr.gather(mi.Float, table, index * 8 + 3))
    dr.eval(sent)
    scene = upload_indices(seen.scene)
    ends = [dr.gather(mi.UInt32, upload_indices(each), scene) for each in (surface.first, surface.last)]
    index = dr.arange(mi.UInt32, len(seen.scene))
    real, imaginary, direct_light = kernels.over_direct(batch, scene, back, index, table, own, sent, *ends)
    dr.eval(real, imaginary, direct_light)
    sums = [np.array(re) + 1j * np.array(im) for re, im in zip(real, imaginary, strict=True)]
    return np.stack(sums, axis=-1), np.array(direct_light)


def direct(scenes: Scenes, seen: Nodes) -> Floats:
    """(M,) direct light at the nodes `seen`, relative to that of the projector."""
    import drjit as dr
    import mitsuba as mi

    from render.batch.kernels import hidden as kernels
    from render.transport.kernels.arrays import upload_indices, upload_points

    scene = upload_indices(seen.scene)
    back = kernels.wall_records(scenes.batch, scene, upload_points(seen.values[:, :3]))
    dr.eval(back)
    return np.array(kernels.direct(scenes.batch, scene, back, dr.arange(mi.UInt32, len(seen.scene))))


def first_level(scene: Scene) -> int:
    """Level of the surface points with which a scene begins."""
    shapes = [part.shape for part in scene.hidden_objects]
    if len(shapes) > 1:
        return _SEVERAL
    return _CONVEX if all(map(is_convex, shapes)) else _SHEET_OR_MESH


def _lacking(of_points: Floats, of_lattice: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which scenes lack points, and which lack nodes of the lattice: those whose error counts."""
    return of_points > 0.5 * of_lattice, of_lattice > 0.5 * of_points


def _norm(values: Ratios) -> float:
    return float(np.linalg.norm(values))


def _tails(values: Sequence[Ratios], lights: Sequence[Floats], sizes: Ints) -> Floats:
    """(n,) norm of the last third of the polynomials along each side of lattices, over that of all.

    It is that of the light in the pixels: the ratios at the nodes count with the direct light there, which is
    `lights`, and with the pixels for which a node stands.
    """
    found = np.zeros(len(values))
    for across, down in np.unique(sizes, axis=0):
        places = np.flatnonzero((sizes == (across, down)).all(1))
        grid = np.stack([values[place] for place in places]).reshape(len(places), down, across, -1)
        weight = np.stack([lights[place] for place in places]).reshape(len(places), down, across, 1)
        weight = weight * np.outer(_root_pixels(int(down)), _root_pixels(int(across)))[..., None]
        of_rows = np.matmul(_last_third(int(down)), grid.reshape(len(places), down, -1)).reshape(grid.shape)
        of_columns = np.matmul(_last_third(int(across)), grid)
        end = _power(weight * of_rows) + _power(weight * of_columns)
        found[places] = np.sqrt(end / np.maximum(_power(weight * grid), _TINY))
    return found


def _power(grid: Ratios) -> Floats:
    """(n,) sums of squares."""
    power: Floats = (np.abs(grid) ** 2).sum((1, 2, 3))
    return power


@cache
def _root_pixels(count: int) -> Floats:
    """(count,) root of the number of pixels for which each Chebyshev node stands, but for a factor."""
    roots: Floats = np.sqrt(np.sin(np.arccos(chebyshev(count)[0])))
    return roots


@cache
def _last_third(count: int) -> Floats:
    """(count, count) matrix from values at Chebyshev nodes to those of the polynomial's last third."""
    last = _to_coefficients(count)[-(count // 3) :]
    matrix: Floats = last.T @ last
    return matrix


@cache
def _to_coefficients(count: int) -> Floats:
    """(count, count) orthonormal matrix from values at Chebyshev nodes to coefficients."""
    angle = np.arccos(chebyshev(count)[0])
    matrix = np.cos(np.arange(count)[:, None] * angle) * np.sqrt(2 / count)
    matrix[0] /= np.sqrt(2)
    return matrix
