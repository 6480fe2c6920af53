"""The fast model of binned pixels against the camera that counts electrons."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from itof.sensor.binned import BinnedCamera
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import first_harmonic, folded, phasor_of_differences, tap_differences
from itof.sensor.noise import phase_noise_rad
from itof.sensor.random_camera import random_camera
from itof.sensor.settings import SensorSettings

HZ = (20e6, 50e6, 60e6)
SMALL = SensorSettings(width=96, height=72, contrast=((20e6, 0.6), (60e6, 0.3)))
SQUARE = {"emitter_waveform": "square", "reference_waveform": "square", "rise_time_s": 2e-9}
LENS = {"vignetting": 4.0, "scattering": 0.02, "crosstalk": 0.1, "ambient_w_m2": 0.5}


def scene(size=(18, 24), seed=0, spread=0.3):
    rng = np.random.default_rng(seed)
    amplitude = 0.4 * np.exp(spread * rng.standard_normal((*size, 1)))
    return amplitude * np.exp(2j * np.pi * rng.random((*size, len(HZ))))


def binned(settings, size=(18, 24)):
    return BinnedCamera(settings, HZ, size[1], size[0])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        LENS,
        SQUARE,
        {**SQUARE, "wiggling_left": 0.1, "phase_steps": 5, "harmonics": ((20e6, (0.02, 0.1, 0.01)),)},
        {"full_well_e": 2.5e4, "ambient_w_m2": 0.02, "dark_current_e_s": 1e6},
        {**SQUARE, "adc_bits": 20, "adc_e_per_dn": 0.02, "adc_offset_dn": 50.0},
    ],
)
def test_without_noise_it_is_the_camera_that_counts_electrons(changes):
    settings = replace(SMALL, **changes)
    z = np.stack([scene(), scene(seed=1)])
    counted = Camera(settings, HZ).capture(z, np.random.default_rng(0))
    # float32, and the step of the converter: 0.02 of some 10,000 electrons
    np.testing.assert_allclose(binned(settings).mean(z), counted.phasor, rtol=1e-4, atol=1e-6)
    if {"full_well_e", "adc_bits"} & set(changes):
        assert 0.01 < counted.saturated.mean() < 0.9  # some are at full scale, some are not


@pytest.mark.parametrize("steps", [3, 4, 5, 8, 12])
def test_few_harmonics_fold_into_the_result(steps):
    settings = replace(SMALL, **SQUARE, emitter_duty=0.4, highest_harmonic=40, phase_steps=steps)
    z = scene()[..., 0]
    slow = phasor_of_differences(settings, tap_differences(settings, z, 20e6), 20e6)
    np.testing.assert_allclose(folded(settings, z, 20e6), slow, atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"frames": 3, "dead_pixels": 0.2, "ambient_w_m2": 5.0, "vignetting": 4.0},
        {"dark_current_e_s": 3e7, "read_noise_e": 200.0, "adc_bits": 12, "adc_e_per_dn": 94.3},
        {"phase_steps": 8, "integration_s": 1e-4},
    ],
)
def test_its_noise_is_that_of_counted_electrons(changes):
    settings = replace(SMALL, shot_noise=True, **changes)
    z = scene(spread=0.1)
    camera, rng = Camera(settings, HZ), np.random.default_rng(1)
    expected, spread = binned(settings).mean(z), binned(settings).spread(z)
    errors = np.stack([camera.capture(z, rng).phasor - expected for _ in range(12)])
    for part in (errors.real, errors.imag):
        chi = (part / spread) ** 2
        for place in range(len(HZ)):  # 12 x 18 x 24 values: relative standard deviation 2 %
            assert chi[..., place].mean() == pytest.approx(1, abs=0.07)


def test_its_noise_is_the_closed_form_over_the_averaged_pixels():
    settings = replace(SMALL, shot_noise=True, read_noise_e=40.0, ambient_w_m2=1.0, frames=4)
    z = np.full((18, 24, 3), 0.4 + 0j)
    seen = Camera(replace(settings, frames=1), HZ).capture(z, np.random.default_rng(0))
    spread = binned(settings).spread(z) / 0.4
    for place, frequency_hz in enumerate(HZ):
        one = phase_noise_rad(settings, float(seen.signal_e[9, 12]), frequency_hz)
        np.testing.assert_allclose(spread[9, 12, place], one / np.sqrt(4**2 * 4), rtol=1e-6)


@pytest.mark.parametrize("changes", [{}, {"full_well_e": 2.5e4, "ambient_w_m2": 0.02}])
def test_each_image_may_have_a_camera_of_its_own(changes):
    settings = replace(SMALL, **SQUARE, scattering=0.05, phase_steps=5, **changes)
    z = np.stack([scene(), scene()])
    own = [random_camera(settings, np.random.default_rng(seed)) for seed in range(2)]
    found = binned(settings).mean(z, own)
    for image, light, camera in zip(found, z, own, strict=True):
        alone = binned(camera).mean(light)  # by a firmware that knows its contrast
        gain = [first_harmonic(camera, f) / first_harmonic(settings, f) for f in HZ]
        np.testing.assert_allclose(image, alone * gain, rtol=1e-9, atol=1e-12)
    assert np.abs(found[0] - found[1]).max() > 0.01
    with pytest.raises(ValueError, match="2 cameras for phasors of the shape"):
        binned(settings).mean(z[0], own)


def test_a_harmonic_that_the_type_lacks_counts_in_a_camera_of_it():
    settings = replace(SMALL, **SQUARE, emitter_duty=1 / 3, highest_harmonic=3)  # no third harmonic
    own = [random_camera(settings, np.random.default_rng(0))]
    gain = [first_harmonic(own[0], f) / first_harmonic(settings, f) for f in HZ]
    alone = binned(own[0]).mean(scene()) * gain
    assert np.abs(np.angle(alone / scene())).max() > 1e-3
    np.testing.assert_allclose(binned(settings).mean(scene()[None], own)[0], alone, rtol=1e-9)


def test_cameras_of_a_type_differ_within_their_bounds():
    settings = replace(SMALL, **SQUARE, scattering=0.05, wiggling_left=0.5, harmonics=((20e6, (0.0, 0.1)),))
    own = [random_camera(settings, np.random.default_rng(seed)) for seed in range(400)]
    for values, lowest, highest in (
        ([each.contrast[0][1] for each in own], 0.95 * 0.6, 1.05 * 0.6),
        ([each.contrast[1][1] for each in own], 0.95 * 0.3, 1.05 * 0.3),
        ([each.rise_time_s for each in own], 0.8 * 2e-9, 1.2 * 2e-9),
        ([each.emitter_duty for each in own], 0.49, 0.51),
        ([0.1 / each.harmonics[0][1][1] for each in own], 0.8, 1.2),
        ([each.scattering for each in own], 0, 0.05),
        ([each.wiggling_left for each in own], 0, 0.5),
    ):
        width = highest - lowest
        # All of 400 draws miss a fiftieth of the range with the probability 0.98^400 = 3e-4.
        assert lowest <= min(values) < lowest + 0.02 * width
        assert highest - 0.02 * width < max(values) <= highest
        # Uniform: 400 draws scatter around the middle by width / sqrt(12 * 400).
        assert np.mean(values) == pytest.approx((lowest + highest) / 2, abs=4 * width / np.sqrt(4800))
    assert len({each.pattern_seed for each in own}) == 400
    edge = replace(settings, contrast=((20e6, 1.0),), emitter_duty=0.995, rise_time_s=1e-6)
    for seed in range(20):
        random_camera(edge, np.random.default_rng(seed))  # within the bounds of SensorSettings


def test_torch_gives_the_numbers_of_numpy():
    settings = replace(load_sensor("mlx75027"), width=96, height=72, integration_s=3e-2, **LENS)
    z = scene().astype(np.complex64)
    camera = binned(settings)
    for name in ("mean", "spread"):
        expected = getattr(camera, name)(z)
        found = getattr(camera, name)(torch.from_numpy(z))
        assert str(found.dtype) in {"torch.complex64", "torch.float32"}
        # float32: some ten operations that round by 2^-24
        np.testing.assert_allclose(found.numpy(), expected, rtol=2e-6, atol=1e-9)


def test_dark_pixels_and_dead_bins_are_numbers():
    settings = replace(SMALL, shot_noise=True, dead_pixels=0.9, **SQUARE)
    z = scene()
    z[3, 4] = 0
    camera = binned(settings)
    assert np.isfinite(camera.mean(z)).all()
    assert camera.mean(z)[3, 4, 0] == 0
    spread = camera.spread(z)
    assert np.isfinite(spread).all()
    gone = (
        Camera(replace(settings, shot_noise=False), HZ).capture(scene(), np.random.default_rng(0)).phasor == 0
    )
    assert 0.05 < gone.mean() < 0.5  # some bins are dead, some are not
    np.testing.assert_array_equal(camera.mean(scene()) == 0, gone)
    lit = z[..., 0] != 0
    np.testing.assert_array_equal((spread == 0)[lit], gone[lit])
    with pytest.raises(ValueError, match="its sides must divide"):
        BinnedCamera(settings, HZ, 25, 18)
