"""Averages of frames with their noise, bins of pixels, and lenses."""

import numpy as np
import pytest
from captures import IMAGES, raw_of, sidecar_of, steps, taps_of
from scipy.stats import chi2
from wall_measurements import FREQUENCIES_HZ, noise, wall_of_plane

from itof import pixel_rays
from itof.capture.averaging import average
from itof.capture.binning import Binning
from itof.capture.capture import ImageShape, capture_of
from itof.capture.lens import Undistortion, seen_at, turning_point
from itof.capture.sidecar import CaptureError, Lens
from itof.sensor.demodulation import first_harmonic
from itof.sensor.noise import phase_noise_rad
from itof.sensor.settings import SensorSettings

PHASOR = wall_of_plane().direct  # (18, 26, 3)
CERTAIN = 1e-5  # chance of a false alarm


def averaged(frames, exposures_s=None):
    times = np.ones(len(frames)) if exposures_s is None else np.asarray(exposures_s)
    each = np.broadcast_to(times.reshape(len(frames), -1), (len(frames), len(FREQUENCIES_HZ)))
    return average(lambda: iter(frames), each, FREQUENCIES_HZ, "frames.npz")


def within_chi_squared(ratios, freedom):
    """Whether ratios of estimated and true variances, each of `freedom` degrees, agree with the truth."""
    total = freedom * ratios.size
    low, high = chi2.ppf([CERTAIN / 2, 1 - CERTAIN / 2], total)
    return low < freedom * ratios.sum() < high


def test_the_noise_of_a_mean_follows_from_its_frames():
    rng, count, sigma = np.random.default_rng(0), 9, 1e-3
    frames = PHASOR * (1 + sigma * np.stack([noise(PHASOR.shape, rng.integers(2**32)) for _ in range(count)]))
    found = averaged(frames)
    true = sigma / np.sqrt(count)  # of the phase: relative noise across the phasor
    assert within_chi_squared((found.noise_rad / true) ** 2, count - 1)
    error = np.angle(found.phasor / PHASOR)
    assert within_chi_squared((error / true) ** 2, 1)


@pytest.mark.parametrize("count", [2, 3, 10])
def test_the_noise_that_is_reported_is_the_true_one(tmp_path, count):
    sigma = 1e-3
    frames = PHASOR * (1 + sigma * np.stack([noise(PHASOR.shape, seed) for seed in range(count)]))
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors")
    found = capture_of(raw_of(sidecar, raw=frames), sidecar).facts.noise_rad
    # A median of P values has the standard deviation 1 / (2 p sqrt(P)) for their density p in the middle
    middle = chi2.ppf(0.5, count - 1)
    spread = 1 / (2 * chi2.pdf(middle, count - 1) * np.sqrt(PHASOR[..., 0].size)) / middle / 2
    np.testing.assert_allclose(np.array(found) * np.sqrt(count) / sigma, 1, atol=5 * spread)


def test_a_longer_exposure_counts_more():
    times = np.array([1.0, 4.0, 2.0, 8.0])
    frames = [
        PHASOR * (1 + 1e-3 / np.sqrt(time) * noise(PHASOR.shape, place)) for place, time in enumerate(times)
    ]
    found = averaged(frames, times)
    true = 1e-3 / np.sqrt(times.sum())
    assert within_chi_squared((np.angle(found.phasor / PHASOR) / true) ** 2, 1)
    assert within_chi_squared((found.noise_rad / true) ** 2, 3)


def test_drift_is_told_and_is_no_noise():
    drift = np.array([-0.02, 0.0, 0.02])[:, None] * np.array([1.0, 2.0, 3.0])  # (N, F)
    found = averaged(PHASOR * np.exp(1j * drift)[:, None, None])
    np.testing.assert_allclose(found.drift_rad, drift, atol=1e-12)
    assert found.noise_rad.max() < 1e-12


def test_one_frame_does_not_tell_its_noise():
    assert averaged(PHASOR[None]).noise_rad is None


def test_frames_of_other_exposures_are_refused_unless_their_times_are_told():
    with pytest.raises(
        CaptureError, match=r"frame 1 is 2 times as bright as frame 0: frames of mixed exposure"
    ):
        averaged([PHASOR, 2 * PHASOR])
    np.testing.assert_allclose(averaged([PHASOR, PHASOR], [1, 2]).phasor, PHASOR)


