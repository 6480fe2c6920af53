"""Pixels that an edge crosses, and grazing ones: phasors, transients, brute force and polygons agree."""

from dataclasses import replace

import numpy as np
import pytest
from batch_quadrature import free_nodes
from many_light_scenes import CAMERA_LOCATION_M, FREQUENCIES_HZ, GAP_M, ball, expose, relative, rough_plastic
from odd_corners import OddCorner, behind_a_gap, corner_of, loaded_corner, random_corner
from scipy.ndimage import binary_dilation
from small_patch import AXES

from itof import MeasurementMatrix, TransientLayout, pixel_rays
from render.options import ManyLightOptions
from render.transport.film.pixels import Grid, gauss_rule, group_sums
from render.transport.many_light import hidden_rule
from render.transport.passes.node_counts import RULE_ERROR, PixelRange, needed_order
from render.walls.corners import Corners
from render.walls.pixel_lines import crossed_pixels
from render.walls.pixel_lines import free_nodes as nodes_of_lines

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
    edges = exposure.direct_image.edges
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
    image, edges = exposure.phasors(), exposure.direct_image.edges
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
    image, edges = exposure.phasors(), exposure.direct_image.edges
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
        # Walls and rays in float32 know the edge to 1e-7 of the film, of 24 pixels.
        np.testing.assert_allclose(image.direct[at], weights @ z, atol=24e-7 * np.abs(z).max())


def test_the_hidden_part_of_a_wide_picture_agrees_with_every_pixel_computed(variant, tmp_path):
    exposure = expose(wide_corner(75).load(tmp_path), variant, lights=256, layout=LAYOUT)
    found = exposure.phasors().hidden
    field = replace(exposure.field, lattice=None)
    exact = field.image(
        exposure._grid, hidden_rule(LAYOUT.width), exposure.direct_image, 0.1 * exposure.wanted
    ).phasors
    # A quarter for the lattice, and half as much again for a whole image (test_lattice_scenes).
    assert np.all(relative(found, exact) < 0.25 * exposure.error * 1.5)


def test_an_edge_between_the_last_node_and_the_border_of_the_image_is_found(variant, tmp_path):
    # The wall ends 0.4 % of a pixel before the right border: beyond the nodes, and without a neighbour.
    corner = OddCorner((ball(),), fov_deg=72, size=(8, 6), wall_half_m=3.0, has_middle_wall=False)
    layout = TransientLayout(8, 6, 3000, 0.005, 0.0)
    exposure = expose(corner.load(tmp_path), variant, lights=64, layout=layout)
    ray = AXES @ (np.array([0.0, 3.0, CAMERA_LOCATION_M[2]]) - CAMERA_LOCATION_M)
    edge_x = (ray[0] / ray[2] / np.tan(np.radians(36)) + 1) / 2 * layout.width  # in pixels
    assert 7.99 < edge_x < 7.999
    edges = exposure.direct_image.edges
    np.testing.assert_array_equal(edges.pixels, 8 * np.arange(6) + 7)
    lit = exposure.direct_image.edge_samples.radiance > 0
    share = np.bincount(edges.pixel[lit], edges.weights[lit])[edges.pixels]
    np.testing.assert_allclose(share, edge_x - 7, atol=3e-5)  # as in test_edge_pixels


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
    # A third thing in the scene, out of view: edges are then looked for with rays.
    corner = wide_corner(67).but(blockers=(ball(1, 0.05, (3, 3, 3)),))
    fine = expose(corner.load(tmp_path), variant, lights=512, layout=LAYOUT)
    coarse = replace(fine, edge_divisions=ManyLightOptions(error=error).edge_divisions)
    exact, found = fine.phasors(), coarse.phasors()
    # One division less is half as many nodes, and some more where edges cross.
    assert len(coarse.direct_image.edges.points) < 0.6 * len(fine.direct_image.edges.points)
    off = np.linalg.norm(found.total - exact.total, axis=(0, 1))
    # Beside the wanted error, an independent tenth of it changes the sum of squares by 1 %.
    assert np.all(off < error / 10 * np.linalg.norm(exact.hidden, axis=(0, 1)))


