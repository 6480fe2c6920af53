"""The hidden signal of every pixel: at the nodes of a lattice, and between them by interpolation.

At each node, the sum over all lights is divided by that of one light in their middle that nothing occludes
(the carrier). The ratio varies slowly over the relay wall. Pixels that cannot be interpolated are computed
exactly: those that see an edge or another surface, and those next to a node that does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from render.transport.film.lattice import Lattice, filled
from render.transport.film.pixels import Grid, PixelRule, group_sums
from render.transport.lights.hidden_surface import sobol_points
from render.transport.lights.light_pass import Lights
from render.transport.lights.run_statistics import common_part, relative_bound
from render.transport.passes.direct_pass import DirectImage, seen_surfaces
from render.transport.passes.gather_pass import gather_carrier, gather_lights, gather_runs

if TYPE_CHECKING:
    import mitsuba as mi

_COARSEST = 10  # cells in the width of the film
_CHECKS = 128  # points between the nodes, at which the interpolation is checked
_SHARE = 0.25  # of the wanted error, for the interpolation
_EDGE_POINTS = 4  # for each surface in a pixel that sees several
_CURVE_BITS = 9  # of each coordinate of a space-filling curve through such a pixel: its smallest cells


@dataclass(frozen=True)
class HiddenField:
    """The hidden signal over the film, by a set of lights.

    Attributes
    ----------
    lattice : None if every point is computed exactly.
    over_carrier : (N, F) hidden signal over carrier at the nodes, mean over the runs of lights.
    valid : (N,) nodes that see `surface`.
    surface : number of the surface behind most of the nodes.
    error : bound of the error relative to the hidden signal, the largest of all frequencies.
    """

    scene: mi.Scene
    lights: Lights
    frequencies_hz: tuple[float, ...]
    lattice: Lattice | None
    over_carrier: NDArray[np.complex128]
    valid: NDArray[np.bool_]
    surface: int
    error: float

    def image(self, grid: Grid, rule: PixelRule, direct: DirectImage) -> NDArray[np.complex128]:
        """(H, W, F) phasors, mean radiance of each pixel in W m^-2 sr^-1.

        Parameters
        ----------
        rule : nodes in a pixel that sees one surface.
        direct : direct return of the same image; it knows which surface each pixel sees.
        """
        z = np.zeros((grid.height * grid.width, len(self.frequencies_hz)), complex)
        surface = direct.surface.ravel()
        smooth = self._interpolated(grid, rule, surface, z)
        exact = np.flatnonzero((surface > 0) & ~smooth)
        values = self._exact(grid.points(exact, rule.pixel_nodes).reshape(-1, 2))
        z[exact] = np.einsum(
            "pnf,n->pf", values.reshape(len(exact), rule.count, z.shape[-1]), rule.pixel_weights
        )
        chosen = choose_points(direct)
        values, carrier = self._exact(chosen.points), self._carrier(chosen.points)
        parts = chosen.sums(values * chosen.weights[:, None]), chosen.sums(carrier * chosen.weights[:, None])
        points, weights = direct.edges.points[chosen.seen], direct.edges.weights[chosen.seen]
        whole = chosen.totals(self._carrier(points) * weights[:, None])
        scale = np.divide(whole, parts[1], out=np.ones_like(whole), where=parts[1] != 0)
        z += group_sums(parts[0] * scale, chosen.pixels, len(z))
        return z.reshape(grid.height, grid.width, -1)

    def _interpolated(
        self, grid: Grid, rule: PixelRule, surface: NDArray[np.int64], z: NDArray[np.complex128]
    ) -> NDArray[np.bool_]:
        """Fill in the pixels that can be interpolated; (pixels,) which these are."""
        if self.lattice is None:
            return np.zeros(len(surface), bool)
        smooth = interpolable(self.lattice, self.valid, grid, rule, surface == self.surface)
        points = grid.points(np.flatnonzero(smooth), rule.pixel_nodes)  # (pixels, n, 2)
        carrier = self._carrier(points.reshape(-1, 2))
        x, y = (
            ((np.arange(size)[:, None] + rule.nodes) / size).ravel() for size in (grid.width, grid.height)
        )
        ratio = self.lattice.interpolated_grid(self.over_carrier, x, y)  # (H n, W n, F)
        n = len(rule.nodes)
        ratio = ratio.reshape(grid.height, n, grid.width, n, -1).transpose(0, 2, 1, 3, 4)
        ratio = ratio.reshape(len(surface), rule.count, z.shape[-1])[smooth]
        values = carrier.reshape(ratio.shape) * ratio
        z[smooth] = np.einsum("pnf,n->pf", values, rule.pixel_weights)
        return smooth

    def _exact(self, points: NDArray[np.float64]) -> NDArray[np.complex128]:
        return gather_lights(self.scene, points, self.frequencies_hz, self.lights)

    def _carrier(self, points: NDArray[np.float64]) -> NDArray[np.complex128]:
        return gather_carrier(self.scene, points, self.frequencies_hz, self.lights.centre)


@dataclass(frozen=True)
class ChosenPoints:
    """A few points for every surface in every pixel with an edge: G such groups, C points.

    Attributes
    ----------
    points, weights : (C, 2) film positions, (C,) share of the pixel.
    group : (C,) group of each point.
    pixels : (G,) row-major index of the pixel of each group.
    seen : (M,) those of the points of `EdgePixels` that see a surface.
    seen_groups : (M,) group of each of them.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    group: NDArray[np.int64]
    pixels: NDArray[np.int64]
    seen: NDArray[np.int64]
    seen_groups: NDArray[np.int64]

    def sums(self, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(G, F) sum over the chosen points (C, F) of each group."""
        return group_sums(values, self.group, len(self.pixels))

    def totals(self, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(G, F) sum over all points (M, F) of each group."""
        return group_sums(values, self.seen_groups, len(self.pixels))


@dataclass(frozen=True)
class RunValues:
    """The hidden signal at P points of the film, by each of R runs of lights.

    Attributes
    ----------
    points : (P, 2) film positions.
    values : (R, P, F) phasors.
    """

    points: NDArray[np.float64]
    values: NDArray[np.complex128]

    @property
    def error(self) -> float:
        """Bound of the random error of the mean of all runs, the largest of all frequencies."""
        return float(relative_bound(self.values).max())


def first_lattice(aspect: float) -> Lattice:
    """The coarsest lattice, for a film of this width over height."""
    return Lattice(_COARSEST, max(3, round(_COARSEST / aspect)))


def choose_points(direct: DirectImage) -> ChosenPoints:
    """Points that are spread over what each surface fills of each pixel with an edge, of equal weights."""
    edges, surface = direct.edges, direct.edge_samples.surface.astype(np.int64)
    seen = np.flatnonzero(surface > 0)
    # A sort of all points would take longer than the rest of a small image.
    surfaces = np.flatnonzero(np.bincount(surface[seen]))  # a few numbers
    number_of = np.zeros(direct.surface.size, np.int64)
    number_of[edges.pixels] = np.arange(len(edges.pixels))
    key = number_of[edges.pixel[seen]] * len(surfaces) + np.searchsorted(surfaces, surface[seen])
    is_group = np.bincount(key) > 0
    groups, group = np.flatnonzero(is_group), (np.cumsum(is_group) - 1)[key]
    place = (edges.points[seen] * direct.surface.shape[::-1] % 1 * 2**_CURVE_BITS).astype(int)
    bits = [(bit, axis) for bit in range(_CURVE_BITS) for axis in (0, 1)]
    along = sum(((place[:, axis] >> bit) & 1) << (2 * bit + axis) for bit, axis in bits)
    order = np.lexsort((along, group))
    reached = np.concatenate([[0.0], np.cumsum(edges.weights[seen[order]])])
    ends = np.searchsorted(group[order], np.arange(len(groups) + 1))
    total = reached[ends[1:]] - reached[ends[:-1]]
    steps = (np.arange(_EDGE_POINTS) + 0.5) / _EDGE_POINTS
    chosen = np.searchsorted(reached, reached[ends[:-1], None] + steps * total[:, None], side="right") - 1
    kept = seen[order[chosen.ravel()]]
    number = np.repeat(np.arange(len(groups)), _EDGE_POINTS)
    weights = np.repeat(total / _EDGE_POINTS, _EDGE_POINTS)
    pixels = edges.pixels[groups // max(1, len(surfaces))]
    return ChosenPoints(edges.points[kept], weights, number, pixels, seen, group)


def make_field(
    scene: mi.Scene,
    lights: Lights,
    frequencies_hz: tuple[float, ...],
    runs: RunValues,
    *,
    aspect: float,
    most_nodes: int,
    wanted: float | None,
) -> HiddenField:
    """The hidden signal by a set of lights, on a lattice that is as fine as the wanted error needs.

    The step of the lattice is halved until the interpolation at points between the nodes has at most a
    quarter of the wanted error. If a lattice would have more than `most_nodes` nodes, every pixel is computed
    exactly.

    Parameters
    ----------
    runs : the hidden signal at the nodes of `first_lattice`, by the same lights.
    aspect : width of the film over its height.
    most_nodes : number of points that an exact image takes.
    wanted : error relative to the hidden signal; None takes the random error of the lights.
    """
    random, nothing = runs.error, np.zeros(0, complex)
    everywhere = HiddenField(scene, lights, frequencies_hz, None, nothing, nothing.astype(bool), 0, random)
    lattice = first_lattice(aspect)
    if not len(lights) or len(lattice.nodes) >= most_nodes:
        return everywhere
    allowed = _SHARE * (random if wanted is None else wanted)
    checks = sobol_points(2, _CHECKS, 0)
    seen = seen_surfaces(scene, checks).astype(np.int64)
    exact = gather_runs(scene, checks, frequencies_hz, lights)
    carrier = gather_carrier(scene, checks, frequencies_hz, lights.centre)
    values = runs.values
    while True:
        ratio, valid, surface = _over_carrier(scene, lattice, values, frequencies_hz, lights)  # (R, N, F)
        inside = lattice.covers(checks, valid) & (seen == surface)
        between = np.stack([lattice.interpolated(one, checks[inside]) for one in ratio]) * carrier[inside]
        missed = common_part(between - exact[:, inside], np.linalg.norm(exact.mean(axis=0), axis=0))
        if inside.any() and np.all(missed <= allowed):
            error = float(np.hypot(random, missed).max())
            mean = ratio.mean(axis=0)
            return HiddenField(scene, lights, frequencies_hz, lattice, mean, valid, surface, error)
        lattice = lattice.halved()
        if len(lattice.nodes) >= most_nodes:
            return everywhere
        old, known = values, lattice.is_old()
        values = np.empty((lights.runs, len(known), len(frequencies_hz)), complex)
        values[:, known] = old
        values[:, ~known] = gather_runs(scene, lattice.nodes[~known], frequencies_hz, lights)


def interpolable(
    lattice: Lattice, valid: NDArray[np.bool_], grid: Grid, rule: PixelRule, wanted: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(pixels,) which of the `wanted` pixels have valid nodes around all points of their rule.

    Parameters
    ----------
    valid : (N,) nodes of the lattice.
    """
    points = grid.points(np.arange(len(wanted)), rule.pixel_nodes)
    covered = lattice.covers(points.reshape(-1, 2), valid).reshape(len(wanted), -1).all(axis=1)
    return covered & wanted


def _over_carrier(
    scene: mi.Scene,
    lattice: Lattice,
    values: NDArray[np.complex128],
    frequencies_hz: tuple[float, ...],
    lights: Lights,
) -> tuple[NDArray[np.complex128], NDArray[np.bool_], int]:
    """Ratio (R, N, F) of the hidden signal to the carrier, which nodes (N,) are valid, and their surface."""
    carrier = gather_carrier(scene, lattice.nodes, frequencies_hz, lights.centre)
    seen = seen_surfaces(scene, lattice.nodes).astype(np.int64)
    numbers, counts = np.unique(seen[seen > 0], return_counts=True)
    surface = int(numbers[counts.argmax()]) if len(numbers) else 0
    valid = (seen == surface) & (seen > 0) & (carrier != 0).all(axis=1)
    ratio = np.divide(values, carrier, out=np.zeros_like(values), where=valid[:, None])
    if not valid.all():
        shape, mask = (*lattice.shape, -1), valid.reshape(lattice.shape)
        ratio = np.stack([filled(one.reshape(shape), mask).reshape(one.shape) for one in ratio])
    return ratio, valid, surface
