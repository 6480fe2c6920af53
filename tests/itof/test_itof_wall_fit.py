"""Fit of the relay wall's plane and of phase offsets: closed forms, invariances, noise and outliers."""

import numpy as np
import pytest
from wall_measurements import FOV_DEG, FREQUENCIES_HZ, SLANTED, moved, noise, returned, wall_of_plane

from itof import direct_phasors
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_fit import MOST_PIXELS, fit_wall
from itof.wall.wall_search import found, locate_wall, plane_from_nothing

OFFSETS_RAD = np.array([0.3, -0.005, 0.02])


@pytest.fixture(scope="module")
def wall():
    return wall_of_plane()


@pytest.mark.parametrize("offsets", [False, True])
def test_a_wall_alone_leaves_nothing(wall, offsets):
    fit = fit_wall(wall.direct, wall, offsets=offsets)
    assert fit.max_shift_m < 1e-12
    assert np.abs(fit.offsets_rad).max() < 1e-12
    assert np.abs(fit.residual_rad).max() < 1e-12
    np.testing.assert_allclose(fit.coherence, 1, atol=1e-12)
    np.testing.assert_allclose(fit.wall_share, 1)


@pytest.mark.parametrize(("distance_m", "tilt_deg"), [(0.0001, 0.0), (-0.005, 0.5), (0.08, 3.0)])
def test_a_moved_and_tilted_wall_is_found_exactly(wall, distance_m, tilt_deg):
    plane = moved(SLANTED, distance_m, tilt_deg)
    fit = fit_wall(returned(wall, plane), wall)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-9)
    assert fit.distance_shift_m == pytest.approx(distance_m, abs=1e-10)
    assert fit.tilt_deg == pytest.approx(tilt_deg, abs=1e-8)
    assert np.abs(fit.residual_rad).max() < 1e-8
    # The misfit is the phase of the shift, 4π f / c times its mean along the rays.
    np.testing.assert_allclose(fit.misfit_rad, wall.slope * fit.mean_shift_m, rtol=1e-9)


def test_a_small_shift_is_the_linear_one_up_to_second_order(wall):
    step = moved(SLANTED, 0.002, 0.1) - SLANTED
    errors_m = []
    for size in (1.0, 0.5):
        fit = fit_wall(returned(wall, SLANTED + size * step), wall)
        linear_m = -(wall.radial_depth_m**2) * (wall.rays @ (size * step))
        errors_m.append(np.abs(fit.shift_m - linear_m).max())
    # The third order is the step itself: 2 mm of 1.1 m, and 0.1 degrees, which is below 1 %.
    assert errors_m[0] / errors_m[1] == pytest.approx(4, rel=0.02)


def test_phase_offsets_are_found_beside_the_plane(wall):
    plane = moved(SLANTED, 0.01, 0.3)
    fit = fit_wall(returned(wall, plane, OFFSETS_RAD), wall, offsets=True)
    np.testing.assert_allclose(fit.offsets_rad, OFFSETS_RAD, atol=1e-8)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)
    alone = fit_wall(returned(wall, plane), wall)
    assert np.count_nonzero(alone.offsets_rad) == np.count_nonzero(alone.offsets_std_rad) == 0


@pytest.mark.parametrize("unit", [1e-30, 1e30])
def test_the_unit_of_a_measurement_does_not_matter(wall, unit):
    z = returned(wall, moved(SLANTED, 0.003, 0.2)) * (1 + 0.01 * noise(wall.direct.shape))
    one, other = fit_wall(z, wall, offsets=True), fit_wall(unit * z, wall, offsets=True)
    np.testing.assert_allclose(other.plane_per_m, one.plane_per_m, rtol=1e-9)
    np.testing.assert_allclose(other.residual_rms_rad, one.residual_rms_rad, rtol=1e-9)
    np.testing.assert_allclose(other.coherence, one.coherence, rtol=1e-9)


def test_a_measured_direct_return_replaces_the_computed_one(wall):
    plane = moved(SLANTED, 0.05, 1.0)
    before = returned(wall, plane, OFFSETS_RAD)
    assert fit_wall(before, wall.captured(7 * before)).max_shift_m < 1e-12
    after = farther = before * np.exp(1j * wall.slope * 0.004 * (wall.radial_depth_m / 1.1)[..., None])
    assert fit_wall(farther, wall.captured(before)).mean_shift_m > 0.003
    assert fit_wall(after, wall.captured(after)).max_shift_m < 1e-12


def test_damaged_pixels_and_dark_ones_move_nothing(wall):
    plane = moved(SLANTED, 0.004, 0.2)
    z = returned(wall, plane)
    rng = np.random.default_rng(1)
    z[rng.random(z.shape[:2]) < 0.1] *= 1e4 * np.exp(2j)  # hot, of another phase
    z[rng.random(z.shape[:2]) < 0.1] = 0
    fit = fit_wall(z, wall, offsets=True)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)
    assert np.count_nonzero(fit.weight) == np.count_nonzero(z[..., 0])
    assert 0.05 < 1 - fit.fits.sum() / np.count_nonzero(fit.weight) < 0.15


