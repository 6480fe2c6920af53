"""The direct return of every pixel, and which surface each pixel sees.

Most pixels see one surface and are integrated with a Gauss rule. Pixels that an edge crosses are divided into
cells (`render.transport.film.edge_pixels`). Phasors and transients use the same cells.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from math import factorial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from itof import phase_per_metre
from render.transport.film.edge_pixels import EdgePixels, divide_pixels
from render.transport.film.pixels import LANES, Grid, PixelRule, gauss_rule, group_sums

if TYPE_CHECKING:
    import mitsuba as mi

# How much the direct return may vary over the width of an image: its optical path length, and the logarithm
# of its radiance. Both are several times what the paper's scenes have.
_STEEPEST_M, _STEEPEST = 12.0, 3.0
_RULE_ERROR = 1e-8  # of the direct return, which is 200 to 5000 times the hidden signal
_MOST_NODES = 16  # in x and in y
# How far the direct return may change with twice the nodes: 0.5 % of the faintest hidden signal. On walls of
# 40 m, half of it is rounding.
_BRIGHTNESS_ERROR, _CHECKED_PIXELS = 1e-6, 1024

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DirectSamples:
    """The direct return at N points of the film.

    Attributes
    ----------
    radiance : (N,) W m^-2 sr^-1.
    opl_m : (N,) optical path length, metres; 0 where nothing returns.
    surface : (N,) number of the surface that is seen; 0 is none, or one that reflects nothing.
    """

    radiance: NDArray[np.float32]
    opl_m: NDArray[np.float32]
    surface: NDArray[np.uint32]

    def at(self, points: NDArray[np.int64]) -> DirectSamples:
        """The direct return at some of the points, by index."""
        return DirectSamples(self.radiance[points], self.opl_m[points], self.surface[points])


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
    """

    phasors: NDArray[np.complex128]
    surface: NDArray[np.int64]
    edges: EdgePixels
    edge_samples: DirectSamples


def gather_direct(
    scene: mi.Scene,
    grid: Grid,
    frequencies_hz: tuple[float, ...],
    seed: int,
    edge_divisions: int,
    all_is_direct: bool = False,
) -> DirectImage:
    """The direct return by Gauss nodes per pixel, and by cells in pixels with edges.

    Parameters
    ----------
    edge_divisions : how often cells with an edge are divided into four.
    all_is_direct : the direct return is the whole signal. Then edges within a surface have no more nodes than
        other places.
    """
    order = direct_order(grid.width, frequencies_hz)
    if not all_is_direct:
        order = _enough_nodes(scene, grid, order, seed)
    rule = gauss_rule(order)
    blocks = [_block(scene, grid, rows, rule, frequencies_hz, seed) for rows in grid.blocks(rule)]
    phasors = np.concatenate([block[0] for block in blocks])
    low, high = (np.concatenate([block[n] for block in blocks]) for n in (1, 2))
    # An edge in a pixel may lie between its nodes; then a neighbour sees another surface.
    mixed = minimum_filter(low, 3, mode="nearest") != maximum_filter(high, 3, mode="nearest")
    mixed |= _cut_outside(scene, grid, low)
    surface = np.where(mixed, -1, low)
    candidates = np.flatnonzero(mixed)
    edges = divide_pixels(grid, candidates, lambda points: seen_surfaces(scene, points), edge_divisions)
    surface.flat[edges.uniform] = low.flat[edges.uniform]
    samples = sample_direct(scene, edges.points, seed)
    lit = np.flatnonzero(samples.radiance)
    z = direct_phasors_of(samples.at(lit), frequencies_hz) * edges.weights[lit, None]
    flat = phasors.reshape(-1, len(frequencies_hz))
    flat[edges.pixels] = group_sums(z, edges.pixel[lit], len(flat))[edges.pixels]
    return DirectImage(phasors, surface, edges, samples)


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
    """Number of Gauss nodes in x and in y for pixels of an image of this width.

    The error of n nodes for exp(a x), over an interval in which a x changes by D, is at most
    D^2n (n!)^4 / ((2n + 1) (2n)!^3).
    """
    change = (max(phase_per_metre(frequencies_hz)) * _STEEPEST_M + _STEEPEST) / width
    return next(
        (
            n
            for n in range(2, _MOST_NODES)
            if change ** (2 * n) * factorial(n) ** 4 / ((2 * n + 1) * factorial(2 * n) ** 3) < _RULE_ERROR
        ),
        _MOST_NODES,
    )


