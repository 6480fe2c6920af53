"""The hidden signal over time at the nodes of a lattice, and its interpolation to pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from render.transport.film.lattice import Lattice, filled
from render.transport.film.pixels import Grid, PixelRule
from render.transport.method import View
from render.transport.passes.direct_samples import seen_surfaces
from render.transport.passes.gather_pass import carrier_amplitude
from render.transport.passes.hidden_pass import HiddenField, interpolable

if TYPE_CHECKING:
    import mitsuba as mi

    from render.transport.kernels.time_bins import TimeAxis

# Cells in the width of the film. A cell is 12 cm of the wall, over which the light from the ends of an object
# shifts by four bins: 1 to 2 % of the hidden signal at the wrong time, where the lights leave 10 %.
# Shadows of single lights ring between the nodes (400 lights: 0.4 % of the signal), so few take half of that.
_COLUMNS, _FEW_LIGHTS = 20, 1024
_FINER = 4  # samples of a curve in a bin
_SLICES = 4  # of the lights at each node, so that all threads are busy
# Bins hold multiples of about so much of the largest one in a pixel: 0.01 % of the hidden signal, and half of
# the bytes of a compressed file. The tails of the splines reach denormal numbers, which some threads round to
# zero and others do not.
_QUANTUM = 2.0**-11
_TINY = 1e-30
_LEAST, _MARGIN = _QUANTUM / 16, _FINER  # of the largest; samples around the light, where splines may reach


@dataclass(frozen=True)
class HiddenCurves:
    """The hidden signal over time at the nodes of a lattice, relative to the carrier.

    Attributes
    ----------
    coefficients : (rows, columns, S) splines along x through the samples of the curves, which have the spread
        of a bin and are divided by the carrier's amplitude.
    largest : value of the curves.
    valid : (N,) nodes that see `surface`.
    start_m, width_m : start and sample distance of the relative time axis, metres.
    """

    scene: mi.Scene
    centre: NDArray[np.float64]
    lattice: Lattice
    coefficients: NDArray[np.float32]
    largest: float
    valid: NDArray[np.bool_]
    surface: int
    start_m: float
    width_m: float

    def covers(self, grid: Grid, rule: PixelRule, surface: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(pixels,) which pixels can be interpolated."""
        return interpolable(self.lattice, self.valid, grid, rule, surface == self.surface)

    @property
    def length_m(self) -> float:
        """Length of the relative time axis, metres."""
        return self.coefficients.shape[2] * self.width_m

    def add(
        self,
        grid: Grid,
        rule: PixelRule,
        rows: tuple[int, int],
        pixels: NDArray[np.int64],
        carriers: list[NDArray[np.float64]],
        axis: TimeAxis,
        bins: mi.Float,
    ) -> list[tuple[float, float]]:
        """Add pixels of some rows to `bins`, which begin with these; energies that arrived and were lost.

        Parameters
        ----------
        pixels : (P,) row-major indices in the image.
        carriers : amplitude and path, both (P, n), of the carrier at the nodes of `rule`.
        """
        import drjit as dr

        from render.transport.kernels import arrays, time_bins

        relative = time_bins.TimeAxis(self.coefficients.shape[2], self.width_m, self.start_m)
        window = int(self.length_m * float(axis.per_metre[0])) + 2
        row, column = pixels // grid.width - rows[0], pixels % grid.width
        uploaded = arrays.upload_indices(pixels - rows[0] * grid.width)
        taps = [self.lattice.taps((np.arange(grid.width) + x) / grid.width) for x in rule.nodes]
        totals = []
        for node, weight in enumerate(rule.pixel_weights):
            y, x = divmod(node, len(rule.nodes))
            if x == 0:
                down = self.lattice.down(self.coefficients, (np.arange(*rows) + rule.nodes[y]) / grid.height)
                values = arrays.upload(down)
            tap, weights = taps[x]
            amplitude, path_m = (each[:, node] for each in carriers)
            found = time_bins.add_shifted(
                values,
                arrays.upload_indices(row * self.lattice.shape[1] + tap[column]),
                [arrays.upload(each[column]) for each in weights.T],
                arrays.upload(2.0 ** np.floor(np.log2(_QUANTUM * self.largest * amplitude * weight + _TINY))),
                relative,
                arrays.upload(amplitude * weight),
                arrays.upload(path_m),
                uploaded,
                axis,
                window,
                bins,
            )
            dr.eval(bins, found)
            totals.append((dr.sum(found[0])[0], dr.sum(found[1])[0]))
        return totals


