"""The firmware's calibration of waveforms that are not sinusoidal, and where there can be none."""

from dataclasses import replace

import numpy as np
import pytest
from test_itof_sensor import SQUARE, captured, scene

from itof.sensor.demodulation import first_harmonic


def test_a_calibration_takes_the_wiggling_out_as_far_as_it_is_known():
    z = scene(size=(36, 48))
    square = replace(SQUARE, width=48, height=36, highest_harmonic=9, rise_time_s=2e-9)
    raw = captured(square, z).phasor
    error = np.log(raw / z)
    assert np.abs(error.imag).max() > 0.05
    np.testing.assert_allclose(captured(replace(square, wiggling_left=0.0), z).phasor, z, rtol=1e-7)
    tenth = np.log(captured(replace(square, wiggling_left=0.1), z).phasor / z)
    np.testing.assert_allclose(tenth, 0.1 * error, atol=1e-7)
    # With noise, it is the measured phase that is corrected, so the noise is stretched by up to a quarter.
    noisy = replace(square, shot_noise=True, integration_s=1e-2, wiggling_left=0.0)
    spread = np.std(np.angle(captured(noisy, z).phasor / z))
    sinus = replace(noisy, emitter_waveform="sinusoidal", contrast=((20e6, first_harmonic(noisy, 50e6)),))
    assert 0.8 < spread / np.std(np.angle(captured(sinus, z).phasor / z)) < 1.3


def test_a_waveform_that_no_calibration_undoes_is_refused():
    z = scene(size=(36, 48))
    settings = replace(SQUARE, width=48, height=36, highest_harmonic=9, wiggling_left=0.0)
    for duty in (0.5, 0.25):
        # Linear between the entries of the table: the curvature of the error grows towards its fold.
        np.testing.assert_allclose(captured(replace(settings, emitter_duty=duty), z).phasor, z, rtol=2e-5)
    for duty in (0.15, 0.1):  # the measured phase goes back where that of the light goes on
        with pytest.raises(ValueError, match="light of several phases gives the same measured phase"):
            captured(replace(settings, emitter_duty=duty), z)