# A middle wall that ends in view and a rolled camera, and walls that end in view in random corners.
LOW_WALL = {"size_m": [2.2, 2.5], "location_m": [1.75, 0.0, 1.25], "rotation_deg": [82.0, 6.0, -10.0]}
WITH_EDGES = {
    "low wall": lambda *size: corner_of(
        *size,
        camera={"horizontal_fov_deg": 62.5, "rotation_deg": [90.0, 110.0, 35.0]},
        middle_wall=LOW_WALL,
    ),
    **{
        f"seed {seed}": lambda width, height, seed=seed: random_corner(seed, width=width, height=height)
        for seed in (2, 1, 5, 9)
    },
}


def summed(values, weights, pixel, count):
    return group_sums(values * weights[:, None], pixel, count)


@pytest.mark.parametrize(
    "name",
    [*list(WITH_EDGES)[:2], *(pytest.param(name, marks=pytest.mark.long) for name in list(WITH_EDGES)[2:])],
)
def test_pixels_with_an_edge_have_the_light_of_their_visible_polygons(variant, maker, name):
    from render.transport.passes.direct_samples import direct_phasors_of, sample_direct

    size = (LAYOUT.width, LAYOUT.height)
    corner = WITH_EDGES[name](*size)
    exposure = expose(loaded_corner(maker, corner, variant), variant, lights=64, layout=LAYOUT)
    exposure = replace(exposure, wanted=0.005)  # a tenth of it is for the nodes of pixels beside the edge
    image, direct = exposure.phasors(), exposure.direct_image
    *_, pixel, edges = free_nodes(corner, *size, 1, 1)
    np.testing.assert_array_equal(direct.edges.pixels, edges)
    assert len(edges) > 10
    np.testing.assert_array_equal(np.flatnonzero(direct.surface), np.unique(pixel))
    points, weights, pixel, _ = free_nodes(corner, *size, 6, 8, edges)
    expected = summed(exposure.field._exact(points), weights, pixel, direct.surface.size)[edges]
    hidden = image.hidden.reshape(-1, len(FREQUENCIES_HZ))[edges]
    # By four times the change from a linear to a quadratic polynomial, far below the error of the lights.
    off, whole = np.linalg.norm(hidden - expected, axis=0), np.linalg.norm(image.hidden, axis=(0, 1))
    assert np.all(off < exposure._hidden.missed)
    assert np.all(exposure._hidden.missed < 1e-3 * whole)
    z = direct_phasors_of(sample_direct(exposure.scene, points, 1), FREQUENCIES_HZ)
    expected = summed(z, weights, pixel, direct.surface.size)[edges]
    found = image.direct.reshape(-1, len(FREQUENCIES_HZ))[edges]
    assert np.all(np.linalg.norm(found - expected, axis=0) < direct.missed)
    stated = np.hypot(exposure._hidden.missed, direct.missed) / whole
    assert exposure.error >= np.hypot(exposure.field.error, stated.max())


def test_pixels_beside_an_edge_have_nodes_for_the_shadow_that_falls_into_them(variant, maker):
    corner = random_corner(86, width=LAYOUT.width, height=LAYOUT.height)
    exposure = expose(loaded_corner(maker, corner, variant), variant, lights=256, layout=LAYOUT)
    image, direct = exposure.phasors(), exposure.direct_image
    near = np.zeros(direct.surface.shape, bool)
    near.flat[direct.edges.pixels] = True
    near = np.flatnonzero(binary_dilation(near, iterations=2) & (direct.surface > 0))
    rule = gauss_rule(16)
    values = exposure.field._exact(exposure._grid.points(near, rule.pixel_nodes).reshape(-1, 2))
    expected = np.einsum("pnf,n->pf", values.reshape(len(near), rule.count, -1), rule.pixel_weights)
    off = np.linalg.norm(image.hidden.reshape(-1, len(FREQUENCIES_HZ))[near] - expected, axis=0)
    whole = np.linalg.norm(image.hidden, axis=(0, 1))
    # Two nodes in x and in y are off by 2.7 % of the image.
    assert np.all(off < exposure._hidden.missed)
    assert np.all(exposure._hidden.missed < 0.01 * whole)


def rolled(width, height):
    view = {"horizontal_fov_deg": 100.0, "rotation_deg": [90.0, 80.0, 50.0]}
    return random_corner(22, width=width, height=height, **view)


