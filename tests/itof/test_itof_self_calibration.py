"""Self-calibrated channels: closed forms, invariances, and what of the hidden light they lose."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from many_light_scenes import CAMERA_LOCATION_M, DOWN, FORWARD, HORIZONTAL_FOV_DEG, RIGHT
from wall_measurements import FOV_DEG, FREQUENCIES_HZ, noise

from itof import direct_phasors, residual_channels
from itof.other_surfaces import ELSEWHERE_RAD
from itof.wall.expected_wall import ExpectedWall
from itof.wall.self_calibration import calibrate, phases_over
from itof.wall.wall_fit import WallFit

OFFSETS_RAD = np.array([0.005, -0.005, 0.005])
HIDDEN_RAD = 1e-3  # phase that hidden light causes; the paper's scenes have 1 to 3 mrad


def paper_wall(width, height, shift_m=0.0, tilt_deg=0.0):
    """(H, W, F) direct return of the paper's wall, moved and turned about the vertical; pixels are areas."""
    angle = np.radians(tilt_deg)
    camera = (np.array([RIGHT, DOWN, FORWARD]), CAMERA_LOCATION_M)
    place = ((shift_m, 0.0, 2.0), (np.cos(angle), np.sin(angle), 0.0))
    direct = direct_phasors(width, height, HORIZONTAL_FOV_DEG, FREQUENCIES_HZ, *camera, *place, subpixels=16)
    return ExpectedWall.of_camera(direct, FREQUENCIES_HZ, HORIZONTAL_FOV_DEG, *camera, *place)


@pytest.fixture(scope="module")
def wall():
    return paper_wall(40, 30)


