"""Demodulation: what the taps of a pixel collect, and the phasor that a camera's firmware makes of it.

In the raw frame n of N, the reference of the first tap is at the phase θ_n = 2π n / N and the second tap has
the rest. For light of S electrons and phase φ their difference is

    D_n = S sum_h C_h cos(h (φ - θ_n)),    z = 2 / (N C_1) sum_n D_n exp(j θ_n).

C_h / C_1 follows from the waveforms of light and reference, and C_1 from the demodulation contrast, the
largest D / S. Harmonics for which h + 1 or h - 1 is a multiple of N fold into z: with four steps, the third
and the fifth make a phase error of four cycles, the wiggling of square-wave cameras. Harmonics are those of
the light of a pixel as a whole, 99.8 % of which is direct: their phase is h times that of the pixel.

Arrays may be of numpy or of any other library of the array API.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import zip_longest
from typing import TypeAlias

import numpy as np
from array_api_compat import array_namespace, device
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof.arrays import A, Array
from itof.sensor.settings import SensorSettings

Harmonics: TypeAlias = Mapping[int, float] | Mapping[int, Array]  # C_h / C_1 by h
_TABLE = 2**14  # steps of a period; linear interpolation errs by less than 1e-7


def first_harmonic(settings: SensorSettings, frequency_hz: float) -> float:
    """C_1 at a frequency."""
    frequencies_hz, values = zip(*settings.contrast, strict=True)
    parts = harmonics(settings, frequency_hz)
    wave = np.array([*parts.values()]) @ _cosines(tuple(parts))
    return float(np.interp(frequency_hz, frequencies_hz, values) / np.abs(wave).max())


def harmonics(settings: SensorSettings, frequency_hz: float) -> dict[int, float]:
    """C_h / C_1 of the harmonics that there are, by h.

    A square wave that is on for the part d of a period has the harmonics sin(π h d) / h; edges that rise
    within the time t multiply them by sinc(h f t). The reference is on for half of the period. Harmonics of
    both together are products. Those that the settings give as measured replace them.
    """
    parts = {1: 1.0}  # if one wave is sinusoidal, the other's harmonics find no partner
    if "sinusoidal" not in (settings.emitter_waveform, settings.reference_waveform):
        h = np.arange(1, settings.highest_harmonic + 1)
        light = np.sin(np.pi * h * settings.emitter_duty) * np.sinc(h * frequency_hz * settings.rise_time_s)
        product = light * np.sin(np.pi * h / 2) / h**2
        parts = dict(enumerate((product / product[0]).tolist(), 1))
    if settings.harmonics:
        frequencies_hz, rows = zip(*settings.harmonics, strict=True)
        measured = zip_longest(*rows, fillvalue=0.0)
        parts |= {
            h: float(np.interp(frequency_hz, frequencies_hz, each)) for h, each in enumerate(measured, 2)
        }
    return {count: part for count, part in parts.items() if abs(part) > 1e-12}


@cache
def _cosines(cycles: tuple[int, ...]) -> NDArray[np.float64]:
    """(len(cycles), 721) cosines of so many cycles over a period."""
    return np.cos(np.outer(cycles, np.linspace(0, 2 * np.pi, 721)))


def tap_differences(
    settings: SensorSettings, phasor: Array, frequency_hz: float, parts: Harmonics | None = None
) -> Array:
    """(..., N) expected differences of the taps for phasors (...) of one frequency, in their unit.

    `parts` replaces `harmonics`: numbers, or arrays (N, 1, 1) for N images (N, H, W) with waves of their own.
    """
    xp = array_namespace(phasor)
    real = xp.real(phasor).dtype
    steps = xp.asarray(_steps(settings), dtype=real, device=device(phasor))
    size, angle = xp.abs(phasor)[..., None], xp.atan2(xp.imag(phasor), xp.real(phasor))[..., None]
    total = xp.zeros((*phasor.shape, settings.phase_steps), dtype=real, device=device(phasor))
    for h, part in (parts or harmonics(settings, frequency_hz)).items():
        total = total + (part if isinstance(part, float) else part[..., None]) * xp.cos(h * (angle - steps))
    return first_harmonic(settings, frequency_hz) * size * total


def phasor_of_differences(settings: SensorSettings, differences: Array, frequency_hz: float) -> Array:
    """(...) phasors that the firmware makes of differences of the taps (..., N)."""
    xp = array_namespace(differences)
    steps = xp.asarray(_steps(settings), dtype=differences.dtype, device=device(differences))
    gain = 2 / (settings.phase_steps * first_harmonic(settings, frequency_hz))
    re, im = (xp.sum(differences * wave, axis=-1) for wave in (xp.cos(steps), xp.sin(steps)))
    return gain * (re + 1j * im)


def folded(settings: SensorSettings, phasor: A, frequency_hz: float, parts: Harmonics | None = None) -> A:
    """`phasor_of_differences` of `tap_differences`, from the harmonics that fold into the result.

    N steps see exp(j φ) where a harmonic h has exp(j h φ) and h - 1 is a multiple of N, and exp(-j h φ) where
    h + 1 is one: a few terms instead of all harmonics of all steps. `parts` is as in `tap_differences`.
    """
    xp, steps = array_namespace(phasor), settings.phase_steps
    size, angle = xp.abs(phasor), xp.atan2(xp.imag(phasor), xp.real(phasor))
    re, im = xp.zeros_like(size), xp.zeros_like(size)
    for h, part in (parts or harmonics(settings, frequency_hz)).items():
        for cycles in (h, -h):
            if (cycles - 1) % steps == 0:
                re, im = re + part * xp.cos(cycles * angle), im + part * xp.sin(cycles * angle)
    return size * (re + 1j * im)


def calibrated(
    settings: SensorSettings, phasor: NDArray[np.complex128], frequency_hz: float
) -> NDArray[np.complex128]:
    """Phasors (...) after the firmware took out what it knows of the waveforms' error.

    Light of the phase φ is measured as W(φ) exp(j φ). A table of W over the measured phase gives phase and
    amplitude back, which is exact for light without noise; the part `wiggling_left` of both errors stays.

    Raises
    ------
    ValueError : as `wiggling`.
    """
    if settings.wiggling_left == 1 or len(harmonics(settings, frequency_hz)) == 1:
        return phasor
    seen, error = wiggling(settings, frequency_hz)
    known = np.interp(np.angle(phasor), seen, np.log(error), period=2 * np.pi)
    return np.asarray(phasor * np.exp((settings.wiggling_left - 1) * known))


def wiggling(
    settings: SensorSettings, frequency_hz: float
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Measured phases of light at ascending phases, radians, and its measured over its true phasors.

    Raises
    ------
    ValueError : two phases of the light give the same measured phase, which no calibration can undo.
    """
    angle = np.linspace(-np.pi, np.pi, _TABLE + 1)
    light = np.exp(1j * angle)
    error = (
        phasor_of_differences(settings, tap_differences(settings, light, frequency_hz), frequency_hz) / light
    )
    seen = angle + np.unwrap(np.angle(error))
    if (np.diff(seen) <= 0).any():
        raise ValueError(
            f"light of several phases gives the same measured phase at {megahertz(frequency_hz)}, which no "
            "calibration undoes: use a larger emitter_duty or more phase_steps, or set wiggling_left to 1"
        )
    return seen, error


def _steps(settings: SensorSettings) -> NDArray[np.float64]:
    return 2 * np.pi * np.arange(settings.phase_steps) / settings.phase_steps
