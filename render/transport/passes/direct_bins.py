"""The direct return over time: in closed form where a pixel sees one smooth surface, else at many nodes.

A pixel is divided into equal cells with 2 x 2 Gauss nodes. In a cell, the path is taken as linear. The cell
then fills a trapezoid of the time axis evenly, around the mean path of its light.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout
from render.transport.film.pixels import Grid, PixelRule, gauss_rule
from render.transport.method import View
from render.transport.passes.direct_pass import DirectImage, bin_order
from render.transport.passes.direct_samples import DirectSamples, sample_direct

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

# In the width of the image; and in x and in y in a pixel, where surfaces have edges within.
_CELLS, _FEWEST_CELLS = 240, 2
# What cells of a pixel may differ in: the light by this factor, the change of the path from side to side by
# so many bins. Others have an edge within the surface, or see it at a grazing angle. A cell of its own may
# have as much of it as one of two.
_UNEVEN, _UNEVEN_ALONE, _BENT_BINS = 1.5, 1.5 ** (1 / 3), 1.0
_NARROWEST_BINS = 1e-3  # a trapezoid is a difference over its two widths, in float64
_REACH_BINS = 1.5  # of the B-spline


@dataclass(frozen=True)
class Cells:
    """The cells of P pixels, n of each; the light fills a trapezoid of the time axis evenly.

    Attributes
    ----------
    energy : (P, n) radiance times share of the pixel.
    middle : (P, n) mean place of the light, in bins from the start of the time axis.
    across, down : (P, n) change of the place from side to side of a cell, at least `_NARROWEST_BINS`.
    smooth : (P,) whether cells are exact enough.
    """

    energy: NDArray[np.float64]
    middle: NDArray[np.float64]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    smooth: NDArray[np.bool_]

    def at(self, pixels: NDArray[np.bool_]) -> Cells:
        """The cells of some of the pixels."""
        return Cells(*(getattr(self, each.name)[pixels] for each in fields(self)))


def cell_rule(count: int) -> PixelRule:
    """Nodes of all cells of a pixel, `count` in x and in y."""
    gauss = gauss_rule(2)
    nodes = (np.arange(count)[:, None] + gauss.nodes).ravel() / count
    return PixelRule(nodes, np.tile(gauss.weights, count) / count)


def cells_of(view: View, order: int) -> int:
    """Cells in x and in y in a pixel, of which the direct return has at least `order` nodes in x and in y."""
    return max(_FEWEST_CELLS if view.all_is_direct else 1, -(-order // 2), -(-_CELLS // view.layout.width))


def cells_from(
    energy: NDArray[np.floating], opl_m: NDArray[np.floating], layout: TransientLayout, count: int
) -> Cells:
    """Cells from the light at the nodes of `cell_rule` and its path, both (P, nodes).

    Towards the horizon of a plane, the path x grows like 1 / y, with a second difference of 2 x'^2 / x.
    """
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
    length = place.mean(axis=(3, 4)) + layout.start_opl_m / layout.bin_width_m
    sag = np.divide(2 * (across**2 + down**2), length, out=np.zeros_like(length), where=length > 0)
    bent = np.maximum.reduce([*(np.ptp(each, axis=(1, 2)) for each in (across, down)), sag.max(axis=(1, 2))])
    dim, bright = (end(e, axis=(1, 2, 3, 4)) for end in (np.min, np.max))
    uneven = _UNEVEN if count > 1 else _UNEVEN_ALONE
    smooth = known & (((dim > 0) & (bent < _BENT_BINS) & (bright < uneven * dim)) | (bright == 0))
    widths = [np.maximum(np.abs(each), _NARROWEST_BINS) for each in (across, down)]
    total, middle, across, down = (each.reshape(len(e), count**2) for each in (total, middle, *widths))
    return Cells(total, middle, across, down, smooth)


@dataclass(frozen=True)
class DirectBins:
    """The direct return of an image, to be put into bins.

    Attributes
    ----------
    width : of the image, pixels.
    cells : of the pixels with light where cells are exact enough.
    by_cells : row-major indices of these pixels.
    samples, energy, pixel : nodes of all other pixels, in the order of these: the direct return there,
        radiance times share of the pixel, and pixel.
    """

    width: int
    cells: Cells
    by_cells: NDArray[np.int64]
    samples: DirectSamples
    energy: NDArray[np.float64]
    pixel: NDArray[np.int64]

    def ends(self, layout: TransientLayout) -> tuple[float, float]:
        """First and last place of the light, in bins from the start of the time axis."""
        cells = self.cells
        reach = (cells.across + cells.down) / 2
        place = (self.samples.opl_m[self.energy > 0].astype(float) - layout.start_opl_m) / layout.bin_width_m
        ends = (cells.middle - reach, cells.middle + reach)
        low, high = (np.concatenate([each.ravel(), place]) for each in ends)
        return (
            float(low.min(initial=np.inf)) - _REACH_BINS,
            float(high.max(initial=-np.inf)) + _REACH_BINS,
        )

    def add(
        self, rows: tuple[int, int], first_bin: int, axis: TimeAxis, bins: mi.Float
    ) -> tuple[float, float]:
        """Add some rows to `bins`; energy that arrived, and energy outside the time axis.

        Parameters
        ----------
        first_bin : where `axis` begins, in bins from the start of the time axis of the cells.
        """
        first, last = rows[0] * self.width, rows[1] * self.width
        cells = slice(*np.searchsorted(self.by_cells, [first, last]))
        nodes = slice(*np.searchsorted(self.pixel, [first, last]))
        totals = np.zeros(2)
        if len(self.by_cells[cells]):
            totals += self._add_cells(cells, self.by_cells[cells] - first, first_bin, axis, bins)
        if len(self.pixel[nodes]):
            totals += self._add_nodes(nodes, self.pixel[nodes] - first, axis, bins)
        return float(totals[0]), float(totals[1])

    def _add_cells(
        self,
        chosen: slice,
        pixels: NDArray[np.int64],
        first_bin: int,
        axis: TimeAxis,
        bins: mi.Float,
    ) -> tuple[float, float]:
        import drjit as dr
        import mitsuba as mi

        from render.transport.kernels import arrays, time_bins

        cells = self.cells
        columns = (cells.energy, cells.middle - first_bin, cells.across, cells.down)
        count = dr.opaque(mi.UInt32, cells.energy.shape[1])
        begin = dr.arange(mi.UInt32, len(pixels)) * count
        lost = time_bins.splat_trapezoids(
            *(mi.Float64(each[chosen].ravel()) for each in columns),
            begin,
            begin + count,
            arrays.upload_indices(pixels) * axis.count,
            axis,
            bins,
        )
        dr.eval(bins, lost)
        return float(cells.energy[chosen].sum()), dr.sum(lost)[0]

    def _add_nodes(
        self, nodes: slice, pixel: NDArray[np.int64], axis: TimeAxis, bins: mi.Float
    ) -> tuple[float, float]:
        import drjit as dr

        from render.transport.kernels import arrays, time_bins

        pixels, begin, count = np.unique(pixel, return_index=True, return_counts=True)
        found = time_bins.splat_samples(
            arrays.upload(self.samples.opl_m[nodes]),
            arrays.upload(self.energy[nodes]),
            arrays.upload_indices(begin),
            arrays.upload_indices(begin + count),
            arrays.upload_indices(pixels) * axis.count,
            axis,
            bins,
        )
        dr.eval(bins, found)
        return dr.sum(found[0])[0], dr.sum(found[1])[0]


def direct_bins(scene: mi.Scene, grid: Grid, image: DirectImage, view: View) -> DirectBins:
    """The light of all cells, and of nodes where cells are not exact enough."""
    count = cells_of(view, image.order)
    rule, fine = cell_rule(count), gauss_rule(bin_order(grid.width))
    edges, edge_samples = image.edges, image.edge_samples
    if image.lit is not None:
        edges, edge_samples = image.lit.joined(edges, edge_samples)
    uniform = np.setdiff1d(np.flatnonzero(image.surface.ravel() > 0), edges.pixels)
    found = sample_direct(scene, grid.points(uniform, rule.pixel_nodes).reshape(-1, 2), view.seed)
    energy = found.radiance.reshape(-1, rule.count) * rule.pixel_weights
    cells = cells_from(energy, found.opl_m.reshape(energy.shape), view.layout, count)
    rough = uniform[~cells.smooth]
    nodes = sample_direct(scene, grid.points(rough, fine.pixel_nodes).reshape(-1, 2), view.seed)
    pixel = np.concatenate([np.repeat(rough, fine.count), edges.pixel])
    order = np.argsort(pixel, kind="stable")
    samples = DirectSamples.joined([nodes, edge_samples]).at(order)
    weights = np.concatenate([np.tile(fine.pixel_weights, len(rough)), edges.weights])[order]
    kept = cells.smooth & cells.energy.any(axis=1)
    return DirectBins(
        grid.width, cells.at(kept), uniform[kept], samples, samples.radiance * weights, pixel[order]
    )
