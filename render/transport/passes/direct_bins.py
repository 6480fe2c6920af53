"""The direct return over time: in closed form where a pixel sees one smooth surface, else at many nodes.

A pixel is divided into equal cells with 2 x 2 Gauss nodes. In a cell, the path is taken as linear. The cell
then fills a trapezoid of the time axis evenly, around the mean path of its light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout
from render.transport.film.pixels import LANES, Grid, PixelRule, gauss_rule
from render.transport.passes.direct_pass import DirectImage, bin_order
from render.transport.passes.direct_samples import DirectSamples, direct_lanes, sample_direct

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

_CELLS, _FEWEST_CELLS = 240, 2  # in the width of the image, and in x and in y in a pixel
# What cells of a pixel may differ in: the light by this factor, the change of the path from side to side by so
# many bins. Others have an edge within the surface, or see it at a grazing angle.
_UNEVEN, _BENT_BINS = 1.5, 1.0
_NARROWEST_BINS = 1e-3  # a trapezoid is a difference over its two widths, in float64


@dataclass(frozen=True)
class Cells:
    """The cells of P pixels, n of each; the light fills a trapezoid of the time axis evenly.

    Attributes
    ----------
    energy : (P, n) radiance times share of the pixel.
    middle : (P, n) mean place of the light, in bins from the start of the time axis.
    across, down : (P, n) change of the place from side to side of a cell, in bins, at least `_NARROWEST_BINS`.
    smooth : (P,) whether cells are exact enough.
    """

    energy: NDArray[np.float64]
    middle: NDArray[np.float64]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    smooth: NDArray[np.bool_]


def cell_rule(width: int) -> PixelRule:
    """Nodes of all cells of a pixel, in an image of this width."""
    gauss, count = gauss_rule(2), cells_of(width)
    nodes = (np.arange(count)[:, None] + gauss.nodes).ravel() / count
    return PixelRule(nodes, np.tile(gauss.weights, count) / count)


def cells_of(width: int) -> int:
    """Cells in x and in y in a pixel, in an image of this width."""
    return max(_FEWEST_CELLS, -(-_CELLS // width))


def cells_from(energy: NDArray[np.floating], opl_m: NDArray[np.floating], layout: TransientLayout) -> Cells:
    """Cells from the light at the nodes of `cell_rule` and its path, both (P, nodes)."""
    count = cells_of(layout.width)
    e, path_m = (
        each.reshape(-1, count, 2, count, 2).transpose(0, 1, 3, 2, 4).astype(float)
        for each in (energy, opl_m)
    )  # (P, n, n, 2, 2)
    place = (path_m - layout.start_opl_m) / layout.bin_width_m
    total = e.sum(axis=(3, 4))
    known = np.isfinite(e).all(axis=(1, 2, 3, 4))
    middle = np.divide((e * place).sum(axis=(3, 4)), total, out=np.zeros_like(total), where=total > 0)
    gap = np.sqrt(3)  # sides of a cell over the distance of its nodes
    across = gap * (place[..., 1] - place[..., 0]).mean(axis=3)
    down = gap * (place[..., 1, :] - place[..., 0, :]).mean(axis=3)
    bent = np.maximum(*(np.ptp(each, axis=(1, 2)) for each in (across, down)))
    dim, bright = (end(e, axis=(1, 2, 3, 4)) for end in (np.min, np.max))
    smooth = known & (((dim > 0) & (bent < _BENT_BINS) & (bright < _UNEVEN * dim)) | (bright == 0))
    widths = (np.maximum(np.abs(each), _NARROWEST_BINS) for each in (across, down))
    flat = (each.reshape(len(e), count**2) for each in (total, middle, *widths))
    return Cells(*flat, smooth)


@dataclass(frozen=True)
class DirectBins:
    """The direct return of an image, to be put into bins."""

    scene: mi.Scene
    grid: Grid
    image: DirectImage
    layout: TransientLayout
    seed: int

    @property
    def rows_at_once(self) -> int:
        """Rows with as many nodes as one kernel launch should have."""
        return max(1, LANES // (self.grid.width * cell_rule(self.grid.width).count))

    def add(self, rows: tuple[int, int], axis: TimeAxis, bins: mi.Float) -> tuple[float, float]:
        """Add some rows to `bins`; energy that arrived, and energy outside the time axis."""
        import drjit as dr

        first, last = rows[0] * self.grid.width, rows[1] * self.grid.width
        rule, edges = cell_rule(self.grid.width), self.image.edges
        radiance, opl, _, weight, _ = direct_lanes(self.scene, self.grid, rows, rule, self.seed)
        energy = radiance * weight
        dr.eval(energy, opl)
        cells = cells_from(*(np.array(each).reshape(-1, rule.count) for each in (energy, opl)), self.layout)
        uniform = np.ones(last - first, bool)
        uniform[edges.pixels[(edges.pixels >= first) & (edges.pixels < last)] - first] = False
        smooth = np.flatnonzero(uniform & cells.smooth & cells.energy.any(axis=1))
        arrived, lost = _add_cells(cells, smooth, axis, bins)
        for samples, weights, pixel in (
            self._rough(first + np.flatnonzero(uniform & ~cells.smooth)),
            self._edges(first, last),
        ):
            more = _add_samples(samples, weights, pixel - first, axis, bins)
            arrived, lost = arrived + more[0], lost + more[1]
        return arrived, lost

    def _rough(
        self, pixels: NDArray[np.int64]
    ) -> tuple[DirectSamples, NDArray[np.float64], NDArray[np.int64]]:
        """The direct return at many nodes of pixels, with shares and pixels."""
        rule = gauss_rule(bin_order(self.grid.width))
        points = self.grid.points(pixels, rule.pixel_nodes).reshape(-1, 2)
        samples = sample_direct(self.scene, points, self.seed)
        return samples, np.tile(rule.pixel_weights, len(pixels)), np.repeat(pixels, rule.count)

    def _edges(self, first: int, last: int) -> tuple[DirectSamples, NDArray[np.float64], NDArray[np.int64]]:
        """The same of the pixels with edges from `first` to before `last`, in the order of pixels."""
        edges = self.image.edges
        mine = np.flatnonzero((edges.pixel >= first) & (edges.pixel < last))
        mine = mine[np.argsort(edges.pixel[mine], kind="stable")]
        return self.image.edge_samples.at(mine), edges.weights[mine], edges.pixel[mine]


def _add_cells(
    cells: Cells, pixels: NDArray[np.int64], axis: TimeAxis, bins: mi.Float
) -> tuple[float, float]:
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, time_bins

    if not len(pixels):
        return 0.0, 0.0
    columns = (
        mi.Float64(each[pixels].ravel()) for each in (cells.energy, cells.middle, cells.across, cells.down)
    )
    begin = dr.arange(mi.UInt32, len(pixels)) * dr.opaque(mi.UInt32, cells.energy.shape[1])
    end = begin + dr.opaque(mi.UInt32, cells.energy.shape[1])
    first = arrays.upload_indices(pixels) * axis.count
    lost = time_bins.splat_trapezoids(*columns, begin, end, first, axis, bins)
    dr.eval(bins, lost)
    return float(cells.energy[pixels].sum()), dr.sum(lost)[0]


def _add_samples(
    samples: DirectSamples,
    weights: NDArray[np.float64],
    pixel: NDArray[np.int64],
    axis: TimeAxis,
    bins: mi.Float,
) -> tuple[float, float]:
    import drjit as dr

    from render.transport.kernels import arrays, time_bins

    if not len(pixel):
        return 0.0, 0.0
    pixels, begin, count = np.unique(pixel, return_index=True, return_counts=True)
    found = time_bins.splat_samples(
        arrays.upload(samples.opl_m),
        arrays.upload(samples.radiance * weights),
        arrays.upload_indices(begin),
        arrays.upload_indices(begin + count),
        arrays.upload_indices(pixels) * axis.count,
        axis,
        bins,
    )
    dr.eval(bins, found)
    return dr.sum(found[0])[0], dr.sum(found[1])[0]
