"""Pixels that an edge crosses: phasors, transients and brute force agree."""

from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import CAMERA_LOCATION_M, FREQUENCIES_HZ, GAP_M, ball, expose, relative, rough_plastic
from odd_corners import OddCorner
from small_patch import AXES

from itof import MeasurementMatrix, TransientLayout, pixel_rays
from render.options import ManyLightOptions
from render.transport.many_light import hidden_rule

LAYOUT = TransientLayout(24, 18, 2000, 0.01, 0.0)
BRUTE = 64  # nodes in the width and in the height of a pixel


def wide_corner(fov_deg, roughness=0.5):
    return OddCorner((ball(),), wall_bsdf=rough_plastic(roughness), fov_deg=fov_deg)


def of_the_bins(exposure):
    phi = MeasurementMatrix(FREQUENCIES_HZ, LAYOUT.bin_count, LAYOUT.bin_width_m, splat="quadratic")
    return phi.apply(np.concatenate(list(exposure.row_blocks())))


@pytest.mark.parametrize(
    "fov_deg", [67, pytest.param(75, marks=pytest.mark.thorough), pytest.param(90, marks=pytest.mark.long)]
)
def test_phasors_and_transients_agree_where_the_middle_wall_enters_the_picture(variant, tmp_path, fov_deg):
    exposure = expose(wide_corner(fov_deg).load(tmp_path), variant, lights=512, layout=LAYOUT)
    edges = exposure._direct.edges
    assert len(edges.pixels) == LAYOUT.height  # one column
    exact, binned = exposure.phasors(), of_the_bins(exposure)
    norm = np.linalg.norm(exact.hidden, axis=(0, 1))
    assert np.all(np.linalg.norm(binned - exact.total, axis=(0, 1)) < 0.005 * norm)
    # Also in the pixels with the edge alone, of which each is 8 degrees wide.
    there = np.unravel_index(edges.pixels, exact.hidden.shape[:2])
    off = np.linalg.norm((binned - exact.total)[there], axis=0)
    assert np.all(off < 0.05 * np.linalg.norm(exact.hidden[there], axis=0))


@pytest.mark.parametrize(("fov_deg", "roughness"), [(67, 0.5), pytest.param(90, 0.3, marks=pytest.mark.long)])
def test_pixels_with_an_edge_are_averages_over_64_by_64_nodes(variant, tmp_path, fov_deg, roughness):
    from render.transport.passes.direct_samples import direct_phasors_of, sample_direct

    exposure = expose(wide_corner(fov_deg, roughness).load(tmp_path), variant, lights=64, layout=LAYOUT)
    image, edges = exposure.phasors(), exposure._direct.edges
    middles = (np.arange(BRUTE) + 0.5) / BRUTE
    nodes = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
    for pixel in edges.pixels[[0, 7, 17]]:
        points = exposure._grid.points(np.array([pixel]), nodes)[0]
        direct = direct_phasors_of(sample_direct(exposure.scene, points, 1), FREQUENCIES_HZ).mean(axis=0)
        hidden = exposure.field._exact(points).mean(axis=0)
        at = np.unravel_index(pixel, image.hidden.shape[:2])
        # A vertical edge is known to a column of nodes here, at most 1/128 of the pixel, where the wall is as
        # bright as at most twice its mean.
        np.testing.assert_allclose(image.direct[at], direct, atol=2 / 128 * np.abs(direct).max())
        # The hidden part is that of four points for each surface; the pixel is 8 degrees wide.
        np.testing.assert_allclose(image.hidden[at], hidden, atol=0.06 * np.abs(hidden).max())


@pytest.mark.parametrize("fov_deg", [67, pytest.param(90, marks=pytest.mark.long)])
def test_the_direct_return_of_a_pixel_with_an_edge_has_the_area_before_it(variant, tmp_path, fov_deg):
    # Against one-dimensional Gauss quadrature up to the edge, which is vertical: its place is known.
    from render.transport.passes.direct_samples import direct_phasors_of, sample_direct

    exposure = expose(wide_corner(fov_deg).load(tmp_path), variant, lights=16, layout=LAYOUT)
    image, edges = exposure.phasors(), exposure._direct.edges
    ray = AXES @ (np.array([GAP_M, 0.0, CAMERA_LOCATION_M[2]]) - CAMERA_LOCATION_M)  # past the edge
    edge_x = (ray[0] / ray[2] / np.tan(np.radians(fov_deg) / 2) + 1) / 2 * LAYOUT.width  # in pixels
    column = int(edge_x)
    np.testing.assert_array_equal(edges.pixels % LAYOUT.width, column)
    share = edge_x - column  # the left part of the pixel sees the wall
    x, weight = np.polynomial.legendre.leggauss(12)
    x, weight = (x + 1) / 2, weight / 2
    nodes = np.stack(np.meshgrid(share * x, x), axis=-1).reshape(-1, 2)
    weights = np.outer(weight, share * weight).ravel()
    for pixel in edges.pixels:
        points = exposure._grid.points(np.array([pixel]), nodes)[0]
        z = direct_phasors_of(sample_direct(exposure.scene, points, 1), FREQUENCIES_HZ)
        at = np.unravel_index(pixel, image.direct.shape[:2])
        # 1e-5 of the pixel (film/edge_pixels.py), of light that is at most twice the mean of its seen part.
        bright = np.abs(z).max()
        np.testing.assert_allclose(image.direct[at], weights @ z, atol=1.5e-5 * bright)


