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
from render.transport.film.pixels import Grid, PixelRule, gauss_rule, group_sums
from render.transport.lights.hidden_surface import sobol_points
from render.transport.lights.light_pass import Lights
from render.transport.lights.run_statistics import common_part, relative_bound
from render.transport.passes.direct_pass import DirectImage
from render.transport.passes.direct_samples import seen_surfaces
from render.transport.passes.edge_points import choose_points
from render.transport.passes.gather_pass import gather_carrier, gather_lights, gather_runs

if TYPE_CHECKING:
    import mitsuba as mi

_COARSEST = 10  # cells in the width of the film
_CHECKS = 128  # points between the nodes, at which the interpolation is checked
_SHARE = 0.25  # of the wanted error, for the interpolation; more if the lights leave more
_LEFT = 0.99  # of the wanted error, for lights and interpolation; the rest is for nodes in pixels
_UNSURE = 4.0  # error over the change from linear to quadratic: shadows of few lights are no polynomials
_UNEVEN = 0.05  # of a pixel's light: nodes that differ less are enough
_MOST_EXACT = 16  # nodes in x and in y of a pixel that is not interpolated
_CHECKED_PIXELS, _MOST_NODES = 256, 8  # for the nodes of whole pixels


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

    def image(self, grid: Grid, rule: PixelRule, direct: DirectImage, allowed: float) -> HiddenImage:
        """The hidden signal of each pixel.

        Parameters
        ----------
        rule : nodes in a pixel that sees one surface.
        direct : direct return of the same image; it knows which surface each pixel sees.
        allowed : error by the nodes of pixels that are not interpolated, relative to the hidden signal.
        """
        z = np.zeros((grid.height * grid.width, len(self.frequencies_hz)), complex)
        surface = direct.surface.ravel()
        smooth = self._interpolated(grid, rule, surface, z)
        exact = np.flatnonzero((surface > 0) & ~smooth)
        if self.lattice is not None and rule.count == 1:
            rule = gauss_rule(2)  # one node knows nothing of a shadow beside it
        z[exact], uneven = self._means(grid, rule, exact)
        limit = allowed * np.linalg.norm(z, axis=0).max() / np.sqrt(max(1, len(exact)))
        changed = self._refine(grid, rule, exact[uneven > limit], limit, z)
        chosen = choose_points(direct)
        whole = self._carrier(chosen.seen_points)
        linear, quadratic = chosen.means(self._exact(chosen.points), self._carrier(chosen.points), whole)
        z += group_sums(quadratic, chosen.pixels, len(z))
        change = np.linalg.norm(group_sums(quadratic - linear, chosen.pixels, len(z)), axis=0)
        missed = np.hypot(_UNSURE * change, changed)
        return HiddenImage(z.reshape(grid.height, grid.width, -1), missed)

    def _means(
        self, grid: Grid, rule: PixelRule, pixels: NDArray[np.int64]
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """(P, F) means over pixels, and (P,) how far a node is from the carrier times a constant.

        Beside a gap, the shadow of the middle wall falls into pixels. How far is 0 if it is little.
        """
        points = grid.points(pixels, rule.pixel_nodes).reshape(-1, 2)
        shape = (len(pixels), rule.count, len(self.frequencies_hz))
        values, carrier = (each(points).reshape(shape) for each in (self._exact, self._carrier))
        mean, even = (np.einsum("pnf,n->pf", each, rule.pixel_weights) for each in (values, carrier))
        over_carrier = np.divide(mean, even, out=np.zeros_like(mean), where=even != 0)
        off = np.linalg.norm(values - over_carrier[:, None] * carrier, axis=-1).max(axis=-1, initial=0)
        return mean, np.where(off > _UNEVEN * np.linalg.norm(mean, axis=-1), off, 0)

    def _refine(
        self,
        grid: Grid,
        rule: PixelRule,
        pixels: NDArray[np.int64],
        limit: float,
        z: NDArray[np.complex128],
    ) -> NDArray[np.float64]:
        """Give pixels of `z` (all, F) twice the nodes until little changes; (F,) norm of the last changes."""
        left, order = np.zeros(z.shape[-1]), len(rule.nodes)
        while len(pixels):
            order = 2 * order
            finer, _ = self._means(grid, gauss_rule(order), pixels)
            change, z[pixels] = np.abs(finer - z[pixels]), finer
            short = (change.max(axis=-1) > limit) & (order < _MOST_EXACT)
            left += (change[~short] ** 2).sum(axis=0)
            pixels = pixels[short]
        return np.asarray(np.sqrt(left))

    def enough_nodes(
        self, grid: Grid, rule: PixelRule, direct: DirectImage, allowed: float
    ) -> tuple[PixelRule, float]:
        """`rule`, or one of more nodes, until one more changes the carrier by less than `allowed`.

        Also how much it still changes, relative to it.
        """
        whole = np.flatnonzero(direct.surface.ravel() > 0)
        if not len(whole):
            return rule, 0.0
        pixels = np.unique(whole[np.linspace(0, len(whole) - 1, _CHECKED_PIXELS).astype(int)])
        mean = self._carrier_means(grid, rule, pixels)
        while True:
            finer = gauss_rule(len(rule.nodes) + 1)
            better = self._carrier_means(grid, finer, pixels)
            norm = np.linalg.norm(better, axis=0)
            off = np.linalg.norm(better - mean, axis=0)
            change = float(np.divide(off, norm, out=np.zeros_like(off), where=norm > 0).max())
            if change <= allowed or len(finer.nodes) > _MOST_NODES:
                return rule, change
            rule, mean = finer, better

    def _carrier_means(
        self, grid: Grid, rule: PixelRule, pixels: NDArray[np.int64]
    ) -> NDArray[np.complex128]:
        carrier = self._carrier(grid.points(pixels, rule.pixel_nodes).reshape(-1, 2))
        means: NDArray[np.complex128] = np.einsum(
            "pnf,n->pf", carrier.reshape(len(pixels), rule.count, -1), rule.pixel_weights
        )
        return means

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
        over_carrier = self.lattice.interpolated_grid(self.over_carrier, x, y)  # (H n, W n, F)
        n = len(rule.nodes)
        over_carrier = over_carrier.reshape(grid.height, n, grid.width, n, -1).transpose(0, 2, 1, 3, 4)
        over_carrier = over_carrier.reshape(len(surface), rule.count, z.shape[-1])[smooth]
        values = carrier.reshape(over_carrier.shape) * over_carrier
        z[smooth] = np.einsum("pnf,n->pf", values, rule.pixel_weights)
        return smooth

    def _exact(self, points: NDArray[np.float64]) -> NDArray[np.complex128]:
        return gather_lights(self.scene, points, self.frequencies_hz, self.lights)

    def _carrier(self, points: NDArray[np.float64]) -> NDArray[np.complex128]:
        return gather_carrier(self.scene, points, self.frequencies_hz, self.lights.centre)


@dataclass(frozen=True)
class HiddenImage:
    """The hidden signal of each pixel.

    Attributes
    ----------
    phasors : (H, W, F) mean radiance of each pixel in W m^-2 sr^-1.
    missed : (F,) bound of the norm of their error in pixels with edges.
    """

    phasors: NDArray[np.complex128]
    missed: NDArray[np.float64]


@dataclass(frozen=True)
class RunValues:
    """The hidden signal at the P nodes of a lattice, by each of R runs of lights.

    Attributes
    ----------
    values : (R, P, F) phasors.
    """

    lattice: Lattice
    values: NDArray[np.complex128]

    @property
    def error(self) -> float:
        """Bound of the random error of the mean of all runs, the largest of all frequencies."""
        return float(relative_bound(self.values).max())


def first_lattice(aspect: float) -> Lattice:
    """The coarsest lattice, for a film of this width over height."""
    return Lattice(_COARSEST, max(3, round(_COARSEST / aspect)))


def make_field(
    scene: mi.Scene,
    lights: Lights,
    frequencies_hz: tuple[float, ...],
    runs: RunValues,
    *,
    most_nodes: int,
    wanted: float | None,
    settles: bool = False,
) -> HiddenField:
    """The hidden signal by a set of lights, on a lattice that is as fine as the wanted error needs.

    The step of the lattice is halved until the error of the interpolation at points between the nodes is at
    most a quarter of the wanted error, or half of what the lights leave of its square; all of it where the
    next lattice would have `most_nodes` nodes or more. Else every pixel is computed exactly.

    Parameters
    ----------
    runs : the hidden signal at the nodes of the coarsest lattice, by the same lights.
    most_nodes : number of points that an exact image takes.
    wanted : error relative to the hidden signal; None takes the random error of the lights.
    settles : whether the finest lattice is taken with what error it has, in place of an exact image.
    """
    random, nothing = runs.error, np.zeros(0, complex)
    everywhere = HiddenField(scene, lights, frequencies_hz, None, nothing, nothing.astype(bool), 0, random)
    lattice = runs.lattice
    if not len(lights) or len(lattice.nodes) >= most_nodes:
        return everywhere
    share = _SHARE * (random if wanted is None else wanted)
    left = np.sqrt(max(0, (_LEFT * (wanted or 0)) ** 2 - random**2))
    checks = sobol_points(2, _CHECKS, 0)
    seen = seen_surfaces(scene, checks).astype(np.int64)
    exact = gather_runs(scene, checks, frequencies_hz, lights)
    carrier = gather_carrier(scene, checks, frequencies_hz, lights.centre)
    values = runs.values
    while True:
        over_carrier, valid, surface = _over_carrier(scene, lattice, values, frequencies_hz, lights)
        inside = lattice.covers(checks, valid) & (seen == surface)
        table = over_carrier.transpose(1, 0, 2)  # (N, R, F)
        between = lattice.interpolated(table.reshape(len(table), -1), checks[inside])
        between = between.reshape(-1, *table.shape[1:]).transpose(1, 0, 2) * carrier[inside]
        missed = common_part(between - exact[:, inside], np.linalg.norm(exact.mean(axis=0), axis=0))
        finer = lattice.halved()
        is_last = len(finer.nodes) >= most_nodes
        is_enough = np.all(missed <= max(share, left if is_last else left / 2**0.5))
        if inside.any() and (is_enough or (settles and is_last)):
            error = float(np.hypot(random, missed).max())
            mean = over_carrier.mean(axis=0)
            return HiddenField(scene, lights, frequencies_hz, lattice, mean, valid, surface, error)
        if is_last:
            return everywhere
        lattice = finer
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
    over_carrier = np.divide(values, carrier, out=np.zeros_like(values), where=valid[:, None])
    if not valid.all():
        shape, mask = (*lattice.shape, -1), valid.reshape(lattice.shape)
        over_carrier = np.stack([filled(one.reshape(shape), mask).reshape(one.shape) for one in over_carrier])
    return over_carrier, valid, surface