def hidden(wall, seed=0):
    """(H, W, F) smooth relative change of the phasors, of the size and shape of hidden light."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: wall.rays.shape[0], : wall.rays.shape[1]]
    phases = [rng.uniform(0.1, 0.5) * x + rng.uniform(0.1, 0.5) * y + rng.uniform(0, 6) for _ in range(6)]
    waves = np.cos(phases)
    return 1 + HIDDEN_RAD * np.stack([a + 1j * b for a, b in zip(waves[::2], waves[1::2], strict=True)], -1)


def calibrated(phasor, wall, **options):
    """(..., H, W, F) direct return of the wall that the phasors show."""
    return calibrate(phasor, wall, **options).moved(phasor, wall)


def residual(phasor, wall):
    """(2F - 1, H, W) channels after the calibration."""
    return residual_channels(phasor, calibrated(phasor, wall))


@pytest.mark.parametrize(("shift_m", "tilt_deg"), [(0.0, 0.0), (-0.005, 0.5), (0.08, 3.0), (-0.3, 0.0)])
def test_plane_and_offsets_of_a_wall_alone_are_found(wall, shift_m, tilt_deg):
    other = paper_wall(40, 30, shift_m, tilt_deg)
    found = calibrate(other.direct * np.exp(1j * OFFSETS_RAD), wall)
    # To the mean over a pixel, the direct return is known up to higher moments of its paths.
    np.testing.assert_allclose(found.plane_per_m, other.plane_per_m, atol=5e-4)
    np.testing.assert_allclose(found.offsets_rad, OFFSETS_RAD, atol=HIDDEN_RAD / 3)
    assert found.wiggling_rad is None
    if not shift_m:
        np.testing.assert_allclose(found.plane_per_m, wall.plane_per_m, atol=1e-12)
        np.testing.assert_allclose(found.offsets_rad, OFFSETS_RAD, atol=1e-12)


def test_a_wall_that_was_never_measured_leaves_nothing_in_the_channels(wall):
    measured = paper_wall(40, 30, 0.01, 1.0).direct * np.exp(1j * OFFSETS_RAD)
    left = residual(measured, wall)
    assert np.sqrt((left**2).mean()) < HIDDEN_RAD / 30
    assert np.sqrt((residual_channels(measured, wall.direct) ** 2).mean()) > 30 * HIDDEN_RAD
    finer = residual(paper_wall(80, 60, 0.01, 1.0).direct * np.exp(1j * OFFSETS_RAD), paper_wall(80, 60))
    assert np.sqrt((left**2).mean() / (finer**2).mean()) > 3.5  # the pixel's second moments: its area


@pytest.mark.parametrize(("shift_m", "tilt_deg"), [(0.005, 0.0), (0.0, 0.5), (0.01, 1.0)])
def test_the_channels_of_hidden_light_do_not_depend_on_where_the_wall_is_nor_on_phase_offsets(
    wall, shift_m, tilt_deg
):
    light = hidden(wall)
    straight = residual(wall.direct * light, wall)
    other = paper_wall(40, 30, shift_m, tilt_deg).direct * np.exp(1j * OFFSETS_RAD)
    change = residual(other * light, wall) - straight
    # What the wall alone leaves (above), and as much for its tangents, which differ by 1 cm of 1 m.
    assert (np.sqrt((change**2).mean(axis=(1, 2))) < HIDDEN_RAD / 15).all()


def test_all_that_is_lost_of_the_hidden_light_is_a_plane_and_an_offset_per_frequency(wall):
    light = hidden(wall)
    z = wall.direct * light
    known, self_calibrated = (residual_channels(z, each) for each in (wall.direct, calibrated(z, wall)))
    lost = np.moveaxis(known[:3] - self_calibrated[:3], 0, -1)  # (H, W, F) of Im r_f
    tangent = -(wall.radial_depth_m**2)[..., None] * wall.rays  # (H, W, 3)
    columns = [(tangent[..., None, i] * wall.slope).ravel() for i in range(3)]
    columns += [np.broadcast_to(row, lost.shape).ravel() for row in np.eye(3)]
    basis = np.stack(columns, axis=-1)
    rest = lost.ravel() - basis @ np.linalg.lstsq(basis, lost.ravel(), rcond=None)[0]
    assert np.sqrt((lost**2).mean()) > HIDDEN_RAD / 20  # it is not nothing
    largest = 8 * HIDDEN_RAD * np.abs(lost).max()  # of second order
    assert np.abs(rest).max() < largest < HIDDEN_RAD / 100
    np.testing.assert_allclose(known[3:], self_calibrated[3:], atol=largest)  # Re r_f - Re r_0


@pytest.mark.parametrize(("shift_m", "tilt_deg"), [(0.01, 1.0), (0.02, 2.0), (-0.02, -2.0)])
def test_what_is_lost_does_not_depend_on_where_the_wall_is_expected(wall, shift_m, tilt_deg):
    y, x = np.mgrid[:30, :40] / 40
    waves = (2 * x + 1.5 * y + 1, 3 * x - y, 2.5 * x + 2 * y + 2)  # of which a plane can take much
    light = 1 + 3 * HIDDEN_RAD * np.exp(1j * np.stack(waves, axis=-1))
    elsewhere = paper_wall(40, 30, shift_m, tilt_deg)
    straight, moved = (
        residual(wall.direct * light, each) - residual(wall.direct, each) for each in (wall, elsewhere)
    )
    change, size = (np.sqrt((each**2).mean(axis=(1, 2))) for each in (moved - straight, straight))
    assert (change < 3 * HIDDEN_RAD * size).all()  # of second order in the light


def test_what_is_lost_does_not_depend_on_the_strength_of_the_hidden_light(wall):
    light = hidden(wall) - 1
    weak, strong = (residual(wall.direct * (1 + times * light), wall) for times in (0.5, 2.0))
    np.testing.assert_allclose(strong, 4 * weak, atol=20 * HIDDEN_RAD**2)


def test_a_capture_of_the_corner_loses_the_dimensions_that_the_computed_return_loses(wall):
    """A glossy wall is bright in one place; the pixels of a fit keep the weights of the expected wall."""
    y, x = np.mgrid[:30, :40]
    glossy = (1 + 4 * np.exp(-((x - 28) ** 2 + (y - 8) ** 2) / 50))[..., None]
    capture, light = wall.direct * glossy, hidden(wall)
    expected = residual(wall.direct * light, wall)
    found = residual(capture * light, wall.captured(capture))
    np.testing.assert_allclose(found, expected, atol=2**-20)  # float32 rounds numbers near 1, some ten times
    # With weights of its own, the fit would take another part of the hidden light.
    own = residual(capture * light, replace(wall, direct=capture))
    assert np.sqrt(((own - expected) ** 2).mean()) > 0.05 * HIDDEN_RAD


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_pixels_that_do_not_see_the_wall_do_not_move_it(wall, share):
    other = paper_wall(40, 30, 0.01, 0.5)
    z = other.direct.copy()
    rows = int(share * z.shape[0])
    z[:rows] = 3 * noise((rows, *z.shape[1:]))  # another thing, at any phase
    z[-1, 0] = 0  # and a dead pixel
    found = calibrate(z, wall)
    depth_m = 1 / (wall.rays @ found.plane_per_m)
    assert np.abs(depth_m / other.radial_depth_m - 1)[rows:].max() < 2e-3
    assert np.isfinite(found.moved(z, wall)).all()


def test_the_fit_is_the_minimum_over_all_pixels_also_beside_another_surface():
    """From a random corner, with the edge of the middle wall in view: another full step changes nothing."""
    wall = paper_wall(80, 60)
    rng = np.random.default_rng(0)
    for edge in (80, 68):
        shift_m, tilt_deg = rng.uniform(-0.1, 0.1), rng.uniform(-2, 2)
        other = paper_wall(80, 60, shift_m, tilt_deg)
        z = other.direct * hidden(other) * np.exp(1j * OFFSETS_RAD)
        z[:, edge:] = 0.6 * paper_wall(80, 60, shift_m + 0.5).direct[:, edge:]
        z[:, edge - 1] = (z[:, edge - 1] + z[:, edge - 2]) / 2
        fit, problem = calibrate(z, wall), phases_over(z, wall, wiggling=False)
        left = problem.residual(fit.plane_per_m, fit.offsets_rad[:, None])
        farthest = np.abs(left.left).max(axis=0)
        assert (farthest > ELSEWHERE_RAD).reshape(60, 80)[:, edge:].all()
        assert (farthest < 10 * HIDDEN_RAD).reshape(60, 80)[:, : edge - 2].all()
        share = (problem.pixels.expected_depth_m / left.depth_m) ** 3
        weight = problem.weight * (share * np.clip(1 - (farthest / ELSEWHERE_RAD) ** 2, 0, None)) ** 2
        step = np.linalg.solve(*problem.normal_equations(left, weight))
        turn = problem.pixels.slope * (step[:3] @ problem.pixels.tangent(left.depth_m)) + step[3:, None]
        assert np.sqrt((turn.reshape(3, 60, 80)[..., :edge] ** 2).mean()) < HIDDEN_RAD / 300


def test_images_without_a_wall_stay_finite(wall):
    images = np.stack([0 * wall.direct, noise(wall.direct.shape), wall.direct])
    found = calibrate(images, wall)
    direct = found.moved(images, wall)
    for array in (found.plane_per_m, found.offsets_rad, direct):
        assert np.isfinite(array).all()
    np.testing.assert_allclose(found.plane_per_m[0], wall.plane_per_m, atol=1e-9)
    np.testing.assert_allclose(direct[2], wall.direct, rtol=1e-9)


def test_the_four_cycle_error_of_a_square_wave_is_fitted_on_request(wall):
    phase, error = np.angle(wall.direct), 0.0
    for _ in range(5):  # the error is a function of the phase that has it
        cycles = 4 * (phase + error)
        error = 5e-3 * np.array([1.0, -0.5, 0.3]) * np.cos(cycles) + 2e-3 * np.sin(cycles)
    z = wall.direct * np.exp(1j * error)
    found = calibrate(z, wall, wiggling=True)
    # Each round leaves four times the error in radians of the one before: (4 * 5.4e-3)^5 = 5e-9.
    np.testing.assert_allclose(found.wiggling_rad[..., 0], 5e-3 * np.array([1.0, -0.5, 0.3]), rtol=1e-8)
    np.testing.assert_allclose(found.wiggling_rad[..., 1], 2e-3, rtol=1e-8)
    direct = found.moved(z, wall)
    np.testing.assert_allclose(direct, z, rtol=1e-6)
    assert np.abs(residual(z, wall)[:3]).max() > 30 * np.abs(np.angle(z / direct)).max()


def test_a_single_frequency_is_enough(wall):
    alone, measured = wall.at([1]), paper_wall(40, 30, 0.005, 0.2).at([1]).direct * np.exp(0.01j)
    assert np.sqrt((residual(measured, alone) ** 2).mean()) < HIDDEN_RAD / 30


def test_torch_and_numpy_agree_to_rounding_and_images_do_not_depend_on_their_batch(wall):
    walls = [paper_wall(40, 30, 0.01 * i, 0.3 * i) for i in range(3)]
    images = np.stack([each.direct for each in walls]) * hidden(wall) * np.exp(1j * OFFSETS_RAD)
    ours = calibrated(images, wall)
    theirs = calibrated(torch.from_numpy(images), wall.converted(torch.from_numpy))
    np.testing.assert_allclose(theirs.numpy(), ours, rtol=1e-9)
    for index in range(3):
        np.testing.assert_allclose(calibrated(images[index], wall), ours[index], rtol=1e-9)
    single = calibrated(
        torch.from_numpy(images.astype(np.complex64)),
        replace(wall.converted(torch.from_numpy), direct=torch.from_numpy(wall.direct.astype(np.complex64))),
    )
    assert single.dtype == torch.complex64
    np.testing.assert_allclose(single.numpy(), ours, rtol=2e-6)


@pytest.mark.parametrize("wiggling", [False, True])
def test_cameras_of_different_fields_of_view_are_calibrated_at_once(wiggling):
    found_m, moved_m = np.array([-0.45, 0.05, 0.4]), np.array([-0.44, 0.06, 0.41])
    views = [(fov_deg, 40, 30, FREQUENCIES_HZ) for fov_deg in (55.0, 60.0, 110.0)]
    walls = [ExpectedWall.of_plane(found_m, *size, fov_deg) for fov_deg, *size in views]
    assert np.isinf(walls[2].radial_depth_m).any()  # some rays of the widest camera miss it
    seen = [ExpectedWall.of_plane(moved_m, *size, fov_deg).direct for fov_deg, *size in views]
    images = np.stack(seen) * np.exp(1j * OFFSETS_RAD)
    stacked = ExpectedWall.stacked(walls)
    here = stacked.converted(torch.from_numpy)

    def found(phasor, wall):
        fit = calibrate(phasor, wall, wiggling=wiggling)
        waves = [fit.wiggling_rad] if wiggling else []
        return fit.plane_per_m, fit.offsets_rad, *waves, fit.moved(phasor, wall)

    ours, theirs = found(images, stacked), found(torch.from_numpy(images), here)
    alone = [found(*pair) for pair in zip(images, walls, strict=True)]
    for place, expected in enumerate(np.stack(each) for each in zip(*alone, strict=True)):
        np.testing.assert_allclose(ours[place], expected, rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(theirs[place].numpy(), expected, rtol=1e-7, atol=1e-10)


def test_only_walls_in_the_same_plane_are_stacked(wall):
    for others in ([], [wall, paper_wall(40, 30, 0.01)], [wall, wall.at([0, 1])]):
        with pytest.raises(ValueError, match="stack"):
            ExpectedWall.stacked(others)


def test_a_turned_reference_is_that_of_the_turned_wall(wall):
    other = paper_wall(40, 30, 0.01, 1.0)
    turn = wall.slope * (other.radial_depth_m - wall.radial_depth_m)[..., None]
    turned = WallFit(other.plane_per_m, np.zeros(3), None).moved(wall.direct, wall)
    plain = wall.direct * np.exp(1j * turn)
    left, before = (
        np.sqrt((residual_channels(other.direct, each) ** 2).mean(axis=(1, 2))) for each in (turned, plain)
    )
    assert (left[:3] < before[:3] / 2).all()  # phases
    assert (left[3:] < before[3:] / 50).all()  # how amplitudes differ between frequencies


def test_a_plane_that_cannot_be_is_refused():
    for plane in ([0.0, 0.0, 0.0], [np.nan, 0.0, 1.0]):
        with pytest.raises(ValueError, match="is no plane"):
            ExpectedWall.of_plane(plane, 4, 3, FREQUENCIES_HZ, FOV_DEG)