@pytest.mark.parametrize(
    ("factor", "words"), [(0.0, "frame 2 holds no light"), (2.0, "frame 2 is 2 times as bright as frame 0")]
)
def test_a_frame_that_differs_at_one_frequency_is_refused(factor, words):
    frames = np.repeat(PHASOR[None], 5, axis=0)
    frames[2, ..., 2] *= factor
    with pytest.raises(CaptureError, match=f"at {FREQUENCIES_HZ[2] / 1e6:g} MHz, {words}"):
        averaged(frames)


def test_each_frequency_may_have_its_own_exposure_times():
    times = np.array([[1.0, 2.0, 4.0], [8.0, 4.0, 2.0]])  # (N, F)
    spoilt = np.stack([0.97 * PHASOR, 1.03 * PHASOR])
    weights = times / times.sum(axis=0)
    np.testing.assert_allclose(
        averaged(spoilt, times).phasor, PHASOR * (weights * [[0.97], [1.03]]).sum(axis=0)
    )


# Bins


def all_good(shape):
    return np.ones(shape[:2], bool)


@pytest.mark.parametrize("side", [1, 2, 4])
def test_a_bin_is_the_mean_of_its_phasors(side):
    rng = np.random.default_rng(3)
    image = rng.standard_normal((12, 20, 2)) + 1j * rng.standard_normal((12, 20, 2))
    bins = Binning.of((20, 12), 60.0, bin_side=side)
    found = bins.of_pixels(all_good(image.shape)).mean(image)
    expected = image.reshape(12 // side, side, 20 // side, side, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(found, expected, atol=1e-14)
    assert bins.fov_deg(60.0) == pytest.approx(60.0)


@pytest.mark.parametrize("size", [(5, 3), (7, 4), (20, 9)])
def test_missing_pixels_and_cut_bins_do_not_move_the_place_that_a_bin_shows(size):
    row, column = np.mgrid[:30, :50] + 0.5  # centres of the sensor pixels
    image = ((2 + 1j) * row + (0.5 - 3j) * column)[..., None]  # linear: known at every place
    good = np.random.default_rng(4).random((30, 50)) > 0.2
    bins = Binning.of((50, 30), 60.0, size=size)
    found = bins.of_pixels(good).mean(np.where(good[..., None], image, 1e6))
    rows, columns = (
        (total - bins.side * count) / 2 + bins.side * (np.arange(count) + 0.5)
        for total, count in ((30, size[1]), (50, size[0]))
    )
    expected = (2 + 1j) * rows[:, None] + (0.5 - 3j) * columns
    if size == (20, 9):  # bins of 2.5 pixels: some have too few good pixels for a plane, and show their mean
        close = np.abs(found[..., 0] - expected) < 1e-9
        assert close.mean() > 0.9
        assert np.abs(found[..., 0] - expected).max() < 1.25 * np.hypot(2 + 1, 0.5 + 3)
    else:
        np.testing.assert_allclose(found[..., 0], expected, rtol=1e-9)


def test_a_bin_without_good_pixels_is_0():
    good = all_good((6, 8))
    good[:2, 2:4] = False
    found = Binning.of((8, 6), 60.0, bin_side=2).of_pixels(good).mean(np.ones((6, 8, 1), complex))
    expected = np.ones((3, 4))
    expected[0, 1] = 0
    np.testing.assert_allclose(found[..., 0], expected)


def test_a_smaller_field_of_view_is_cut_out_of_the_middle():
    rays = pixel_rays(80, 60, 90.0)
    tangent = (rays[..., :2] / rays[..., 2:]).sum(axis=-1)[..., None].astype(complex)
    bins = Binning.of((80, 60), 90.0, size=(10, 8), wanted_fov_deg=50.0)
    assert bins.fov_deg(90.0) == pytest.approx(50.0)
    found = bins.of_pixels(all_good((60, 80))).mean(tangent)
    inner = pixel_rays(10, 8, 50.0)
    np.testing.assert_allclose(found[..., 0].real, (inner[..., :2] / inner[..., 2:]).sum(axis=-1), atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"size": (30, 12)}, "images of 30x12 pixels cannot be binned from a sensor of 20x12"),
        ({"bin_side": 13}, "images of 1x0 pixels cannot be binned"),
        ({"bin_side": 2, "size": (10, 6)}, "a bin's side or an image size, not both"),
        ({"size": (10, 6), "wanted_fov_deg": 61.0}, "it allows at most 60 degrees"),
        ({"wanted_fov_deg": 40.0}, "at 20x12 pixels needs more pixels than the sensor has: give --size"),
        ({"bin_side": 2, "wanted_fov_deg": 40.0}, "not at a bin's side: give --size with --fov"),
    ],
)
def test_images_that_the_sensor_does_not_hold_are_refused(shape, words):
    with pytest.raises(CaptureError, match=words):
        Binning.of((20, 12), 60.0, **shape)


