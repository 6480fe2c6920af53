"""The direct return of every pixel, and which surface each pixel sees.

Pixels have Gauss nodes, more where the light changes fast. Those that an edge of the two walls crosses have
them in their free part (`render.walls`). Pixels with other edges are divided into cells
(`render.transport.film.edge_pixels`). Phasors and transients use the same nodes there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from itof import phase_per_metre
from render.transport.film.edge_pixels import EdgePixels, divide_pixels
from render.transport.film.pixels import Grid, PixelRule, gauss_rule, group_sums
from render.transport.passes.direct_samples import (
    DirectSamples,
    direct_lanes,
    direct_phasors_of,
    sample_direct,
    seen_surfaces,
)
from render.transport.passes.lit_pixels import LitPixels, lit_pixels
from render.transport.passes.node_counts import MOST_NODES, PixelRange, needed_order, rule_error
from render.transport.passes.seen_walls import seen_walls
from render.walls.corners import Corners
from render.walls.pixel_lines import crossed_pixels, free_nodes

if TYPE_CHECKING:
    import mitsuba as mi

# How much the direct return may vary over the width of an image: its optical path length, and the logarithm
# of its radiance. Both are several times what the paper's scenes have.
_STEEPEST_M, _STEEPEST = 12.0, 3.0
_MOST_NODES = 16  # in x and in y, of all pixels
_CHECKED_PIXELS = 1024  # for the change with twice the nodes, of which about 1e-7 to 1e-6 is rounding
# Nodes of the direct return over time, in the width of the image, and their limits in a pixel: closer than
# time bins. Pixels with edges have them in phasors, too.
_BIN_NODES, _FEWEST_BIN_NODES, _MOST_BIN_NODES = 1280, 8, 32
_SLIVER = 1e-9  # of a pixel
_FLOAT32 = 1e-7  # of the film
FINEST_ERROR = 1e-6  # 0.5 % of the faintest hidden signal

NodesOf = Callable[
    [NDArray[np.int64], int], tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DirectImage:
    """The direct return of all pixels of an image.

    Attributes
    ----------
    phasors : (H, W, F) mean radiance of each pixel in W m^-2 sr^-1.
    surface : (H, W) number of the surface that a pixel sees; 0 is none, or one that reflects nothing; -1 in
        pixels of `edges`.
    edges : the pixels that see several surfaces, with their cells and the direct return there.
    edge_samples : the direct return at the points of `edges`.
    lit : the pixels that are lit in part; None of a flash at the camera, which lights all that it sees.
    missed : bound of the norm of the error of `phasors`, (F,): rounding, and what more nodes would change.
    order : nodes in x and in y that most pixels need.
    """

    phasors: NDArray[np.complex128]
    surface: NDArray[np.int64]
    edges: EdgePixels
    edge_samples: DirectSamples
    lit: LitPixels | None
    missed: NDArray[np.float64]
    order: int


def gather_direct(
    scene: mi.Scene,
    grid: Grid,
    frequencies_hz: tuple[float, ...],
    seed: int,
    edge_divisions: int,
    allowed: float | None = FINEST_ERROR,
) -> DirectImage:
    """The direct return by Gauss nodes, and by cells in pixels with edges that are none of the walls'.

    Parameters
    ----------
    edge_divisions : how often cells with an edge are divided into four.
    allowed : how far it may change with twice the nodes, relative to it. None: it is the whole signal; then
        edges within a surface have no more nodes than other places.
    """
    measure, changed = _Measure(scene, frequencies_hz, seed), np.zeros(len(frequencies_hz))
    order = direct_order(grid.width, frequencies_hz)
    if allowed is not None:
        order, changed = _enough_nodes(measure, grid, order, allowed)
    rule = gauss_rule(order)
    blocks = [_block(scene, grid, rows, rule, frequencies_hz, seed) for rows in grid.blocks(rule)]
    phasors, low, high, *ends = (np.concatenate(each) for each in zip(*blocks, strict=True))
    flat = phasors.reshape(-1, len(frequencies_hz))
    walls = seen_walls(scene) if len(np.union1d(np.union1d(low, high), [0])) <= 2 else None
    if walls is None:
        surface, edges = _divided(scene, grid, low, high, edge_divisions)
        samples, missed = sample_direct(scene, edges.points, seed), 0.0
    else:
        surface, cut = _cut_by_walls(walls, grid, low, high)
        found = measure.nodes(
            lambda pixels, n: free_nodes(walls, pixels, grid.width, grid.height, n),
            cut,
            max(order, bin_order(grid.width)),
        )
        edges = EdgePixels(cut, found.points, found.weights, found.pixel, np.zeros(0, np.int64))
        samples, missed = found.samples, float(np.hypot(found.missed, _rounding(found, grid.width)))
    z = measure.phasors(samples, edges.weights)
    flat[edges.pixels] = group_sums(z, edges.pixel, len(flat))[edges.pixels]
    lit = np.flatnonzero((surface.ravel() > 0) & (ends[3].ravel() > 0))
    change = PixelRange(*(each.ravel()[lit] for each in ends)).change(frequencies_hz, order)
    steep = lit[needed_order(change) > order]
    found = measure.nodes(lambda pixels, n: _pixel_nodes(grid, pixels, n), steep, 2 * order)
    flat[steep] = group_sums(measure.phasors(found.samples, found.weights), found.pixel, len(flat))[steep]
    lit_in_part = lit_pixels(scene, grid, seed, edge_divisions)
    if lit_in_part is not None:
        nodes = lit_in_part.nodes
        z = measure.phasors(lit_in_part.samples, nodes.weights)
        flat[nodes.pixels] = group_sums(z, nodes.pixel, len(flat))[nodes.pixels]
    all_missed = np.hypot(np.hypot(missed, found.missed), changed * np.linalg.norm(flat, axis=0))
    return DirectImage(phasors, surface, edges, samples, lit_in_part, all_missed, order)


@dataclass(frozen=True)
class _Nodes:
    """N nodes with their shares of pixels, in the order of the pixels; and the error that they leave."""

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    pixel: NDArray[np.int64]
    samples: DirectSamples
    missed: float


@dataclass(frozen=True)
class _Measure:
    """Measures the direct return of a scene at nodes."""

    scene: mi.Scene
    frequencies_hz: tuple[float, ...]
    seed: int

    def phasors(self, samples: DirectSamples, weights: NDArray[np.float64]) -> NDArray[np.complex128]:
        """(N, F) phasors times weights (N,)."""
        return direct_phasors_of(samples, self.frequencies_hz) * weights[:, None]

    def nodes(self, nodes_of: NodesOf, pixels: NDArray[np.int64], order: int) -> _Nodes:
        """Nodes of some pixels, at first of this order, and of twice as much where that is not enough."""
        found, missed = [], 0.0
        while True:
            order = min(order, MOST_NODES)
            points, weights, pixel = nodes_of(pixels, order)
            samples = sample_direct(self.scene, points, self.seed)
            seen, change = self._change(samples, pixel, order)
            short = needed_order(change) > order
            if order == MOST_NODES:
                power = np.bincount(pixel, samples.radiance * weights)[seen]
                missed = float(np.linalg.norm((rule_error(change) * power)[short]))
                short[:] = False
            kept = np.flatnonzero(~np.isin(pixel, seen[short]))
            found.append((points[kept], weights[kept], pixel[kept], samples.at(kept)))
            pixels, order = seen[short], 2 * order
            if not len(pixels):
                break
        points, weights, pixel = (np.concatenate([each[n] for each in found]) for n in range(3))
        return _Nodes(points, weights, pixel, DirectSamples.joined([each[3] for each in found]), missed)

    def _change(
        self, samples: DirectSamples, pixel: NDArray[np.int64], order: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The pixels with light, and how much it changes in each (`PixelRange.change`)."""
        lit = np.flatnonzero(samples.radiance)
        lit = lit[np.argsort(pixel[lit], kind="stable")]
        seen, first = np.unique(pixel[lit], return_index=True)
        if not len(seen):
            return seen, np.zeros(0)
        opl, radiance = (each[lit].astype(float) for each in (samples.opl_m, samples.radiance))
        ends = [end.reduceat(each, first) for each in (opl, radiance) for end in (np.minimum, np.maximum)]
        return seen, PixelRange(*ends).change(self.frequencies_hz, order)