def _enough_nodes(scene: mi.Scene, grid: Grid, order: int, seed: int) -> int:
    """`order`, doubled until the brightness of pixels no longer changes.

    `direct_order` assumes a brightness that varies slowly. The highlight of a smooth wall in wide pixels, or
    a texture, varies faster.
    """
    count = grid.width * grid.height
    pixels = np.arange(0, count, -(-count // _CHECKED_PIXELS))
    if -(-count // _CHECKED_PIXELS) % grid.width == 0:
        pixels = pixels + np.arange(len(pixels)) % grid.width  # not one column alone
    brightness = _brightness(scene, grid, pixels, order, seed)
    while order < _MOST_NODES:
        finer = min(2 * order, _MOST_NODES)
        better = _brightness(scene, grid, pixels, finer, seed)
        known = np.isfinite(brightness) & np.isfinite(better)
        change = np.linalg.norm((better - brightness)[known])
        if change <= _BRIGHTNESS_ERROR * np.linalg.norm(better[known]):
            break
        order, brightness = finer, better
    return order


def _brightness(
    scene: mi.Scene, grid: Grid, pixels: NDArray[np.int64], order: int, seed: int
) -> NDArray[np.float64]:
    """Mean radiance of the direct return in some pixels; NaN where the nodes see several surfaces."""
    rule = gauss_rule(order)
    samples = sample_direct(scene, grid.points(pixels, rule.pixel_nodes).reshape(-1, 2), seed)
    surface = samples.surface.reshape(len(pixels), -1)
    mean = samples.radiance.reshape(len(pixels), -1).astype(float) @ rule.pixel_weights
    return np.where((surface == surface[:, :1]).all(axis=1), mean, np.nan)


def direct_phasors_of(samples: DirectSamples, frequencies_hz: tuple[float, ...]) -> NDArray[np.complex128]:
    """(N, F) phasors of the direct return at points."""
    turns = phase_per_metre(frequencies_hz)
    return samples.radiance[:, None] * np.exp(1j * samples.opl_m.astype(float)[:, None] * turns)


def sample_direct(scene: mi.Scene, points: NDArray[np.float64], seed: int) -> DirectSamples:
    """The direct return at film positions (N, 2)."""
    import drjit as dr

    from render.transport.kernels import arrays, rays

    nothing = np.zeros(0, np.float32)
    parts = [(nothing, nothing, np.zeros(0, np.uint32))]
    for number, block in enumerate(_split(points)):
        x, y = (arrays.upload(column) for column in block.T)
        si = rays.camera_hits(scene, x, y)
        radiance, opl = rays.direct_return(scene, si, _random(len(block), seed, number))
        surface = rays.surface_codes(si)
        dr.eval(radiance, opl, surface)
        parts.append((np.array(radiance), np.array(opl), np.array(surface)))
    return DirectSamples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def direct_lanes(
    scene: mi.Scene, grid: Grid, rows: tuple[int, int], rule: PixelRule, seed: int
) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.Float, mi.UInt32]:
    """Radiance, OPL, pixel index, weight and surface of all nodes in some rows."""
    import drjit as dr

    from render.transport.kernels import rays

    x, y, pixel, weight = rays.pixel_samples(
        (grid.width, grid.height), rows, rule.pixel_nodes, rule.pixel_weights
    )
    si = rays.camera_hits(scene, x, y)
    radiance, opl = rays.direct_return(scene, si, _random(dr.width(x), seed, rows[0]))
    return radiance, opl, pixel, weight, rays.surface_codes(si)


def _block(
    scene: mi.Scene,
    grid: Grid,
    rows: tuple[int, int],
    rule: PixelRule,
    frequencies_hz: tuple[float, ...],
    seed: int,
) -> tuple[NDArray[np.complex128], NDArray[np.int64], NDArray[np.int64]]:
    """Phasors (rows, W, F) of some rows, and the smallest and largest surface number in each pixel."""
    import drjit as dr
    import mitsuba as mi

    radiance, opl, _, weight, surface = direct_lanes(scene, grid, rows, rule, seed)
    # float64, because the sum must be exact against a hidden signal of 3e-4 of it
    share, path = mi.Float64(radiance * weight), mi.Float64(opl)
    turned = [dr.sincos(dr.opaque(mi.Float64, float(k)) * path) for k in phase_per_metre(frequencies_hz)]
    sums = [dr.block_sum(share * part, rule.count) for pair in turned for part in pair]
    ends = [dr.block_reduce(op, surface, rule.count) for op in (dr.ReduceOp.Min, dr.ReduceOp.Max)]
    dr.eval(sums, ends)
    shape = (rows[1] - rows[0], grid.width)
    parts = [np.array(part).reshape(shape) for part in sums]
    z = np.stack(
        [real + 1j * imaginary for imaginary, real in zip(parts[::2], parts[1::2], strict=True)], axis=-1
    )
    low, high = (np.array(end).astype(np.int64).reshape(shape) for end in ends)
    return z, low, high


def seen_surfaces(scene: mi.Scene, points: NDArray[np.float64]) -> NDArray[np.uint32]:
    """(N,) number of the surface that is seen at film positions (N, 2).

    0 is none, or one that reflects nothing.
    """
    import drjit as dr

    from render.transport.kernels import arrays, rays

    parts = [np.zeros(0, np.uint32)]
    for block in _split(points):
        x, y = (arrays.upload(column) for column in block.T)
        surface = rays.surface_codes(rays.camera_hits(scene, x, y))
        dr.eval(surface)
        parts.append(np.array(surface))
    return np.concatenate(parts)


def _split(points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    if len(points):
        yield from np.array_split(points, -(-len(points) // LANES))


def _random(lanes: int, seed: int, number: int) -> mi.Point2f:
    """Random samples. Only emitters with an extent use them; a projector is a point."""
    import drjit as dr
    import mitsuba as mi

    stream = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    random = mi.PCG32(lanes, dr.opaque(mi.UInt64, stream))
    return mi.Point2f(random.next_float32(), random.next_float32())
