"""What a camera leaves of hidden light, by closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from itof.sensor.settings import SensorSettings
from model.training.camera_light import CameraLight, light_behind

HZ = (20e6, 60e6)
CAMERA = SensorSettings(width=96, height=64, contrast=((20e6, 0.5),))


def images(strength=1e-3):
    rng = np.random.default_rng(0)
    direct = 0.4 * np.exp(2j * np.pi * rng.random((32, 48, 2)))
    return [(direct, strength * direct * np.exp(2j * np.pi * rng.random((32, 48, 2))))]


def test_a_third_harmonic_changes_the_hidden_light_by_four_times_its_phase():
    """log(exp(j φ) + C exp(-3 j φ)) = j φ + C exp(-4 j φ): a change of the phase counts 4 C more."""
    harmonic = 0.01
    found = light_behind(replace(CAMERA, harmonics=((20e6, (0.0, harmonic)),)), images(), HZ)
    # The phase has half of the power. Terms of second order are a part C; 3072 phases scatter by 1.3 %.
    assert found.changed == pytest.approx(4 * harmonic / np.sqrt(2), rel=0.05)
    assert found.snr == np.inf
    assert found.sentence == "this camera has no noise; its waves change 2.8 % of the hidden light"


def test_the_exposures_that_are_asked_for_make_the_light_twice_the_noise():
    settings = replace(CAMERA, shot_noise=True, integration_s=1e-4)
    weak = light_behind(settings, images(), HZ)
    assert weak.snr < 1
    count = int(weak.sentence.partition("average ")[2].partition(" ")[0])
    assert (
        2
        <= light_behind(replace(settings, frames=count), images(), HZ).snr
        < 2 * np.sqrt(count / (count - 1))
    )
    assert "average" not in CameraLight(2.1, 0.0).sentence
    assert "too little for a good image;" in CameraLight(0.0, 0.0).sentence
    assert "much for a network: calibrate them" in CameraLight(2.1, 0.3).sentence