def test_the_stated_uncertainty_is_that_of_repeated_measurements(wall):
    sigma = 0.01
    fits = [
        fit_wall(wall.direct * (1 + sigma * noise(wall.direct.shape, seed)), wall, offsets=True)
        for seed in range(80)
    ]
    found = np.std([fit.offsets_rad for fit in fits], axis=0)
    # The standard deviation of 80 draws is right within 8 %: 25 % are three of its own.
    np.testing.assert_allclose(np.mean([fit.offsets_std_rad for fit in fits], axis=0), found, rtol=0.25)
    np.testing.assert_allclose(np.mean([fit.residual_rms_rad for fit in fits], axis=0), sigma, rtol=0.1)


def test_a_fit_without_offsets_is_far_more_certain(wall):
    z = wall.direct * (1 + 0.01 * noise(wall.direct.shape))
    plane, both = fit_wall(z, wall), fit_wall(z, wall, offsets=True)
    assert plane.mean_shift_std_m < both.mean_shift_std_m / 4
    # So offsets are fitted only where they explain something.
    assert not locate_wall(z, wall).offsets_rad.any()
    fit = locate_wall(z * np.exp(1j * OFFSETS_RAD), wall)
    assert (np.abs(fit.offsets_rad - OFFSETS_RAD) < 4 * fit.offsets_std_rad).all()


@pytest.mark.parametrize("frequencies_hz", [FREQUENCIES_HZ, (20e6,)])
def test_a_wall_is_found_from_nothing(frequencies_hz):
    wall = wall_of_plane(frequencies_hz=frequencies_hz)
    there = np.array([0.1, -0.2, 0.35])  # 2.4 m away and turned by 59 degrees
    z = returned(wall, there)
    # Least absolute deviations of exact distances end at the plane itself.
    np.testing.assert_allclose(plane_from_nothing(z, wall), there, rtol=1e-6)
    fit = locate_wall(z, wall)
    assert found(fit)
    np.testing.assert_allclose(fit.plane_per_m, there, rtol=1e-8)


def test_phases_at_random_are_no_wall(wall):
    fit = locate_wall(noise(wall.direct.shape), wall)
    assert not found(fit)
    # Of random phases, 1 / 2π lie within 0.5 rad; the fit chooses the best of many planes.
    assert fit.wall_share.min() < 0.35


def test_a_large_image_is_fitted_by_some_of_its_pixels():
    wall = wall_of_plane(width=320, height=240)
    assert wall.direct[..., 0].size > 4 * MOST_PIXELS
    plane = moved(SLANTED, 0.003, 0.1)
    fit = fit_wall(returned(wall, plane), wall, offsets=True)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)
    assert fit.residual_rad.shape == wall.direct.shape


def test_means_over_pixels_have_the_phase_of_their_centres():
    # Where the direct return is a mean over pixels, a moved wall changes it as it changes the centre.
    camera = (np.eye(3), (0, 0, 0))
    normal = SLANTED / np.linalg.norm(SLANTED)
    places = [normal * distance_m for distance_m in (1.1, 1.105)]
    view = [direct_phasors(26, 18, FOV_DEG, FREQUENCIES_HZ, *camera, place, normal) for place in places]
    wall = ExpectedWall.of_camera(view[0], FREQUENCIES_HZ, FOV_DEG, *camera, places[0], normal)
    fit = fit_wall(view[1], wall)
    # In a pixel, distances differ by up to p = 0.05 of themselves: the shift of the mean by p² / 12 of it.
    assert fit.distance_shift_m == pytest.approx(0.005, rel=2e-4)
    assert fit.tilt_deg < 1e-4


def test_what_cannot_be_fitted_is_refused(wall):
    few = np.zeros_like(wall.direct)
    few[0, :5] = wall.direct[0, :5]
    for z, words in (
        (wall.direct[:-1], r"expected phasors of shape \(18, 26, 3\), got \(17, 26, 3\)"),
        (wall.direct * np.nan, "NaN or infinite"),
        (few, "5 pixels hold light: too few for a plane"),
    ):
        with pytest.raises(ValueError, match=words):
            fit_wall(z, wall)
    with pytest.raises(ValueError, match="no pixel holds light"):
        plane_from_nothing(0 * few, wall)
    assert locate_wall(few, wall) is None
    with pytest.raises(ValueError, match="in the plane of the wall"):
        ExpectedWall.of_camera(
            wall.direct, FREQUENCIES_HZ, FOV_DEG, np.eye(3), (0, 0, 0), (0, 1, 0), (0, 0, 1)
        )
