"""Many lights against a closed form, and by conservation laws and symmetries."""

import numpy as np
import pytest
import trimesh
from many_light_scenes import (
    BLACK,
    CAMERA_LOCATION_M,
    GAP_M,
    HORIZONTAL_FOV_DEG,
    LAYOUT,
    SMALL,
    Corner,
    ball,
    box,
    measure,
    relative,
    rough_plastic,
    square,
    two_sided,
)
from small_patch import AXES, CORNER, patch_phasors

from itof import pixel_rays

# Closed form


@pytest.mark.parametrize("order", [20, 40])
def test_the_quadrature_has_converged(order):
    np.testing.assert_allclose(patch_phasors(LAYOUT, order), patch_phasors(LAYOUT, 30), rtol=1e-8)


@pytest.mark.parametrize("seed", range(2))
def test_a_small_patch_has_the_hidden_phasors_of_the_three_bounce_integral(variant, tmp_path, seed):
    expected = patch_phasors(LAYOUT)
    hidden = measure(CORNER.load(tmp_path), variant, lights=1024, seed=seed).hidden
    # The error of 1024 lights is below 0.1 % (test_many_light_error.py); five times that in any pixel.
    np.testing.assert_allclose(hidden.sum(axis=(0, 1)), expected.sum(axis=(0, 1)), rtol=0.005)
    np.testing.assert_allclose(hidden, expected, rtol=0.005)


# Conservation and symmetry


def test_twice_the_emitter_gives_twice_the_signal(variant, tmp_path):
    corner = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    one, two = (
        measure(corner.but(emitter_scale=scale).load(tmp_path), variant, lights=256, layout=SMALL)
        for scale in (1.0, 2.0)
    )
    # A power of two changes no mantissa.
    for name in ("direct", "hidden", "total"):
        np.testing.assert_allclose(getattr(two, name), 2 * getattr(one, name), rtol=1e-12)
    assert two.error == pytest.approx(one.error, rel=1e-6)


def test_a_scene_mirrored_in_z_gives_the_image_upside_down(variant, tmp_path):
    mirror = trimesh.transformations.reflection_matrix(CAMERA_LOCATION_M, [0, 0, 1])
    solid = box((0.5, 0.3, 0.4), centre=(1.15, 0.9, 1.9))
    corner = Corner((solid,), wall_bsdf=rough_plastic(0.5))
    upright = measure(corner.load(tmp_path), variant, layout=SMALL)
    twin = corner.but(hidden=(solid.copy().apply_transform(mirror),))
    flipped = measure(twin.load(tmp_path), variant, layout=SMALL)
    assert relative(upright.hidden[::-1], upright.hidden).max() > 0.05  # the flip is no identity
    allowed = np.hypot(upright.error, flipped.error)  # bounds that hold in 95 of 100 cases
    assert allowed < 0.03
    assert np.all(relative(flipped.hidden[::-1], upright.hidden) < allowed)
    np.testing.assert_allclose(flipped.direct[::-1], upright.direct, rtol=1e-5)  # float32 rays


@pytest.mark.parametrize(
    ("motion", "tolerance"),
    [
        # Distances of coordinates near 8 m in float32: 8 * 6e-8 m against 5 m paths and 1e-6 m mesh corners.
        (trimesh.transformations.translation_matrix([2, -4, 8]), 1e-3),
        # Turned, the surface is sampled in another order: three sigma of the error of 1024 points.
        (trimesh.transformations.euler_matrix(0.7, -0.4, 2.1), None),
    ],
    ids=["translation", "rotation"],
)
def test_moving_everything_together_changes_nothing(variant, tmp_path, motion, tolerance):
    corner = Corner((box(),), wall_bsdf=rough_plastic(0.5))
    still = measure(corner.load(tmp_path), variant, layout=SMALL)
    moved = measure(corner.but(moved=motion).load(tmp_path), variant, layout=SMALL)
    # Of one point in a pixel 1e-6; where the wall is seen at a grazing angle, more (no closed form).
    np.testing.assert_allclose(moved.direct, still.direct, rtol=1e-4)
    allowed = tolerance or 1.5 * np.hypot(moved.error, still.error)
    assert np.all(relative(moved.hidden, still.hidden) < allowed)


def test_without_a_hidden_object_the_hidden_signal_is_exactly_zero(variant, tmp_path):
    image = measure(Corner(wall_bsdf=rough_plastic(0.5)).load(tmp_path), variant)
    assert np.all(image.hidden == 0)
    assert image.error is None
    np.testing.assert_array_equal(image.total, image.direct)
    assert np.all(np.abs(image.direct) > 0)


def test_a_black_hidden_object_sends_no_hidden_signal(variant, tmp_path):
    image = measure(Corner((ball(),), hidden_bsdf=BLACK).load(tmp_path), variant, layout=SMALL)
    assert np.all(image.hidden == 0)
    np.testing.assert_array_equal(image.total, image.direct)


def test_half_the_reflectance_gives_half_the_hidden_signal(variant, tmp_path):
    corner = Corner((ball(),))
    full, half = (
        measure(corner.but(hidden_bsdf=bsdf).load(tmp_path), variant, lights=256, layout=SMALL)
        for bsdf in (corner.hidden_bsdf, two_sided("diffuse", reflectance=0.5))
    )
    # The reflectance is read by evaluating the BSDF in float32.
    np.testing.assert_allclose(2 * half.hidden, full.hidden, rtol=1e-5)


def test_the_middle_wall_shades_exactly_the_pixels_behind_it(variant, tmp_path):
    side_m = 0.05
    centre = np.array([1.3, 0.3, 1.65])
    corner = Corner((square(centre, (-1, 0.0, 0.0), side_m),))
    hidden, open_hidden = (
        np.abs(measure(one.load(tmp_path), variant, lights=256).hidden[..., 0])
        for one in (corner, corner.but(has_middle_wall=False))
    )
    edges_y = []
    for side in (-0.5, 0.5):
        x, y = centre[0], centre[1] + side * side_m
        edges_y.append(-GAP_M * y / (x - GAP_M))  # the ray from (x, y) past the corner of the middle wall
    half_pixel = np.tan(np.radians(HORIZONTAL_FOV_DEG) / 2) / LAYOUT.width
    centres = pixel_rays(LAYOUT.width, LAYOUT.height, HORIZONTAL_FOV_DEG)
    centres = centres / centres[..., 2:]
    wall_y = []
    for side in (-1, 1):
        rays = (centres + np.array([side * half_pixel, 0, 0])) @ AXES
        wall_y.append(CAMERA_LOCATION_M[1] - CAMERA_LOCATION_M[0] * rays[..., 1] / rays[..., 0])
    shaded = np.maximum(*wall_y) < min(edges_y)
    lit = np.minimum(*wall_y) > max(edges_y)
    assert shaded.sum() > 50
    assert lit.sum() > 50
    assert np.all(open_hidden > 0)
    np.testing.assert_array_equal(hidden[shaded], 0)
    assert np.all(hidden[lit] > 0)
    assert np.all(hidden[lit] < open_hidden[lit])  # the wall also keeps light from the patch
