"""Time-resolved rows of an image: the direct return and the hidden signal, split over time bins.

The hidden signal is computed at the nodes of a lattice, on a time axis that is relative to the path over the
middle of the lights. Relative to it, light arrives at neighbouring nodes at nearly the same time, so pixels
are interpolated bin by bin. notebook/derivations.md (Time-resolved output) derives this.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from disk import NightError
from render.transport.film.lattice import Lattice
from render.transport.film.pixels import LANES, Grid, PixelRule, gauss_rule
from render.transport.lights.hidden_surface import sobol_points
from render.transport.method import View
from render.transport.passes.direct_pass import DirectImage, bin_order
from render.transport.passes.direct_samples import direct_lanes, sample_direct
from render.transport.passes.edge_points import ChosenPoints, choose_points
from render.transport.passes.gather_pass import carrier_path_m, carrier_paths
from render.transport.passes.hidden_curves import make_curves
from render.transport.passes.hidden_pass import HiddenField

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

_MOST_PACKETS = 64  # for the arrivals of each light,
_ALL_PACKETS = 2**16  # and of all lights together, as far as they have two each
_MOST_LOST = 1e-4  # of the hidden energy

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
) -> Iterator[NDArray[np.float32]]:
    """Image rows from top to bottom, in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1.

    Parameters
    ----------
    rule : nodes for the hidden signal in a pixel that sees one surface.
    direct : direct return of the image; it has the cells of pixels with edges.
    field : hidden signal over the film; None without a hidden object.

    Raises
    ------
    LostLightError : more than 1e-4 of the hidden light, or of all light where there is no hidden light,
        arrives outside the time axis.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

    if field is not None and not len(field.lights):
        field = None  # a black object
    layout = view.layout
    axis = TimeAxis(layout.bin_count, layout.bin_width_m, layout.start_opl_m)
    order = bin_order(grid.width)
    direct_part = _DirectPart(scene, grid, gauss_rule(order), direct, view.seed)
    hidden_part = None if field is None else _HiddenPart(scene, view, grid, rule, direct, field)
    lost = arrived = 0.0
    step = min(layout.rows_per_block, max(1, 4 * LANES // (grid.width * order**2)))
    for start in range(0, grid.height, step):
        rows = (start, min(start + step, grid.height))
        bins = dr.zeros(mi.Float, (rows[1] - rows[0]) * grid.width * layout.bin_count)
        parts = [direct_part.add(rows, axis, bins)]
        if hidden_part is not None:
            parts.append(hidden_part.add(rows, axis, bins))
        lost += sum(part[1] for part in parts)
        arrived += parts[-1][0]
        yield np.array(bins).reshape(rows[1] - rows[0], grid.width, layout.bin_count)
    if lost > _MOST_LOST * arrived:
        end_m = layout.start_opl_m + layout.bin_count * layout.bin_width_m
        what = "all light" if field is None else "the hidden light"
        share = lost / arrived if arrived > 0 else np.inf
        message = (
            f"light arrives outside the time axis of {layout.start_opl_m:g} to {end_m:g} m (optical "
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


@dataclass(frozen=True)
class _DirectPart:
    """The direct return of an image."""

    scene: mi.Scene
    grid: Grid
    rule: PixelRule
    image: DirectImage
    seed: int

    def add(self, rows: tuple[int, int], axis: TimeAxis, bins: mi.Float) -> tuple[float, float]:
        """Add some rows to `bins`; energy that arrived, and energy outside the time axis."""
        import drjit as dr

        from render.transport.kernels import arrays, time_bins

        first_pixel, last_pixel = rows[0] * self.grid.width, rows[1] * self.grid.width
        edges, samples = self.image.edges, self.image.edge_samples
        if self.image.lit is not None:
            edges, samples = self.image.lit.joined(edges, samples)
        mine = np.flatnonzero((edges.pixel >= first_pixel) & (edges.pixel < last_pixel))
        mine = mine[np.argsort(edges.pixel[mine], kind="stable")]
        divided, counts = np.unique(edges.pixel[mine] - first_pixel, return_counts=True)
        uniform = np.setdiff1d(np.arange(last_pixel - first_pixel), divided)
        radiance, opl, _, weight, _ = direct_lanes(self.scene, self.grid, rows, self.rule, self.seed)
        energy = radiance * weight
        dr.eval(opl, energy)
        totals = [(0.0, 0.0)]
        for pixels, begin, count, path, share in (
            (uniform, uniform * self.rule.count, self.rule.count, opl, energy),
            (
                divided,
                np.cumsum(counts) - counts,
                counts,
                arrays.upload(samples.opl_m[mine]),
                arrays.upload(samples.radiance[mine] * edges.weights[mine]),
            ),
        ):
            if len(pixels):
                first = arrays.upload_indices(pixels) * axis.count
                ends = (arrays.upload_indices(begin), arrays.upload_indices(begin + count))
                found = time_bins.splat_samples(path, share, *ends, first, axis, bins)
                dr.eval(bins, found)
                totals.append((dr.sum(found[0])[0], dr.sum(found[1])[0]))
        return sum(total[0] for total in totals), sum(total[1] for total in totals)


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
        count = min(_MOST_PACKETS, max(2, _ALL_PACKETS // max(len(lights), 1)))
        energy, opl_m = lights.packets(count, view.seed)
        self.packets = (energy / lights.runs, opl_m)  # the signal is the mean over the runs
        self.curves = make_curves(scene, view, grid, rule, field, self.packets)
        surface = direct.surface.ravel()
        self.smooth = np.zeros(len(surface), bool)
        if self.curves is not None:
            self.smooth = self.curves.covers(grid, rule, surface)
        self.exact = (surface > 0) & ~self.smooth
        self.chosen = choose_points(direct)
        self.chosen_weights, self.chosen_later_m = _rescaled(field, self.chosen)

    def add(self, rows: tuple[int, int], axis: TimeAxis, bins: mi.Float) -> tuple[float, float]:
        """Add some rows to `bins`; energy that arrived, and energy outside the time axis."""
        first, last = rows[0] * self.grid.width, rows[1] * self.grid.width
        totals = []
        if self.curves is not None and self.smooth[first:last].any():
            totals += self.curves.add(self.grid, self.rule, rows, self.smooth[first:last], axis, bins)
        exact = first + np.flatnonzero(self.exact[first:last])
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
