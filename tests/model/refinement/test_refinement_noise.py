"""The noise of a measurement, as its light tells it."""

import numpy as np
import pytest

from model.refinement.pixel_noise import pixel_noise

HEIGHT, WIDTH, COUNT = 60, 80, 3
AMPLITUDE = np.geomspace(1, 40, WIDTH) * np.linspace(1, 2, HEIGHT)[:, None]
SMOOTH = 2e-3 * np.sin(np.linspace(0, 5, WIDTH))[None, :, None] * np.array([1.0, -2.0, 0.5])
OFF = 0.15  # largest error of a pixel, at the ends of the amplitudes: 8 to 15 % over 40 seeds
PARTS = {"constant": 0.0, "shot noise": -0.5, "read-out": -1.0}


def drawn(spread, seed=0):
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, COUNT))
    return SMOOTH + spread[..., None] * noise


@pytest.mark.parametrize("name", PARTS)
def test_each_kind_of_noise_is_told_by_how_it_depends_on_the_amplitude(name):
    true = 1e-3 * AMPLITUDE ** PARTS[name]
    found = pixel_noise(drawn(true), AMPLITUDE)
    np.testing.assert_allclose(found, true, rtol=OFF)
    # 14,000 fourth differences scatter by 1 % of their power; three times that.
    assert np.median(found / true) == pytest.approx(1, abs=0.03)


def test_kinds_of_noise_add():
    true = np.sqrt(
        sum((size * AMPLITUDE**power) ** 2 for size, power in ((1e-4, 0), (5e-4, -0.5), (1e-3, -1)))
    )
    np.testing.assert_allclose(pixel_noise(drawn(true), AMPLITUDE), true, rtol=OFF)


def test_smooth_light_has_none_and_the_unit_of_the_amplitude_does_not_matter():
    still = np.broadcast_to(SMOOTH, (HEIGHT, WIDTH, COUNT))
    # A fourth difference of a sine is its step's fourth power.
    assert pixel_noise(still, AMPLITUDE).max() < (5 / (WIDTH - 1)) ** 4 * np.abs(SMOOTH).max()
    noisy = drawn(1e-3 / AMPLITUDE)
    np.testing.assert_allclose(pixel_noise(noisy, 1e-6 * AMPLITUDE), pixel_noise(noisy, AMPLITUDE), rtol=1e-9)
    np.testing.assert_array_equal(pixel_noise(np.zeros((4, 4, 2)), np.ones((4, 4))), np.zeros((4, 4)))


def test_edges_and_dark_pixels_are_no_noise():
    assert np.isnan(pixel_noise(drawn(AMPLITUDE), 0 * AMPLITUDE)).all()
    phases, amplitude = drawn(np.full((HEIGHT, WIDTH), 1e-3)), AMPLITUDE.copy()
    phases[:, 30:] += 0.5
    phases[10:20, 50] = np.nan
    amplitude[40:, :3] = 0
    found = pixel_noise(phases, amplitude)
    np.testing.assert_array_equal(np.isnan(found), amplitude == 0)
    np.testing.assert_allclose(found[amplitude > 0], 1e-3, rtol=OFF)
