"""Fit of the relay wall's plane and of phase offsets: closed forms, invariances, noise and outliers."""

import numpy as np
import pytest
from wall_measurements import FOV_DEG, FREQUENCIES_HZ, SLANTED, moved, noise, returned, wall_of_plane

from itof import direct_phasors
from itof.light import OFFSET_STD_RAD
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_fit import MOST_PIXELS, fit_wall
from itof.wall.wall_search import found, locate_wall, plane_from_nothing

OFFSETS_RAD = np.array([0.3, -0.005, 0.02])


@pytest.fixture(scope="module")
def wall():
    return wall_of_plane()


@pytest.mark.parametrize("known_rad", [1e-3, OFFSET_STD_RAD, np.inf])
def test_a_wall_alone_leaves_nothing(wall, known_rad):
    fit = fit_wall(wall.direct, wall, offset_std_rad=known_rad)
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


def test_offsets_of_which_nothing_is_known_are_found_beside_the_plane(wall):
    plane = moved(SLANTED, 0.01, 0.3)
    fit = fit_wall(returned(wall, plane, OFFSETS_RAD), wall, offset_std_rad=np.inf)
    np.testing.assert_allclose(fit.offsets_rad, OFFSETS_RAD, atol=1e-8)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)


@pytest.mark.parametrize("unit", [1e-30, 1e30])
def test_the_unit_of_a_measurement_does_not_matter(wall, unit):
    z = returned(wall, moved(SLANTED, 0.003, 0.2)) * (1 + 0.01 * noise(wall.direct.shape))
    one, other = fit_wall(z, wall), fit_wall(unit * z, wall)
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
    hot = rng.random(z.shape[:2]) < 0.1
    z[hot] *= 1e4 * np.exp(2j)  # of another phase
    z[rng.random(z.shape[:2]) < 0.1] = 0
    fit = fit_wall(z, wall)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)
    assert np.count_nonzero(fit.weight) == np.count_nonzero(z[..., 0])
    np.testing.assert_array_equal(fit.fits, (z[..., 0] != 0) & ~hot)


def smooth(shape, rms_rad, rng):
    """Phase errors (H, W, F) that are smooth over the image: random sums of waves of up to two halves."""
    y, x = (np.linspace(0, np.pi, size) for size in shape[:2])
    waves = [np.cos(i * y)[:, None] * np.cos(j * x) for i in range(3) for j in range(3)]
    error = np.tensordot(rng.standard_normal((shape[-1], 9)), waves, axes=1)  # (F, H, W)
    return np.moveaxis(rms_rad * error / np.sqrt((error**2).mean()), 0, -1)


@pytest.mark.parametrize(("noise_rad", "smooth_rad"), [(0.03, 0.0), (1e-4, 0.02), (0.01, 0.005)])
@pytest.mark.parametrize("known_rad", [0.005, OFFSET_STD_RAD])
def test_the_wall_is_within_what_is_stated(wall, noise_rad, smooth_rad, known_rad):
    off_m, off_deg = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        error = known_rad * rng.standard_normal(3) + smooth(wall.direct.shape, smooth_rad, rng)
        z = wall.direct * np.exp(1j * error) * (1 + noise_rad * noise(wall.direct.shape, seed))
        fit = fit_wall(z, wall, offset_std_rad=known_rad)
        off_m.append(fit.distance_shift_m / fit.distance_std_m)
        off_deg.append(fit.tilt_deg / fit.tilt_std_deg)
    # Each within two standard deviations in 95 % of the cases: of 40, 34 with a probability of 99 %.
    for times in (off_m, off_deg):
        assert np.count_nonzero(np.abs(times) < 2) >= 34
    # And nothing is stated that is far too large: the offsets are the prior's, or known better.
    assert fit.distance_std_m < 1.5 * known_rad / np.linalg.norm(wall.slope) + 0.02


def test_a_distance_is_known_as_well_as_the_offsets(wall):
    z = wall.direct * (1 + 1e-4 * noise(wall.direct.shape))
    std_m = [fit_wall(z, wall, offset_std_rad=rad).distance_std_m for rad in (1e-3, 0.01, 0.1, np.inf)]
    assert std_m == sorted(std_m)
    # Offsets that differ from frequency to frequency are a shift of their least squares, σ / |k|; smooth
    # errors come on top.
    assert 0.8 < std_m[2] / (0.1 / np.linalg.norm(wall.slope)) < 2
    assert fit_wall(z, wall).distance_is_known
    assert not fit_wall(z, wall, offset_std_rad=np.inf).distance_is_known


def test_offsets_that_no_calibrated_camera_has_are_any_offsets(wall):
    z = wall.direct * (1 + 0.01 * noise(wall.direct.shape))
    for offsets, known in ((OFFSETS_RAD / 3, True), (7 * OFFSETS_RAD, False)):
        fit = locate_wall(z * np.exp(1j * offsets), wall)
        assert found(fit)
        assert fit.distance_is_known == known
        assert (np.abs(fit.offsets_rad - offsets) < 3 * fit.offsets_std_rad).all()


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
    fit = fit_wall(returned(wall, plane), wall)
    np.testing.assert_allclose(fit.plane_per_m, plane, rtol=1e-8)
    assert fit.residual_rad.shape == wall.direct.shape


def test_means_over_pixels_have_the_phase_of_their_centres():
    # Where the direct return is a mean over pixels, a moved wall changes it as it changes the centre.
    camera = (np.eye(3), (0, 0, 0))
    normal = SLANTED / np.linalg.norm(SLANTED)
    places = [normal * distance_m for distance_m in (1.1, 1.105)]
    view = [direct_phasors(26, 18, FOV_DEG, FREQUENCIES_HZ, *camera, place, normal) for place in places]
    wall = ExpectedWall.of_camera(view[0], FREQUENCIES_HZ, FOV_DEG, *camera, places[0], normal)
    fit = fit_wall(view[1], wall, offset_std_rad=1e-5)
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
