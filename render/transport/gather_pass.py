"""Pixel integrals of the many-light method: the direct return, and the light of all lights over the wall."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout, phase_per_metre
from render.transport.light_pass import Lights

if TYPE_CHECKING:
    import mitsuba as mi

_LANES = 2**20  # most pixel samples in one kernel launch


@dataclass(frozen=True)
class PixelRule:
    """A quadrature rule for the average over a pixel, with the same one-dimensional nodes in x and y.

    Attributes
    ----------
    nodes : (n,) positions in (0, 1).
    weights : (n,) their sum is 1.
    """

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of nodes in a pixel."""
        return len(self.nodes) ** 2

    @property
    def pixel_nodes(self) -> NDArray[np.float64]:
        """(n², 2) x and y of the nodes of a pixel; y varies slowest."""
        y, x = np.meshgrid(self.nodes, self.nodes, indexing="ij")
        return np.stack([x.ravel(), y.ravel()], axis=-1)

    @property
    def pixel_weights(self) -> NDArray[np.float64]:
        """(n²,) weights of the nodes of a pixel, in the order of `pixel_nodes`."""
        return np.outer(self.weights, self.weights).ravel()


def gauss_rule(order: int) -> PixelRule:
    """Gauss-Legendre rule for smooth integrands: exact for polynomials of degree 2 order - 1."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return PixelRule((nodes + 1) / 2, weights / 2)  # from [-1, 1] to [0, 1]


def midpoint_rule(count: int) -> PixelRule:
    """Midpoints of equal cells, for integrands with edges and for histograms."""
    return PixelRule((np.arange(count) + 0.5) / count, np.full(count, 1 / count))


@dataclass(frozen=True)
class Grid:
    """The pixels of an image of width x height."""

    width: int
    height: int

    def blocks(self, rule: PixelRule, limit: int = _LANES) -> Iterator[tuple[int, int]]:
        """Ranges of rows (first row, row after the last) with at most `limit` pixel samples."""
        step = max(1, limit // (self.width * rule.count))
        for start in range(0, self.height, step):
            yield start, min(start + step, self.height)

    def samples(
        self, rows: tuple[int, int], rule: PixelRule, node: int | None = None
    ) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.Float]:
        """Film x, y, pixel index and weight of all nodes in some rows, or of one node per pixel."""
        from render.transport import kernels

        chosen = slice(None) if node is None else slice(node, node + 1)
        size = (self.width, self.height)
        return kernels.pixel_samples(size, rows, rule.pixel_nodes[chosen], rule.pixel_weights[chosen])


def gather_direct(
    scene: mi.Scene, grid: Grid, frequencies_hz: tuple[float, ...], rule: PixelRule, seed: int
) -> NDArray[np.complex128]:
    """(H, W, F) phasors of the one-bounce return, mean radiance of each pixel in W m^-2 sr^-1."""
    turns = phase_per_metre(frequencies_hz)
    blocks = []
    for rows in grid.blocks(rule):
        radiance, opl_m = _direct(scene, grid, rows, rule, seed)
        z = np.stack([radiance * np.exp(1j * k * opl_m) for k in turns], axis=-1)
        blocks.append(_pixel_mean(z, grid, rows, rule))
    return np.concatenate(blocks)


def gather_lights(
    scene: mi.Scene, grid: Grid, frequencies_hz: tuple[float, ...], rule: PixelRule, lights: Lights
) -> NDArray[np.complex128]:
    """(H, W, F) phasors of the hidden signal, mean radiance of each pixel in W m^-2 sr^-1."""
    frequency_count = len(frequencies_hz)
    if not len(lights):
        return np.zeros((grid.height, grid.width, frequency_count), complex)
    import drjit as dr
    import mitsuba as mi

    from render.transport import kernels

    intensity = lights.phasors(frequencies_hz)
    position, normal = kernels.upload_points(lights.position), kernels.upload_points(lights.normal)
    real, imaginary = kernels.upload(intensity.real), kernels.upload(intensity.imag)
    turns = [dr.opaque(mi.Float, float(k)) for k in phase_per_metre(frequencies_hz)]
    count = dr.opaque(mi.UInt32, len(lights))
    blocks = []
    for rows in grid.blocks(rule):
        x, y, _, _ = grid.samples(rows, rule)
        si = kernels.camera_hits(scene, x, y)
        re, im = kernels.gather_phasors(scene, si, position, normal, real, imaginary, turns, count)
        dr.eval(re, im)
        z = np.stack([np.array(a) + 1j * np.array(b) for a, b in zip(re, im, strict=True)], axis=-1)
        blocks.append(_pixel_mean(z, grid, rows, rule))
    return np.concatenate(blocks)


def splat_rows(
    scene: mi.Scene,
    layout: TransientLayout,
    rows: tuple[int, int],
    lights: Lights,
    packets: tuple[NDArray[np.float32], NDArray[np.float32]],
    direct_rule: PixelRule,
    hidden_rule: PixelRule,
    seed: int,
) -> NDArray[np.float32]:
    """(rows, W, T) radiance per bin, sum of direct and hidden part, split linearly between two bins.

    Parameters
    ----------
    rows : first row, and the row after the last.
    packets : energy and OPL (N, Q) of `Lights.packets`.
    direct_rule, hidden_rule : nodes in the pixel for each part.
    seed : of the random numbers that emitters with an extent need.
    """
    import drjit as dr
    import mitsuba as mi

    from render.transport import kernels

    grid = Grid(layout.width, layout.height)
    axis = kernels.TimeAxis(layout.bin_count, layout.bin_width_m, layout.start_opl_m)
    pixels = (rows[1] - rows[0]) * layout.width
    bins = dr.zeros(mi.Float, pixels * layout.bin_count)
    radiance, opl, pixel, weight = _direct_lanes(scene, grid, rows, direct_rule, seed)
    kernels.splat_tent(bins, pixel * axis.count, axis, opl, radiance * weight, dr.ReduceMode.Auto)
    dr.eval(bins)
    if len(lights):
        energy, light_opl_m = packets
        for node, share in enumerate(hidden_rule.pixel_weights):
            # One node of every pixel in each launch, so that no two lanes write to the same bin.
            x, y, _, _ = grid.samples(rows, hidden_rule, node)
            kernels.splat_lights(
                scene,
                kernels.camera_hits(scene, x, y),
                kernels.upload_points(lights.position),
                kernels.upload_points(lights.normal),
                kernels.upload(energy * share),
                kernels.upload(light_opl_m),
                dr.opaque(mi.UInt32, energy.shape[1]),
                dr.opaque(mi.UInt32, len(lights)),
                axis,
                bins,
            )
            dr.eval(bins)
    return np.array(bins).reshape(rows[1] - rows[0], layout.width, layout.bin_count)


def _direct_lanes(
    scene: mi.Scene, grid: Grid, rows: tuple[int, int], rule: PixelRule, seed: int
) -> tuple[mi.Float, mi.Float, mi.UInt32, mi.Float]:
    """Radiance, OPL, pixel index and weight of every sample of the direct return."""
    import drjit as dr
    import mitsuba as mi

    from render.transport import kernels

    x, y, pixel, weight = grid.samples(rows, rule)
    # Only emitters with an extent use the random sample; a projector is a point.
    stream = int(np.random.SeedSequence([seed, rows[0]]).generate_state(1)[0])
    random = mi.PCG32(dr.width(x), dr.opaque(mi.UInt64, stream))
    sample = mi.Point2f(random.next_float32(), random.next_float32())
    radiance, opl = kernels.direct_return(scene, kernels.camera_hits(scene, x, y), sample)
    return radiance, opl, pixel, weight


def _direct(
    scene: mi.Scene, grid: Grid, rows: tuple[int, int], rule: PixelRule, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import drjit as dr

    radiance, opl, _, _ = _direct_lanes(scene, grid, rows, rule, seed)
    dr.eval(radiance, opl)
    return np.array(radiance, dtype=np.float64), np.array(opl, dtype=np.float64)


def _pixel_mean(
    z: NDArray[np.complex128], grid: Grid, rows: tuple[int, int], rule: PixelRule
) -> NDArray[np.complex128]:
    """(rows, W, F) weighted mean over the nodes of each pixel, from (lanes, F) values."""
    shaped = z.reshape(rows[1] - rows[0], grid.width, rule.count, -1)
    return np.einsum("hwnf,n->hwf", shaped, rule.pixel_weights)