def make_curves(
    scene: mi.Scene,
    view: View,
    grid: Grid,
    rule: PixelRule,
    field: HiddenField,
    packets: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> HiddenCurves | None:
    """Curves at the nodes of a lattice; None where an exact computation of every pixel is no dearer."""
    if field.lattice is None or not len(field.lights):
        return None
    columns = max(_COLUMNS if len(field.lights) > _FEW_LIGHTS else 2 * _COLUMNS, field.lattice.columns)
    lattice = Lattice(columns, max(3, round(columns * grid.height / grid.width)))
    nodes = lattice.nodes
    if len(nodes) >= grid.width * grid.height * rule.count:
        return None
    seen = seen_surfaces(scene, nodes)
    amplitude = carrier_amplitude(scene, nodes, field.lights.centre)
    valid = (seen == field.surface) & (amplitude > 0)
    width_m = view.layout.bin_width_m / _FINER
    # No light is further from a node than the centre of all lights by more than its distance from that.
    reach_m = field.lights.reach_m
    lit = packets[1][packets[0] > 0]
    low_m, high_m = lit.min() - reach_m, lit.max() + reach_m
    start_m = low_m - 2 * view.layout.bin_width_m
    count = int(np.ceil((high_m + 2 * view.layout.bin_width_m - start_m) / width_m))
    values = np.zeros((len(nodes), count), np.float32)
    chosen = np.flatnonzero(valid)
    for block in np.array_split(chosen, max(1, -(-len(chosen) * count * _SLICES // 2**26))):
        values[block] = _curves_at(scene, nodes[block], field, packets, (count, width_m, start_m))
    values[chosen] /= amplitude[chosen, None]
    table = filled(values.reshape(*lattice.shape, count), valid.reshape(lattice.shape))
    spread = convolve1d(table, _bin_shape(), axis=2, mode="constant").astype(np.float32)
    largest = float(spread.max())
    used = np.flatnonzero((spread > _LEAST * largest).any(axis=(0, 1)))
    first, last = (max(int(used[0]) - _MARGIN, 0), int(used[-1]) + 1 + _MARGIN) if len(used) else (0, 1)
    return HiddenCurves(
        scene,
        field.lights.centre,
        lattice,
        lattice.spline_columns(spread[..., first:last]),
        largest,
        valid,
        field.surface,
        start_m + first * width_m,
        width_m,
    )


def _curves_at(
    scene: mi.Scene,
    nodes: NDArray[np.float64],
    field: HiddenField,
    packets: tuple[NDArray[np.float32], NDArray[np.float32]],
    axis: tuple[int, float, float],
) -> NDArray[np.float32]:
    """(N, S) energy in each bin of the relative time axis, at film positions (N, 2)."""
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, rays, time_bins

    lights = field.lights
    relative = time_bins.TimeAxis(*axis)
    count = dr.opaque(mi.UInt32, len(nodes))
    lane = dr.arange(mi.UInt32, len(nodes) * _SLICES)
    node, slice_ = lane % count, lane // count
    edges = np.linspace(0, len(lights), _SLICES + 1).astype(np.uint32)
    bins = dr.zeros(mi.Float, len(nodes) * _SLICES * axis[0])
    x, y = (dr.gather(mi.Float, arrays.upload(column), node) for column in nodes.T)
    time_bins.splat_relative(
        scene,
        rays.camera_hits(scene, x, y),
        mi.Point3f(*(dr.opaque(mi.Float, float(value)) for value in lights.centre)),
        arrays.upload_points(lights.position),
        arrays.upload_points(lights.normal),
        arrays.upload(packets[0]),
        arrays.upload(packets[1]),
        dr.opaque(mi.UInt32, packets[0].shape[1]),
        dr.gather(mi.UInt32, arrays.upload_indices(edges[:-1]), slice_),
        dr.gather(mi.UInt32, arrays.upload_indices(edges[1:]), slice_),
        lane * relative.count,
        relative,
        bins,
    )
    dr.eval(bins)
    return np.array(bins).reshape(_SLICES, len(nodes), axis[0]).sum(axis=0)


def _bin_shape() -> NDArray[np.float64]:
    """Quadratic B-spline of a bin's width, at the distances of the relative time axis."""
    steps = np.arange(-2 * _FINER, 2 * _FINER + 1) / _FINER
    off = np.abs(steps)
    return np.where(off < 0.5, 0.75 - off**2, np.where(off < 1.5, (1.5 - off) ** 2 / 2, 0.0))
