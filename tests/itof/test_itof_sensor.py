"""The camera model against closed forms: light, taps, noise, limits, fixed pattern."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.constants import c, e, h

from disk import PresetError
from itof import pixel_rays
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import (
    first_harmonic,
    harmonics,
    phasor_of_differences,
    tap_differences,
)
from itof.sensor.light import (
    ambient_rate_e_s,
    electrons_per_joule,
    emitter_scale,
    falloff,
    pixel_power_w,
    scattered,
    signal_rate_e_s,
)
from itof.sensor.noise import phase_noise_rad
from itof.sensor.settings import SensorSettings

HZ = (20e6, 50e6, 60e6)
SMALL = SensorSettings(width=24, height=18)
SQUARE = replace(SMALL, emitter_waveform="square", reference_waveform="square", highest_harmonic=99)
NOISY = replace(SMALL, shot_noise=True, contrast=((20e6, 0.6), (60e6, 0.3)))


def scene(size=(18, 24), seed=0, spread=0.3):
    rng = np.random.default_rng(seed)
    amplitude = 0.4 * np.exp(spread * rng.standard_normal((*size, 1)))
    return amplitude * np.exp(2j * np.pi * rng.random((*size, len(HZ))))


def even(amplitude=0.4, phase_rad=0.7, size=(18, 24)):
    return np.full((*size, len(HZ)), amplitude * np.exp(1j * phase_rad))


def captured(settings, phasor, seed=0, frequencies_hz=HZ):
    return Camera(settings, frequencies_hz).capture(phasor, np.random.default_rng(seed))


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_a_camera_without_limits_returns_the_phasors(steps):
    z = scene()
    for settings in (SMALL, replace(SMALL, frames=2, width=48, height=36), NOISY):
        quiet = replace(settings, phase_steps=steps, shot_noise=False)
        found = captured(quiet, z)
        np.testing.assert_allclose(found.phasor, z, rtol=1e-12)
        assert not found.saturated.any()


def test_electrons_are_those_of_the_power_on_the_pixel():
    settings = replace(SMALL, quantum_efficiency=0.51, fill_factor=0.8, wavelength_nm=850.0)
    # An ampere per watt is an electron's charge times electrons per joule.
    assert e * electrons_per_joule(settings) == pytest.approx(0.51 * 0.8 * 850e-9 * e / (h * c))
    assert e * electrons_per_joule(load_sensor("opt8241")) == pytest.approx(0.35, rel=0.01)  # its data sheet
    # A sensor behind f/1 that sees the radiance 1 everywhere has the irradiance π/4.
    open_lens = replace(SMALL, f_number=1.0, pixel_pitch_um=1e6, lens_transmission=0.5)
    assert pixel_power_w(open_lens, 2.0) == pytest.approx(2 * 0.5 * math.pi / 4)
    light = replace(SMALL, ambient_w_m2=math.pi)
    assert ambient_rate_e_s(light) == pytest.approx(pixel_power_w(light, 1.0) * electrons_per_joule(light))


def test_the_emitter_has_the_power_of_its_settings():
    """Radiant intensity π / cos³ over the field of view of the projector, summed over fine pixels."""
    rays = pixel_rays(640, 480, 60.0)
    cosine = rays[..., 2]
    pixel = (2 * math.tan(math.pi / 6) / 640) ** 2  # of the image at a distance of 1
    power_w = float((math.pi / cosine**3 * cosine**3 * pixel).sum())
    assert emitter_scale(replace(SensorSettings(), emitter_power_w=3.0)) == pytest.approx(3.0 / power_w)


@pytest.mark.parametrize("frequency_hz", HZ)
def test_square_waves_make_the_phase_error_of_triangles(frequency_hz):
    """The correlation of two square waves is a triangle, so the phase of four steps is known exactly."""
    phase = np.linspace(0, np.pi / 2, 61)[1:-1]
    wave = phase / (np.pi / 2)
    expected = np.arctan2(wave, 1 - wave) - phase
    found = np.angle(
        phasor_of_differences(SQUARE, tap_differences(SQUARE, np.exp(1j * phase), frequency_hz), frequency_hz)
    )
    # Harmonics above the 99th are left out: their sum is below 1 / (2 · 99 · pi/2²) of the first.
    np.testing.assert_allclose(found - phase, expected, atol=5e-3)
    assert np.abs(found - phase).max() == pytest.approx(0.0711, abs=2e-3)  # four cycles, 71 mrad either way
    few = replace(SQUARE, highest_harmonic=3)
    small = np.angle(phasor_of_differences(few, tap_differences(few, np.exp(1j * phase), 50e6), 50e6)) - phase
    np.testing.assert_allclose(
        small,
        np.angle(1 + np.exp(-4j * phase) / 9),
        atol=1e-12,  # exp(j φ) + exp(-3 j φ) / 9
    )
    more = replace(SQUARE, phase_steps=8)
    better = np.angle(phasor_of_differences(more, tap_differences(more, np.exp(1j * phase), 50e6), 50e6))
    # Harmonics fall with their square. The 7th and 9th have 0.22 of the 3rd and 5th.
    assert np.abs(better - phase).max() < 0.25 * 0.0711


def test_harmonics_of_waveforms():
    assert harmonics(replace(SQUARE, reference_waveform="sinusoidal"), 50e6) == {1: 1.0}
    found = harmonics(replace(SQUARE, highest_harmonic=9), 50e6)
    assert found == pytest.approx({n: 1 / n**2 for n in (1, 3, 5, 7, 9)})
    slow = harmonics(replace(SQUARE, highest_harmonic=3, rise_time_s=4e-9), 50e6)
    assert slow[3] == pytest.approx(np.sinc(0.6) / np.sinc(0.2) / 9)
    third = harmonics(replace(SQUARE, highest_harmonic=3, emitter_duty=1 / 3), 50e6)
    assert list(third) == [1]  # a duty of a third has no third harmonic
    # The contrast is the largest difference over the sum, whatever the waves.
    for settings in (NOISY, replace(SQUARE, contrast=((20e6, 0.6), (60e6, 0.3)))):
        turning = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
        for frequency_hz, contrast in ((20e6, 0.6), (40e6, 0.45), (60e6, 0.3), (90e6, 0.3)):
            assert np.abs(tap_differences(settings, turning, frequency_hz)).max() == pytest.approx(contrast)


@pytest.mark.parametrize("integration_s", [1e-4, 1e-3])
@pytest.mark.parametrize(
    "changes", [{}, {"ambient_w_m2": 2.0}, {"dark_current_e_s": 3e7}, {"read_noise_e": 40.0}]
)
def test_phase_noise_is_that_of_the_closed_form(integration_s, changes):
    settings = replace(NOISY, width=120, height=90, integration_s=integration_s, **changes)
    z = even(size=(90, 120))
    found = captured(settings, z)
    for place, frequency_hz in enumerate(HZ):
        sigma = phase_noise_rad(settings, float(found.signal_e[0, 0]), frequency_hz)
        assert 1e-4 < sigma < 0.12  # where phase and tangent are the same
        error = np.angle(found.phasor[..., place] / z[..., place])
        # chi-squared of 10800 pixels: its relative standard deviation is 1.4 %
        assert (error**2).mean() / sigma**2 == pytest.approx(1, abs=0.055)
        assert abs(error.mean()) < 4 * sigma / math.sqrt(error.size)


def test_shot_noise_of_few_and_of_many_electrons():
    for integration_s in (1e-6, 5e-2):
        settings = replace(NOISY, width=120, height=90, integration_s=integration_s)
        found = captured(settings, even(size=(90, 120)))
        mean_e = float(found.signal_e[0, 0])
        spread = np.std(found.phasor[..., 0].real) / 0.4
        expected = math.sqrt(2 / (4 * mean_e)) / first_harmonic(settings, 20e6)
        # 10800 pixels know a standard deviation to 1 / sqrt(2 x 10800) = 0.7 %; four times that.
        assert spread == pytest.approx(expected, rel=0.03)


def test_binned_pixels_and_averaged_frames_have_less_noise():
    z = even()
    one = captured(NOISY, z)
    spread = np.std(np.angle(one.phasor / z))
    for settings, times in (
        (replace(NOISY, width=24 * 4, height=18 * 4), 4),
        (replace(NOISY, frames=16), 4),
        (replace(NOISY, integration_s=16e-3), 4),
    ):
        # Two standard deviations of 1296 values each: 2 % sqrt(2); three times that.
        assert np.std(np.angle(captured(settings, z, 1).phasor / z)) == pytest.approx(spread / times, rel=0.1)


def test_the_fixed_pattern_changes_brightness_and_no_phase():
    """Offsets cancel in the sum over the steps, and so does the light that a larger gain of one tap adds."""
    settings = replace(SMALL, gain_spread=0.05, offset_spread_e=300.0, tap_mismatch=0.1, pattern_seed=3)
    z = scene()
    found = captured(settings, z).phasor
    np.testing.assert_allclose(np.angle(found / z), 0, atol=1e-12)
    # Two taps of 5 % each are 3.5 % together; offsets and the mismatch change it by a part.
    assert 0.02 < np.std(np.abs(found / z)) < 0.06
    np.testing.assert_allclose(captured(settings, z, seed=5).phasor, found, rtol=1e-12)
    assert np.abs(captured(replace(settings, pattern_seed=4), z).phasor - found).max() > 1e-3
    three = captured(replace(settings, phase_steps=3), z).phasor
    np.testing.assert_allclose(np.angle(three / z), 0, atol=1e-12)


def test_full_wells_are_reported_and_bend_the_phase():
    z = scene(spread=0.0)
    whole = captured(SMALL, z)
    settings = replace(SMALL, full_well_e=float(whole.signal_e[0, 0]) * 0.8)
    found = captured(settings, z)
    assert 0 < found.saturated.mean() < 1
    fine = found.saturated == 0
    np.testing.assert_allclose(found.phasor[fine], z[fine], rtol=1e-12)
    assert np.abs(np.angle(found.phasor / z))[~fine].max() > 0.01
    # With half the contrast, every tap of every raw frame has more than one electron.
    bright = captured(replace(settings, full_well_e=1.0, contrast=((20e6, 0.5),)), z)
    np.testing.assert_array_equal(bright.saturated, 1)
    np.testing.assert_allclose(bright.phasor, 0, atol=1e-9)


def test_the_converter_rounds_by_its_step_and_saturates():
    # With four steps, two raw frames would round alike: their taps are exchanged.
    settings = replace(SMALL, width=120, height=90, adc_bits=12, adc_e_per_dn=50.0, phase_steps=5)
    z = scene(size=(90, 120), spread=0.01)
    found = captured(settings, z)
    electrons = signal_rate_e_s(settings) * settings.integration_s
    # Both taps round, each with the variance step² / 12; contrast 1.
    expected = math.sqrt(2 / 5 * 2 * 50.0**2 / 12) / electrons
    assert np.std((found.phasor - z).real) == pytest.approx(expected, rel=0.05)
    few = captured(replace(settings, adc_bits=6, adc_e_per_dn=5.0, contrast=((20e6, 0.5),)), z)
    np.testing.assert_array_equal(few.saturated, 1)
    offset = captured(replace(settings, adc_offset_dn=10.0), z)
    np.testing.assert_allclose(offset.phasor, found.phasor, rtol=1e-9)


def test_dead_pixels_are_left_out():
    settings = replace(SMALL, width=96, height=72, dead_pixels=0.3)
    z = scene()
    np.testing.assert_allclose(captured(settings, z).phasor, z, rtol=1e-12)
    single = captured(replace(settings, width=24, height=18), z).phasor
    gone = single == 0
    # 432 pixels: sqrt(0.3 x 0.7 / 432) = 0.022, of which 0.1 is more than four.
    assert gone.all(axis=-1).mean() == pytest.approx(0.3, abs=0.1)
    np.testing.assert_allclose(single[~gone], z[~gone], rtol=1e-12)


def test_lens_falloff_and_scattering():
    settings = replace(SMALL, vignetting=4.0)
    rays = pixel_rays(24, 18, 60.0)
    np.testing.assert_allclose(falloff(settings, 24, 18), rays[..., 2] ** 4)
    found = captured(settings, scene())
    np.testing.assert_allclose(found.phasor, scene() * rays[..., 2:] ** 4, rtol=1e-12)
    cloudy = replace(SMALL, scattering=0.01, scattering_width=0.1)
    z = np.zeros((18, 24, 3), complex)
    z[9, 12] = 1j
    spread = scattered(cloudy, z)
    np.testing.assert_allclose(spread.sum(axis=(0, 1)), 1j, rtol=1e-6)  # no light is lost
    assert spread[9, 12, 0].imag == pytest.approx(0.99, abs=0.002)
    # A Gaussian of 2.4 pixels falls to exp(-1/2) of its middle at its standard deviation.
    assert spread[9, 15, 0].imag / spread[9, 13, 0].imag == pytest.approx(
        math.exp(-(9 - 1) / (2 * 2.4**2)), rel=0.02
    )
    np.testing.assert_array_equal(scattered(SMALL, z), z)


def test_phases_drift_from_image_to_image_and_not_within_one():
    settings = replace(SMALL, phase_drift_rad=0.02)
    z = np.stack([scene(), scene(seed=1)])
    error = np.angle(captured(settings, z).phasor / z)  # (2, H, W, F)
    assert np.ptp(error, axis=(1, 2)).max() < 1e-12
    drifts = np.concatenate(
        [np.angle(captured(settings, z, seed).phasor / z)[:, 0, 0].ravel() for seed in range(60)]
    )
    # 360 draws: 1 / sqrt(2 · 360) = 3.7 %; four times that.
    assert drifts.std() == pytest.approx(0.02, rel=0.15)
    assert len(np.unique(error[:, 0, 0].round(9))) == 6


def test_torch_gives_the_phasors_of_numpy():
    settings = replace(load_sensor("mlx75027"), width=24, height=18)
    z = np.stack([scene(), scene(seed=1)]).astype(np.complex64)
    numpy = captured(settings, z)
    other = captured(settings, torch.from_numpy(z))
    assert isinstance(other.phasor, torch.Tensor)
    assert other.phasor.dtype == torch.complex64
    for name in ("phasor", "saturated", "signal_e"):
        np.testing.assert_array_equal(getattr(other, name).numpy(), getattr(numpy, name))
    assert numpy.phasor.shape == z.shape
    assert numpy.saturated.shape == z.shape[:-1]
    for frequency_hz in HZ:
        np.testing.assert_allclose(
            tap_differences(settings, torch.from_numpy(z[..., 0]), frequency_hz).numpy(),
            tap_differences(settings, z[..., 0], frequency_hz),
            atol=1e-6,
        )


def test_raw_frames_are_those_of_which_the_firmware_makes_phasors():
    settings = replace(
        load_sensor("mlx75027"), width=48, height=36, frames=2, phase_drift_rad=0.01, dead_pixels=0.0
    )
    z = scene()
    raw = Camera(settings, HZ).raw_frames(z, np.random.default_rng(0))
    assert raw.shape == (2, 3, 4, 2, 36, 48)
    np.testing.assert_array_equal(raw, raw.round())
    assert raw.min() >= 0
    assert raw.max() < 2**12
    differences = np.moveaxis(raw[:, :, :, 0] - raw[:, :, :, 1], 2, -1) * settings.adc_e_per_dn
    found = np.stack(
        [phasor_of_differences(settings, differences[:, k], HZ[k]).mean(0) for k in range(3)], -1
    )
    electrons = signal_rate_e_s(settings) * settings.integration_s
    binned = found.reshape(18, 2, 24, 2, 3).mean(axis=(1, 3)) / electrons
    expected = captured(settings, z).phasor
    np.testing.assert_allclose(binned, expected, rtol=0.06)  # other noise: 2 % of a pixel's
    assert np.abs(np.angle(binned / expected).mean(axis=(0, 1))).max() < 2e-3  # the same drift


def test_images_that_do_not_fit_are_refused():
    for size in ((17, 24), (9, 24), (36, 48)):
        with pytest.raises(ValueError, match=r"its sides must divide the sensor's"):
            captured(SMALL, scene(size=size))
    with pytest.raises(ValueError, match=r"expected phasors at 3 frequencies, got 2"):
        captured(SMALL, scene()[..., :2])


@pytest.mark.parametrize("name", ["ideal", "mlx75027", "measured-waves", "opt8241", "cheap", "calibrated"])
def test_cameras_that_come_with_the_program_measure(name):
    settings = replace(load_sensor(name), frames=1)
    z = even(0.37, 0.4, (settings.height // 8, settings.width // 8))
    found = captured(settings, z)
    assert np.isfinite(found.phasor).all()
    assert not found.saturated.any()
    # At most the four cycles of square waves, noise and a lens that spreads light of one phase.
    assert np.abs(np.angle(found.phasor / z)).max() < 0.25
    assert 1e3 < found.signal_e.mean() < 1e9


def test_sensor_files_with_mistakes_are_refused_by_their_key(tmp_path):
    file = tmp_path / "s.toml"
    for text, words in (
        ("full_wel_e = 3.0", "unknown key full_wel_e"),
        ("f_number = 1e-300", "f_number must be 0.1 to 1000 (got 1e-300)"),
        (
            "contrast = [[40, 0.5]]",
            "contrast.0.0 must be 1e+06 to 1e+10 Hz (got 40): give Hz, as 20e6 for 20 MHz",
        ),
        ("wavelength_nm = 0.85", "wavelength_nm must be 300 to 1100 nm (got 0.85)"),
        ("pixel_pitch_um = 1e-300", "pixel_pitch_um must be 0.01 to 1e+06 µm (got 1e-300)"),
        ("contrast = [[60e6, 0.5], [20e6, 0.6]]", "the frequencies must ascend, each once"),
        ("contrast = [[20e6, 1.5]]", "contrast"),
        ("harmonics = [[60e6, [0.0]], [20e6, [0.0]]]", "the frequencies must ascend, each once"),
        ("harmonics = [[20e6, [0.0, 10.8]]]", "harmonics.0.1.1 must be less than or equal to 1"),
        ('extends = "nikon"', "key extends: there is no nikon"),
        ("adc_bits = 12", "adc_bits and adc_e_per_dn go together"),
        ("scattering = 0.1\nscattering_width = 1e6", "scattering_width must be 0.0001 to 10 (got 1000000)"),
        ("distortion = [-0.5, 0.0]", "folds the image before the corners"),
        ("phase_steps = 2", "phase_steps must be greater than or equal to 3"),
        ("integration_s = nan", "integration_s"),
        ("width = [", "cannot be read as TOML"),
    ):
        file.write_text(text)
        with pytest.raises(PresetError) as refused:
            load_sensor(file)
        assert words in str(refused.value), text
        assert str(file) in str(refused.value)
    with pytest.raises(
        PresetError, match=r"one of calibrated, cheap, ideal, measured-waves, mlx75027, opt8241"
    ):
        load_sensor("kinect")
