"""Time-resolved rows of an image: the direct return and the hidden signal, split over time bins.

The hidden signal is computed at the nodes of a lattice, on a time axis that is relative to the path over the
middle of the lights. Relative to it, light arrives at neighbouring nodes at nearly the same time, so pixels
are interpolated bin by bin. notebook/derivations.md (Time-resolved output) derives this.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from disk import NightError
from itof import TransientLayout
from render.transport.film.lattice import Lattice
from render.transport.film.pixels import Grid, PixelRule
from render.transport.lights.hidden_surface import sobol_points
from render.transport.method import LitRows, View
from render.transport.passes.direct_bins import DirectBins, direct_bins
from render.transport.passes.direct_pass import DirectImage
from render.transport.passes.direct_samples import sample_direct
from render.transport.passes.edge_points import ChosenPoints, choose_points
from render.transport.passes.gather_pass import carrier_path_m, carrier_paths
from render.transport.passes.hidden_curves import make_curves
from render.transport.passes.hidden_pass import HiddenField

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

_MOST_PACKETS = 64  # for the arrivals of each light,
_ALL_PACKETS = 2**16  # and of all lights together, as far as they have two each, at this error; for smaller
_ERROR_OF_PACKETS = 0.0075  # ones more, or bins would have the noise of packets instead of that of the lights
_LEAST_ERROR = 1e-4  # that counts for this
_MOST_LOST = 1e-4  # of the hidden energy
_MARGIN_BINS = 2.5  # around the light that a B-spline spreads, or a curve between its samples

log = logging.getLogger(__name__)


class LostLightError(NightError):
    """Light arrives outside the time axis."""


def transient_rows(
    scene: mi.Scene,
    view: View,
    grid: Grid,
    rule: PixelRule,
    direct: DirectImage,
    field: HiddenField | None,
) -> LitRows:
    """Image rows with the time bins that light may reach.

    Their blocks raise `LostLightError` at the end if more than 1e-4 of the hidden light, or of all light
    where there is no hidden light, arrives outside the time axis.

    Parameters
    ----------
    rule : nodes for the hidden signal in a pixel that sees one surface.
    direct : direct return of the image; it has the cells of pixels with edges.
    field : hidden signal over the film; None without a hidden object.
    """
    if field is not None and not len(field.lights):
        field = None  # a black object
    layout = view.layout
    parts: list[DirectBins | _HiddenPart] = [direct_bins(scene, grid, direct, view)]
    if field is not None:
        parts.append(_HiddenPart(scene, view, grid, rule, direct, field))
    ends = np.array([part.ends(layout) for part in parts])
    low, high = np.clip([np.floor(ends[:, 0].min()), np.ceil(ends[:, 1].max())], 0, layout.bin_count)
    bins = range(int(low), int(high)) if low < high else range(1)
    return LitRows(bins, _row_blocks(scene, view, grid, parts, bins, field))


def _row_blocks(
    scene: mi.Scene,
    view: View,
    grid: Grid,
    parts: list[DirectBins | _HiddenPart],
    bins: range,
    field: HiddenField | None,
) -> Iterator[NDArray[np.float32]]:
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

    layout = view.layout.cut(bins)
    axis = TimeAxis(layout.bin_count, layout.bin_width_m, layout.start_opl_m)
    lost = arrived = 0.0
    for start in range(0, grid.height, layout.rows_per_block):
        rows = (start, min(start + layout.rows_per_block, grid.height))
        block = dr.zeros(mi.Float, (rows[1] - rows[0]) * grid.width * layout.bin_count)
        found = [part.add(rows, bins.start, axis, block) for part in parts]
        lost += sum(part[1] for part in found)
        arrived += found[-1][0]
        yield block.numpy().reshape(rows[1] - rows[0], grid.width, layout.bin_count)
    if lost > _MOST_LOST * arrived:
        whole = view.layout
        end_m = whole.start_opl_m + whole.bin_count * whole.bin_width_m
        what = "all light" if field is None else "the hidden light"
        share = lost / arrived if arrived > 0 else np.inf
        message = (
            f"light arrives outside the time axis of {whole.start_opl_m:g} to {end_m:g} m (optical "
            f"path length): {share:.2g} times {what}. Arrivals are between "
            f"{' and '.join(f'{end:.2f} m' for end in _arrivals_m(scene, view, field))}"
        )
        if not view.accept_lost_light:
            raise LostLightError(message)
        log.warning("%s", message)


def _arrivals_m(scene: mi.Scene, view: View, field: HiddenField | None) -> tuple[float, float]:
    """Bounds of the optical path lengths of direct and hidden light, metres."""
    points = np.concatenate([Lattice(16, 12).nodes, sobol_points(2, 2**10, 0)])
    direct = sample_direct(scene, points, view.seed)
    found = direct.opl_m[direct.opl_m > 0]
    ends = [found.min(), found.max()] if len(found) else [np.inf, 0.0]
    if field is not None:
        lit, reach_m = field.lights.opl_m[field.lights.energy > 0], field.lights.reach_m
        paths = carrier_path_m(scene, points, field.lights.centre)
        ends = [
            min(ends[0], lit.min() + paths.min() - reach_m),
            max(ends[1], lit.max() + paths.max() + reach_m),
        ]
    return max(0.0, float(ends[0])), float(ends[1])


class _HiddenPart:
    """The hidden signal of an image."""

    def __init__(
        self,
        scene: mi.Scene,
        view: View,
        grid: Grid,
        rule: PixelRule,
        direct: DirectImage,
        field: HiddenField,
    ) -> None:
        self.scene, self.grid, self.rule, self.field = scene, grid, rule, field
        lights = field.lights
        all_packets = _ALL_PACKETS * max(1.0, _ERROR_OF_PACKETS / max(field.error, _LEAST_ERROR))
        count = min(_MOST_PACKETS, max(2, int(all_packets) // len(lights)))
        energy, opl_m = lights.packets(count, view.seed)
        self.packets = (energy / lights.runs, opl_m)  # the signal is the mean over the runs
        self.curves = make_curves(scene, view, grid, rule, field, self.packets)
        surface = direct.surface.ravel()
        smooth = np.zeros(len(surface), bool)
        if self.curves is not None:
            smooth = self.curves.covers(grid, rule, surface)
        self.smooth, self.exact = np.flatnonzero(smooth), np.flatnonzero((surface > 0) & ~smooth)
        points = grid.points(self.smooth, rule.pixel_nodes).reshape(-1, 2)
        self.carriers = [each.reshape(-1, rule.count) for each in carrier_paths(scene, points, lights.centre)]
        self.chosen = choose_points(direct)
        self.chosen_weights, self.chosen_later_m = _rescaled(field, self.chosen)

    def ends(self, layout: TransientLayout) -> tuple[float, float]:
        """Bounds of the places of the light, in bins from the start of the time axis."""
        found = []
        if self.curves is not None and len(self.smooth):
            start_m, length_m = self.curves.start_m, self.curves.length_m
            found += [self.carriers[1].min() + start_m, self.carriers[1].max() + start_m + length_m]
        exact = self.grid.points(self.exact, self.rule.pixel_nodes).reshape(-1, 2)
        lights, (energy, opl_m) = self.field.lights, self.packets
        lit, reach_m = opl_m[energy > 0], lights.reach_m
        for points, later_m in ((exact, np.zeros(len(exact))), (self.chosen.points, self.chosen_later_m)):
            if len(points) and len(lit):
                path_m = carrier_paths(self.scene, points, lights.centre)[1] + later_m
                found += [path_m.min() + lit.min() - reach_m, path_m.max() + lit.max() + reach_m]
        place = (np.array(found) - layout.start_opl_m) / layout.bin_width_m
        low, high = float(place.min(initial=np.inf)), float(place.max(initial=-np.inf))
        return low - _MARGIN_BINS, high + _MARGIN_BINS

    def add(
        self, rows: tuple[int, int], first_bin: int, axis: TimeAxis, bins: mi.Float
    ) -> tuple[float, float]:
        """Add some rows to `bins`; energy that arrived, and energy outside the time axis."""
        first, last = rows[0] * self.grid.width, rows[1] * self.grid.width
        totals = []
        some = slice(*np.searchsorted(self.smooth, [first, last]))
        if self.curves is not None and len(self.smooth[some]):
            carriers = [each[some] for each in self.carriers]
            totals += self.curves.add(self.grid, self.rule, rows, self.smooth[some], carriers, axis, bins)
        exact = self.exact[slice(*np.searchsorted(self.exact, [first, last]))]
        for node, share in zip(self.rule.pixel_nodes, self.rule.pixel_weights, strict=True):
            points = self.grid.points(exact, node[None])[:, 0]
            weights, later_m = np.full(len(exact), share), np.zeros(len(exact))
            totals.append(self._splat(points, weights, later_m, exact - first, axis, bins))
        chosen = self.chosen
        pixel = chosen.pixels[chosen.group]
        mine = np.flatnonzero((pixel >= first) & (pixel < last))
        while len(mine):  # one point of each pixel at a time: lanes must not write to the same bins
            now = np.unique(pixel[mine], return_index=True)[1]
            one = mine[now]
            weights, later_m = self.chosen_weights[one], self.chosen_later_m[one]
            totals.append(self._splat(chosen.points[one], weights, later_m, pixel[one] - first, axis, bins))
            mine = np.delete(mine, now)
        return sum(total[0] for total in totals), sum(total[1] for total in totals)

    def _splat(
        self,
        points: NDArray[np.float64],
        weights: NDArray[np.float64],
        later_m: NDArray[np.float64],
        pixels: NDArray[np.int64],
        axis: TimeAxis,
        bins: mi.Float,
    ) -> tuple[float, float]:
        """Add all lights at points (N, 2) to N different pixels, with paths that are `later_m` longer."""
        import drjit as dr
        import mitsuba as mi

        from render.transport.kernels import arrays, rays, time_bins

        if not len(points):
            return 0.0, 0.0
        lights, (energy, opl_m) = self.field.lights, self.packets
        totals = time_bins.splat_lights(
            self.scene,
            rays.camera_hits(self.scene, *(arrays.upload(column) for column in points.T)),
            arrays.upload_points(lights.position),
            arrays.upload_points(lights.normal),
            arrays.upload(energy),
            arrays.upload(opl_m),
            dr.opaque(mi.UInt32, energy.shape[1]),
            dr.opaque(mi.UInt32, len(lights)),
            arrays.upload(weights),
            arrays.upload(later_m),
            arrays.upload_indices(pixels) * axis.count,
            axis,
            bins,
        )
        dr.eval(bins, totals)
        return dr.sum(totals[0])[0], dr.sum(totals[1])[0]


def _rescaled(field: HiddenField, chosen: ChosenPoints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(C,) weights of the chosen points that stand for all points of their group, and (C,) path to add.

    With both, the carrier has the energy and the mean path length of the whole group.
    """
    moments = []
    for points, weights, summed in (
        (chosen.points, chosen.weights, chosen.sums),
        (chosen.seen_points, chosen.seen_weights, chosen.totals),
    ):
        amplitude, path_m = carrier_paths(field.scene, points, field.lights.centre)
        energy = weights * amplitude
        moments.append(summed(np.stack([energy, energy * path_m], axis=-1).astype(complex)).real)
    part, whole = moments
    lit = (part[:, 0] != 0) & (whole[:, 0] != 0)
    scale = np.divide(whole[:, 0], part[:, 0], out=np.ones(len(lit)), where=lit)
    mean_m = [np.divide(m[:, 1], m[:, 0], out=np.zeros(len(lit)), where=lit) for m in moments]
    return chosen.weights * scale[chosen.group], (mean_m[1] - mean_m[0])[chosen.group]