def test_the_hidden_part_of_a_wide_picture_agrees_with_every_pixel_computed(variant, tmp_path):
    exposure = expose(wide_corner(75).load(tmp_path), variant, lights=256, layout=LAYOUT)
    found = exposure.phasors().hidden
    field = replace(exposure.field, lattice=None)
    exact = field.image(exposure._grid, hidden_rule(LAYOUT.width), exposure._direct).phasors
    assert np.all(relative(found, exact) < 0.25 * exposure.error * 1.5)


def test_an_edge_between_the_last_node_and_the_border_of_the_image_is_found(variant, tmp_path):
    # The wall ends 0.4 % of a pixel before the right border: beyond the nodes, and without a neighbour.
    corner = OddCorner((ball(),), fov_deg=72, size=(8, 6), wall_half_m=3.0, has_middle_wall=False)
    layout = TransientLayout(8, 6, 3000, 0.005, 0.0)
    exposure = expose(corner.load(tmp_path), variant, lights=64, layout=layout)
    ray = AXES @ (np.array([0.0, 3.0, CAMERA_LOCATION_M[2]]) - CAMERA_LOCATION_M)
    edge_x = (ray[0] / ray[2] / np.tan(np.radians(36)) + 1) / 2 * layout.width  # in pixels
    assert 7.99 < edge_x < 7.999
    edges = exposure._direct.edges
    np.testing.assert_array_equal(edges.pixels, 8 * np.arange(6) + 7)
    lit = exposure._direct.edge_samples.radiance > 0
    share = np.bincount(edges.pixel[lit], edges.weights[lit])[edges.pixels]
    np.testing.assert_allclose(share, edge_x - 7, atol=3e-5)


def test_a_lamp_beside_the_camera_still_casts_shadows(variant, tmp_path):
    # The middle wall's edge is the line x = GAP_M, y = 0. A lamp at (2.5, -1) lights the wall up to where its
    # ray past this edge meets x = 0.
    lamp = np.array([2.5, -1.0, CAMERA_LOCATION_M[2]])
    light = {"type": "point", "position": lamp.tolist(), "intensity": {"type": "uniform", "value": 1.0}}
    scene = OddCorner(other_emitter=light, has_middle_wall=True).load(tmp_path)
    image = expose(scene, variant, lights=16, layout=LAYOUT).phasors()
    shadow_y = lamp[1] - lamp[1] / (lamp[0] - GAP_M) * lamp[0]
    half_pixel = np.tan(np.radians(60) / 2) / LAYOUT.width
    rays = pixel_rays(LAYOUT.width, LAYOUT.height, 60)
    ends = []
    for side in (-half_pixel, half_pixel):
        at = (rays / rays[..., 2:] + np.array([side, 0, 0])) @ AXES
        ends.append(CAMERA_LOCATION_M[1] - CAMERA_LOCATION_M[0] * at[..., 1] / at[..., 0])
    lit = np.abs(image.direct[..., 0]) > 0
    dark = np.minimum(*ends) > shadow_y
    assert dark.sum() > 10
    assert not lit[dark].any()
    assert lit[np.maximum(*ends) < shadow_y].all()


@pytest.mark.parametrize("error", [0.04, 0.1])
def test_coarser_edges_cost_a_small_part_of_the_wanted_error(variant, tmp_path, error):
    fine = expose(wide_corner(67).load(tmp_path), variant, lights=512, layout=LAYOUT)
    coarse = replace(fine, edge_divisions=ManyLightOptions(error=error).edge_divisions)
    exact, found = fine.phasors(), coarse.phasors()
    assert len(coarse._direct.edges.points) < 0.6 * len(fine._direct.edges.points)
    off = np.linalg.norm(found.total - exact.total, axis=(0, 1))
    # Beside the wanted error, an independent tenth of it changes the sum of squares by 1 %.
    assert np.all(off < error / 10 * np.linalg.norm(exact.hidden, axis=(0, 1)))
