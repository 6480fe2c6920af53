"""The direct return in bins, in closed form, against brute force in float64."""

import many_light_scenes as corner
import numpy as np
import pytest
from odd_corners import OddCorner, loaded_corner, random_corner

from itof import MeasurementMatrix, TransientLayout, phase_per_metre
from render.transport.film.pixels import Grid, gauss_rule
from render.transport.passes.direct_samples import sample_direct

FAINT = 3e-4  # hidden part of a faint scene, relative to the direct return
NODES = 96  # of the brute force, in the width of a pixel


def spread(place, energy, bin_count):
    """(P, T) bins of returns (P, N) at places in bins from the start of the axis, by quadratic B-splines."""
    bins = np.zeros((len(place), bin_count))
    nearest = np.floor(place).astype(int)
    off = place - nearest - 0.5
    for step, share in ((-1, (0.5 - off) ** 2 / 2), (0, 0.75 - off**2), (1, (0.5 + off) ** 2 / 2)):
        pixel = np.broadcast_to(np.arange(len(place))[:, None], place.shape)
        np.add.at(bins, (pixel, nearest + step), energy * share)
    return bins


@pytest.mark.parametrize("widths", [(1e-3, 1e-3), (0.4, 1e-3), (0.7, 0.6), (3.3, 0.2), (24.0, 11.0)], ids=str)
def test_the_kernel_integrates_the_b_spline_over_the_cell(variant, widths):
    import drjit as dr
    import mitsuba as mi

    from render.transport.kernels import arrays, time_bins

    rng = np.random.default_rng(3)
    middle, light, count = rng.uniform(30, 34, 40), rng.uniform(0.5, 2, 40), 64
    bins, lane = dr.zeros(mi.Float, 40 * count), np.arange(40)
    lost = time_bins.splat_trapezoids(
        *(mi.Float64(each) for each in (light, middle, *np.repeat([widths], 40, axis=0).T)),
        *(arrays.upload_indices(each) for each in (lane, lane + 1, lane * count)),
        time_bins.TimeAxis(count, 0.01, 0.0),
        bins,
    )
    found = np.array(bins).reshape(40, count)
    x, y = np.meshgrid(*[(np.arange(300) + 0.5) / 300 - 0.5] * 2)
    place = middle[:, None] + (widths[0] * x + widths[1] * y).ravel()
    expected = spread(place, light[:, None] / x.size, count)
    # Midpoints of 1/300 of 24 bins miss 24² / 300² / 24 x the second derivative of the shares.
    np.testing.assert_allclose(found, expected, atol=1e-3 * 2 * (max(widths) / 24) ** 2 + 1e-6)
    np.testing.assert_allclose(found.sum(axis=1), light, rtol=4e-7 * 6)  # float32, of at most 38 bins
    assert np.abs(np.array(lost)).max() < 1e-9


def compared(scene, variant, layout):
    """Bins (P, T) of some pixels without edges, the same by brute force, and phasors (P, F) without bins."""
    exposure = corner.expose(scene, variant, layout=layout, max_bounces=1)
    image, grid, rule = exposure.direct_image, Grid(layout.width, layout.height), gauss_rule(NODES)
    free = np.setdiff1d(np.flatnonzero(image.surface > 0), image.edges.pixels)
    pixels = np.unique(free[np.linspace(0, len(free) - 1, 40).astype(int)])
    found = np.concatenate(list(exposure.row_blocks())).reshape(-1, layout.bin_count)[pixels].astype(float)
    samples = sample_direct(scene, grid.points(pixels, rule.pixel_nodes).reshape(-1, 2), 1)
    light, opl_m = (each.astype(float).reshape(len(pixels), -1) for each in (samples.radiance, samples.opl_m))
    energy = light * rule.pixel_weights
    turns = phase_per_metre(corner.FREQUENCIES_HZ)
    exact = np.stack([(energy * np.exp(1j * k * opl_m)).sum(axis=1) for k in turns], axis=-1)
    place = (opl_m - layout.start_opl_m) / layout.bin_width_m
    return found, spread(place, energy, layout.bin_count), exact


def check(scene, variant, layout, wrong):
    """At most the share `wrong` is in wrong bins; phasors are right to 0.5 % of a faint object."""
    found, expected, exact = compared(scene, variant, layout)
    phi = MeasurementMatrix(
        corner.FREQUENCIES_HZ, layout.bin_count, layout.bin_width_m, layout.start_opl_m, splat="quadratic"
    )
    assert np.abs(found - expected).sum() < 2 * wrong * expected.sum()
    off = np.linalg.norm(phi.apply(found) - exact, axis=0) / np.linalg.norm(exact, axis=0)
    # 1.5e-6 is the residue of bins of 5 cm at 60 MHz over many places (`itof.splat_residue`).
    assert np.all(off < 0.005 * FAINT + (1e-6 if layout.bin_width_m > 0.01 else 0))


@pytest.mark.parametrize(
    ("width", "bin_width_m", "fov_deg", "roughness"),
    [
        (24, 0.01, 60, 0.3),
        (80, 0.01, 90, 0.3),
        (80, 0.05, 60, None),
        (80, 0.0025, 60, None),
        (240, 0.02, 90, 0.3),  # a single cell in a pixel, and more where that is not enough
    ],
)
def test_light_of_walls_is_in_the_right_bins(variant, tmp_path, width, bin_width_m, fov_deg, roughness):
    wall = corner.DIFFUSE if roughness is None else corner.rough_plastic(roughness)
    scene = OddCorner((), wall_bsdf=wall, fov_deg=fov_deg).load(tmp_path)
    end_m = 40 if fov_deg > 60 else 16  # of paths over the wall
    layout = TransientLayout(width, width * 3 // 4, int(end_m / bin_width_m), bin_width_m, 0.0)
    # The paths of a pixel of 24 columns to the edge of its wall change by whole bins from node to node here.
    check(scene, variant, layout, wrong=1e-3)


@pytest.mark.parametrize("seed", [2, pytest.param(5, marks=pytest.mark.long)])
def test_light_of_random_corners_is_in_the_right_bins(maker, variant, seed):
    scene = random_corner(seed, width=48, height=36)
    layout = TransientLayout(48, 36, 4000, 0.01, 0.0)
    check(loaded_corner(maker, scene, variant), variant, layout, wrong=1e-3)
