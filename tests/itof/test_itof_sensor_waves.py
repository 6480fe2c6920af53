"""Waves that were measured: harmonics by frequency, and camera files that begin with another."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c

from disk import PresetError
from itof.sensor.camera import Camera
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import harmonics
from itof.sensor.settings import SensorSettings

HZ = (20e6, 50e6, 60e6)
SMALL = SensorSettings(width=24, height=18)
SQUARE = replace(SMALL, emitter_waveform="square", reference_waveform="square")


def test_measured_harmonics_make_the_phase_error_of_their_closed_form():
    """Four steps of a third and a fifth harmonic see exp(j φ) + C_3 exp(-3 j φ) + C_5 exp(5 j φ)."""
    table = ((20e6, (0.0, 0.108, 0.0, 0.031)), (60e6, (0.0, 0.014, 0.0, 0.003)))
    settings = replace(SMALL, contrast=((20e6, 0.6), (60e6, 0.3)), harmonics=table)
    distance_m = np.linspace(0.3, 8, 18 * 24).reshape(18, 24)  # of walls
    phase = 4 * np.pi * np.array(HZ) * distance_m[..., None] / c
    found = Camera(settings, HZ).capture(0.4 * np.exp(1j * phase), np.random.default_rng(0)).phasor
    for place, (third, fifth) in enumerate(((0.108, 0.031), (0.0375, 0.01), (0.014, 0.003))):  # at HZ
        seen = 1 + third * np.exp(-4j * phase[..., place]) + fifth * np.exp(4j * phase[..., place])
        np.testing.assert_allclose(found[..., place], 0.4 * np.exp(1j * phase[..., place]) * seen, rtol=1e-9)


def test_measured_harmonics_replace_those_of_the_waveforms():
    square = replace(SQUARE, highest_harmonic=7, harmonics=((20e6, (0.01, 0.05)), (40e6, (0.0, 0.03, 0.02))))
    assert harmonics(square, 30e6) == pytest.approx({1: 1, 2: 0.005, 3: 0.04, 4: 0.01, 5: 1 / 25, 7: 1 / 49})
    assert harmonics(square, 10e6) == pytest.approx({1: 1, 2: 0.01, 3: 0.05, 5: 1 / 25, 7: 1 / 49})
    assert harmonics(replace(square, emitter_waveform="sinusoidal"), 90e6) == {1: 1, 3: 0.03, 4: 0.02}


def test_a_camera_extends_another(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('extends = "mlx75027"\nphase_steps = 8\n')
    assert load_sensor(file) == replace(load_sensor("mlx75027"), phase_steps=8)
    file.write_text('extends = "mine.toml"\n')
    with pytest.raises(PresetError, match="a circle has no beginning"):
        load_sensor(file)