def test_images_of_less_than_a_degree_and_huge_sensors_are_refused():
    with pytest.raises(
        CaptureError, match=r"images of 1x120 pixels would be 0\.41 degrees wide, and 1 degree is"
    ):
        Binning.of((160, 120), 60.0, size=(1, 120))
    with pytest.raises(CaptureError, match="the frames have 16385x1 pixels, and 16384 is the most on a side"):
        Binning.of((2**14 + 1, 1), 60.0)


def test_the_field_of_view_of_an_image_stays_within_that_of_its_sensor():
    for fov_deg in (1.0, 33.3, 170.0):
        assert (
            Binning.of((160, 120), fov_deg, size=(53, 39), wanted_fov_deg=fov_deg).fov_deg(fov_deg) == fov_deg
        )


def test_a_thin_sensor_needs_no_more_memory_than_its_pixels():
    width = 2**14
    ramp = np.arange(width) + 0.5
    bins = Binning.of((width, 3), 60.0, size=(width // 3, 1))  # dense weights would take 0.7 GB each
    found = bins.of_pixels(np.ones((3, width), bool)).mean(np.tile(ramp, (3, 1))[..., None].astype(complex))
    left = (width - 3 * (width // 3)) / 2
    np.testing.assert_allclose(found[0, :, 0].real, left + 3 * np.arange(width // 3) + 1.5)
    plain = Binning.of((width, 1), 60.0)
    np.testing.assert_array_equal(plain.part(ramp[None] < 2), ramp[None] < 2)


# Lens

LENS = Lens(fx=52.0, fy=51.0, cx=30.5, cy=21.0, k1=-0.25, k2=0.05, k3=-0.01, p1=2e-3, p2=-1e-3)


def test_an_undistorted_image_is_that_of_the_pinhole_camera():
    width, height, fov_deg = 64, 44, 50.0

    def scene(x, y):  # light along the ray (x, y, 1); smooth, so that its curvature bounds the error
        return (1.5 + x - 0.5 * y) * np.exp(1j * (3 * x + 2 * y))

    row, column = np.mgrid[:height, :width].astype(float)
    x, y = (column - LENS.cx) / LENS.fx, (row - LENS.cy) / LENS.fy
    for _ in range(60):  # fixed point of the distortion: the ray that each pixel of the lens sees
        at_column, at_row = seen_at(LENS, x, y)
        x, y = x - (at_column - column) / LENS.fx, y - (at_row - row) / LENS.fy
    image = scene(x, y)
    straight = Undistortion.of(LENS, width, height, fov_deg)
    found, good = straight.resampled(image[..., None])[..., 0], straight.good(all_good(image.shape))
    rays = pixel_rays(width, height, fov_deg)
    expected = scene(rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2])
    # Linear interpolation errs by at most (|f_xx| + |f_yy|) / 8 in pixels; |f''| <= 3² · 3 + 2 · 3, over fx².
    bound = (3**2 * 3 + 2 * 3 + 2**2 * 3 + 2 * 2) / 8 / (0.8 * LENS.fy) ** 2
    assert good.mean() > 0.9
    assert np.abs(found - expected)[good].max() < bound


@pytest.mark.parametrize("k3", [0.0, -0.02])
def test_rays_that_the_distortion_folds_back_are_outside_of_the_image(k3):
    lens = Lens(fx=25.0, fy=25.0, cx=31.5, cy=21.5, k1=-0.25, k3=k3)
    width, height, fov_deg = 64, 44, 130.0
    radius = np.linspace(0, 3, 300001)
    growing = np.diff(radius * (1 - 0.25 * radius**2 + k3 * radius**6)) > 0
    turning = radius[np.argmin(growing)]
    assert turning_point(lens) == pytest.approx(turning**2, abs=2 * 3 * 1e-5)  # steps of 1e-5 up to 3
    rays = pixel_rays(width, height, fov_deg)
    far = np.hypot(rays[..., 0], rays[..., 1]) / rays[..., 2] > turning + 1e-4
    good = Undistortion.of(lens, width, height, fov_deg).good(all_good((height, width)))
    assert 0.1 < far.mean() < 0.9  # both are tested
    np.testing.assert_array_equal(good, ~far)


def test_a_radius_that_always_grows_has_no_turning_point():
    for factors in ({}, {"k1": 0.1}, {"k1": -0.1, "k2": 0.1}, {"k3": 1e-320}):
        assert turning_point(Lens(fx=1.0, fy=1.0, cx=0.0, cy=0.0, **factors)) == np.inf


def test_a_lens_without_distortion_changes_nothing():
    width, height, fov_deg = 26, 18, 60.0
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    plain = Lens(fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)
    straight = Undistortion.of(plain, width, height, fov_deg)
    np.testing.assert_allclose(straight.resampled(PHASOR), PHASOR, atol=1e-12)


def test_a_bad_pixel_spoils_those_that_are_made_of_it():
    good = all_good((44, 64))
    good[20, 30] = False
    straight = Undistortion.of(LENS, 64, 44, 50.0)
    lost = straight.good(all_good(good.shape)) & ~straight.good(good)
    assert 1 <= lost.sum() <= 9


# A whole capture


def test_a_capture_of_a_camera_is_right_within_its_shot_noise(tmp_path):
    count = 8
    settings = SensorSettings(
        contrast=((20e6, 0.8),), shot_noise=True, gain_spread=0.01, offset_spread_e=50.0
    )
    signal_e = 20000 * np.abs(PHASOR[..., :1]) / np.abs(PHASOR[..., 0]).max()
    rng = np.random.default_rng(5)
    light = PHASOR / np.abs(PHASOR) * signal_e * 0.8  # of both taps, times the contrast
    mean_e = taps_of(light, steps(4), steps(2), background=1 / 0.8)
    gain, offset = (
        1 + 0.01 * rng.standard_normal((18, 26, 1, 1, 2)),
        50 * rng.standard_normal((18, 26, 1, 1, 2)),
    )
    raw = np.round(gain * rng.poisson(mean_e, (count, *mean_e.shape)) + offset + 500).astype(np.uint16)
    raw[:, 3, 4] = 7  # dead
    raw[2, 5, 6, 1, 2, 0] = 2**15 - 1  # saturated once
    capture = capture_of(raw_of(sidecar := sidecar_of(tmp_path, bits=15), raw=raw), sidecar)
    assert capture.frequencies_hz == FREQUENCIES_HZ
    missing = np.zeros((18, 26), bool)
    missing[3, 4] = missing[5, 6] = True
    np.testing.assert_array_equal(capture.phasor == 0, np.repeat(missing[..., None], 3, axis=-1))
    assert capture.saturated_part[5, 6] == 1
    np.testing.assert_allclose([capture.facts.saturated, capture.facts.dead], 1 / (18 * 26))
    assert first_harmonic(settings, 50e6) == 0.8
    theory = np.array([[phase_noise_rad(settings, each, 50e6) for each in line] for line in signal_e[..., 0]])
    theory = theory[..., None] / np.sqrt(count)
    error = np.angle(capture.phasor[~missing] / PHASOR[~missing])
    ratios = (error / theory[~missing]) ** 2
    # gains of 1 % change a variance by 1 %, and rounding adds 1/12 to a variance of at least 500
    assert within_chi_squared(ratios, 1)


def test_images_upside_down_or_mirrored_are_turned(tmp_path):
    raw = taps_of(PHASOR, steps(4), steps(2))
    turned = sidecar_of(tmp_path, rows_from_bottom=True, columns_from_right=True)
    found = capture_of(raw_of(turned, raw=raw[::-1, ::-1]), turned, ImageShape(bin_side=2))
    plain = sidecar_of(tmp_path)
    expected = capture_of(raw_of(plain, raw=raw), plain, ImageShape(bin_side=2))
    np.testing.assert_allclose(found.phasor, expected.phasor, atol=1e-13)