def _rounding(edges: _Nodes, width: int) -> float:
    """Norm of the error of pixels with edges, of which walls and rays in float32 know the place."""
    brightest = np.zeros(1 + int(edges.pixel.max(initial=0)))
    np.maximum.at(brightest, edges.pixel, edges.samples.radiance)
    return float(_FLOAT32 * width * np.linalg.norm(brightest))


def bin_order(width: int) -> int:
    """Nodes in x and in y of the direct return over time, for pixels of an image of this width."""
    return min(max(_BIN_NODES // width, _FEWEST_BIN_NODES), _MOST_BIN_NODES)


def _pixel_nodes(
    grid: Grid, pixels: NDArray[np.int64], order: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Film positions, shares of the pixel and pixel of the nodes of whole pixels."""
    rule = gauss_rule(order)
    points = grid.points(pixels, rule.pixel_nodes).reshape(-1, 2)
    return points, np.tile(rule.pixel_weights, len(pixels)), np.repeat(pixels, rule.count)


def _cut_by_walls(
    walls: Corners, grid: Grid, low: NDArray[np.int64], high: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(H, W) surface of each pixel, -1 where an edge crosses it, and these pixels."""
    size = (grid.width, grid.height)
    crossed = crossed_pixels(walls, *size)
    _, weights, pixel = free_nodes(walls, crossed, *size, 1)
    share = np.bincount(pixel, weights, low.size)[crossed]
    surface = low.copy()
    surface.flat[crossed] = np.where(share < _SLIVER, 0, np.where(share > 1 - _SLIVER, high.max(), -1))
    return surface, np.flatnonzero(surface == -1)


def _divided(
    scene: mi.Scene, grid: Grid, low: NDArray[np.int64], high: NDArray[np.int64], divisions: int
) -> tuple[NDArray[np.int64], EdgePixels]:
    """(H, W) surface of each pixel, -1 where it sees several, and the cells of these pixels."""
    # An edge in a pixel may lie between its nodes; then a neighbour sees another surface.
    mixed = minimum_filter(low, 3, mode="nearest") != maximum_filter(high, 3, mode="nearest")
    mixed |= _cut_outside(scene, grid, low)
    surface = np.where(mixed, -1, low)
    candidates = np.flatnonzero(mixed)
    edges = divide_pixels(grid, candidates, lambda points: seen_surfaces(scene, points), divisions)
    surface.flat[edges.uniform] = low.flat[edges.uniform]
    return surface, edges


def _cut_outside(scene: mi.Scene, grid: Grid, surface: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(H, W) pixels at the border of the image with a corner that sees another surface.

    They have no neighbour there that would show an edge between their nodes and the border.
    """
    border = np.zeros(surface.shape, bool)
    border[[0, -1]] = border[:, [0, -1]] = True
    pixels = np.flatnonzero(border)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    seen = seen_surfaces(scene, grid.points(pixels, corners).reshape(-1, 2)).reshape(-1, 4)
    border.flat[pixels] = (seen != surface.flat[pixels][:, None]).any(axis=1)
    return border


def direct_order(width: int, frequencies_hz: tuple[float, ...]) -> int:
    """Number of Gauss nodes in x and in y for most pixels of an image of this width."""
    change = (max(phase_per_metre(frequencies_hz)) * _STEEPEST_M + _STEEPEST) / width
    return int(min(needed_order(np.array([change]))[0], _MOST_NODES))


def _enough_nodes(
    measure: _Measure, grid: Grid, order: int, allowed: float
) -> tuple[int, NDArray[np.float64]]:
    """`order`, doubled until the brightness of pixels no longer changes; (F,) how far phasors still do.

    `direct_order` assumes a brightness that varies slowly. The highlight of a smooth wall in wide pixels, or
    a texture, varies faster. Phasors count where pixels need no more nodes (`PixelRange`).
    """
    count = grid.width * grid.height
    pixels = np.arange(0, count, -(-count // _CHECKED_PIXELS))
    if -(-count // _CHECKED_PIXELS) % grid.width == 0:
        pixels = pixels + np.arange(len(pixels)) % grid.width  # not one column alone
    coarse = _means(measure, grid, pixels, order)
    while True:
        finer = min(2 * order, _MOST_NODES)
        fine = _means(measure, grid, pixels, finer)
        known = np.isfinite(coarse[0]) & np.isfinite(fine[0])
        enough = _change(coarse[0][known], fine[0][known]) <= allowed
        if enough or finer == _MOST_NODES:
            steady = known & coarse[2]
            return (order if enough else finer), _change(coarse[1][steady], fine[1][steady])
        order, coarse = finer, fine


def _means(
    measure: _Measure, grid: Grid, pixels: NDArray[np.int64], order: int
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.bool_]]:
    """Of some pixels: mean radiance (P,) and phasors (P, F), and (P,) whether the nodes are enough for them.

    The radiance is NaN where the nodes see several surfaces, or light and shadow.
    """
    rule = gauss_rule(order)
    samples = sample_direct(measure.scene, grid.points(pixels, rule.pixel_nodes).reshape(-1, 2), measure.seed)
    radiance, opl_m, surface = (
        each.reshape(len(pixels), -1) for each in (samples.radiance, samples.opl_m, samples.surface)
    )
    whole = (surface == surface[:, :1]).all(axis=1) & ((radiance > 0) == (radiance[:, :1] > 0)).all(axis=1)
    mean = np.where(whole, radiance.astype(float) @ rule.pixel_weights, np.nan)
    phasors = measure.phasors(samples, np.tile(rule.pixel_weights, len(pixels)))
    steady = (radiance > 0).all(axis=1)
    ends = (end(each, axis=1) for each in (opl_m[steady], radiance[steady]) for end in (np.min, np.max))
    change = PixelRange(*(each.astype(float) for each in ends)).change(measure.frequencies_hz, order)
    steady[steady] = needed_order(change) <= order
    return mean, phasors.reshape(len(pixels), rule.count, -1).sum(axis=1), steady


def _change(coarse: NDArray[Any], fine: NDArray[Any]) -> NDArray[np.float64]:
    """Norm of the change of values over pixels, relative to their own."""
    norm, off = np.linalg.norm(fine, axis=0), np.linalg.norm(fine - coarse, axis=0)
    change: NDArray[np.float64] = np.divide(off, norm, out=np.zeros_like(norm), where=norm > 0)
    return change


def _block(
    scene: mi.Scene,
    grid: Grid,
    rows: tuple[int, int],
    rule: PixelRule,
    frequencies_hz: tuple[float, ...],
    seed: int,
) -> tuple[NDArray[Any], ...]:
    """Phasors (rows, W, F), and the smallest and largest surface number, path and radiance of each pixel.

    Path and radiance are those of lit nodes; without one, the smallest is infinite and the largest 0.
    """
    import drjit as dr
    import mitsuba as mi

    radiance, opl, _, weight, surface = direct_lanes(scene, grid, rows, rule, seed)
    # float64, because the sum must be exact against a hidden signal of 3e-4 of it
    share, path = mi.Float64(radiance * weight), mi.Float64(opl)
    turned = [dr.sincos(dr.opaque(mi.Float64, float(k)) * path) for k in phase_per_metre(frequencies_hz)]
    sums = [dr.block_sum(share * part, rule.count) for pair in turned for part in pair]
    lit = radiance > 0
    ends = [
        dr.block_reduce(op, dr.select(lit, values, beyond), rule.count)
        for values in (opl, radiance)
        for op, beyond in ((dr.ReduceOp.Min, dr.inf), (dr.ReduceOp.Max, 0))
    ]
    seen = [dr.block_reduce(op, surface, rule.count) for op in (dr.ReduceOp.Min, dr.ReduceOp.Max)]
    dr.eval(sums, seen, ends)
    shape = (rows[1] - rows[0], grid.width)
    parts = [np.array(part).reshape(shape) for part in sums]
    z = np.stack(
        [real + 1j * imaginary for imaginary, real in zip(parts[::2], parts[1::2], strict=True)], axis=-1
    )
    surfaces = (np.array(end).astype(np.int64).reshape(shape) for end in seen)
    return z, *surfaces, *(np.array(end).astype(float).reshape(shape) for end in ends)