@pytest.mark.parametrize(
    ("make", "hertz"),
    [
        pytest.param(rolled, (300e6,), id="rolled", marks=pytest.mark.long),
        pytest.param(lambda *size: behind_a_gap(*size, 0.1), (60e6,), id="gap"),
    ],
)
def test_grazing_pixels_have_nodes_for_their_phase(variant, maker, make, hertz):
    from render.transport.passes.direct_pass import gather_direct
    from render.transport.passes.direct_samples import direct_phasors_of, sample_direct

    size = (40, 30)
    corner = make(*size)
    scene = loaded_corner(maker, corner, variant)
    found = gather_direct(scene, Grid(*size), hertz, 1, edge_divisions=7)
    points, weights, pixel, edges = free_nodes(corner, *size, 24, 12)
    z = direct_phasors_of(sample_direct(scene, points, 1), hertz)
    expected, flat = summed(z, weights, pixel, size[0] * size[1]), found.phasors.reshape(-1, 1)
    assert np.linalg.norm(flat - expected) < found.missed[0] < 1e-6 * np.linalg.norm(expected)
    whole = np.setdiff1d(pixel, edges)
    own = np.abs(flat - expected)[whole] / np.abs(expected)[whole]
    # The largest paths, 40 m, are known to 2^-19 m, of 2 pi / m; the hidden light is 1e-3 of such a pixel.
    assert own.max() < 1e-4


def test_light_of_pixels_behind_a_narrow_gap_alone_has_a_known_error(variant, maker):
    size = (LAYOUT.width, LAYOUT.height)
    scene = loaded_corner(maker, behind_a_gap(*size, 0.03), variant)
    exposures = [expose(scene, variant, lights=512, seed=seed, layout=LAYOUT) for seed in (1, 2)]
    assert len(exposures[0].field.lights) > 300
    # The nodes of the coarsest lattice are dark. What other lights change is the error of both.
    one, other = (exposure.phasors().hidden for exposure in exposures)
    both = np.hypot(*(exposure.field.error for exposure in exposures))
    assert 0.1 * both < relative(one, other).max() < both


def test_light_that_too_few_points_see_to_know_its_error_is_refused(variant, maker):
    from disk import NightError

    size = (LAYOUT.width, LAYOUT.height)
    scene = loaded_corner(maker, behind_a_gap(*size, 0.001), variant)
    with pytest.raises(NightError, match="it reaches 0 of 20769 points of the image"):
        expose(scene, variant, lights=512, layout=LAYOUT)


@pytest.mark.parametrize("phase", [0.1, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("ratio", [1.01, 1.5, 4.0])
def test_enough_nodes_are_taken_for_the_light_of_a_plane_towards_its_horizon(phase, ratio):
    # Over a pixel, the path is near / (1 - s x), and the radiance falls with its third power.
    slope = (ratio - 1) / ratio
    near_m = 2.0
    hertz = (phase / (near_m * (ratio - 1)) * 299_792_458 / (2 * np.pi),)

    def light(order):
        x, weight = np.polynomial.legendre.leggauss(order)
        path_m = near_m / (1 - slope * (x + 1) / 2)
        return path_m, (near_m / path_m) ** 3, weight / 2

    def mean(order):
        path_m, radiance, weight = light(order)
        return weight @ (radiance * np.exp(2j * np.pi * hertz[0] / 299_792_458 * path_m))

    order = 2
    while True:
        path_m, radiance, weight = light(order)
        ends = (path_m.min(), path_m.max(), radiance.min(), radiance.max())
        needed = needed_order(PixelRange(*(np.array([end]) for end in ends)).change(hertz, order))[0]
        if needed <= order:
            break
        order *= 2
    assert abs(mean(order) - mean(200)) < 3 * RULE_ERROR * (weight @ radiance)


def test_parts_of_pixels_have_their_area_also_at_corners_of_walls():
    area = np.zeros((2, 432))
    for seed in (1, 2, 4, 10):
        corner = random_corner(seed, width=24, height=18)
        corners = Corners.of([corner])
        _, weights, pixel = nodes_of_lines(corners, crossed_pixels(corners, 24, 18), 24, 18, 2)
        area[0] = np.bincount(pixel, weights, 432)
        _, weights, pixel, edges = free_nodes(corner, 24, 18, 1, 1)
        area[1] = np.bincount(pixel, weights, 432)
        assert len(edges) == 0 or np.abs(area[0] - area[1])[edges].max() < 1e-9
