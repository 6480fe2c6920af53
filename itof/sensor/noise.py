"""The closed form of a camera's noise."""

from __future__ import annotations

import numpy as np

from itof.arrays import N
from itof.sensor.demodulation import first_harmonic
from itof.sensor.light import ambient_rate_e_s
from itof.sensor.settings import SensorSettings


def difference_variance_e2(settings: SensorSettings, signal_e: N, ambient_e: N) -> N | float:
    """Variance of the difference of the taps of a sensor pixel in a raw frame, electrons squared.

    The electrons of signal, ambient light and dark current of both taps (Poisson), their read noise, and
    step² / 12 of the converter for either.

    Parameters
    ----------
    signal_e, ambient_e : electrons in both taps; scalars or arrays.
    """
    quiet = 2 * settings.read_noise_e**2 + (settings.adc_e_per_dn or 0.0) ** 2 / 6
    if not settings.shot_noise:
        return quiet
    return signal_e + ambient_e + 2 * settings.dark_current_e_s * settings.integration_s + quiet


def phase_noise_rad(settings: SensorSettings, signal_e: float, frequency_hz: float) -> float:
    """Standard deviation of the phase of one sensor pixel in one measurement of N raw frames, radians.

    sqrt(2 V / N) / (C S), with the variance V of a difference of taps.

    Parameters
    ----------
    signal_e : S, electrons of the emitter's light in both taps in a raw frame.

    Source: Lange and Seitz, "Solid-state time-of-flight range camera", IEEE J. Quantum Electronics 37, 2001,
    for four steps.
    """
    ambient_e = ambient_rate_e_s(settings) * settings.integration_s
    variance = difference_variance_e2(settings, signal_e, ambient_e)
    return float(
        np.sqrt(2 * variance / settings.phase_steps) / (first_harmonic(settings, frequency_hz) * signal_e)
    )
