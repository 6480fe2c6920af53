"""Relations between modulation frequency, optical path length, phase and depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPEED_OF_LIGHT = 299_792_458.0  # m/s, exact by SI definition
OFFSET_STD_RAD = 0.1  # phase offsets of a camera that its maker calibrated, if nothing else is known: ours


def phase_per_metre(frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Phase that a modulation gains per metre of optical path length, rad/m: 2π f / c.

    Parameters
    ----------
    frequency_hz : modulation frequency or frequencies, Hz, each above 0.

    Raises
    ------
    ValueError : a frequency that is not a positive number.
    """
    frequencies_hz = np.asarray(frequency_hz, dtype=np.float64)
    if not np.all(np.isfinite(frequencies_hz) & (frequencies_hz > 0)):
        raise ValueError(f"modulation frequencies must be positive numbers of Hz, got {frequencies_hz}")
    return 2 * np.pi * frequencies_hz / SPEED_OF_LIGHT


def unambiguous_range_m(frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Depth (half the optical path) at which the phase wraps, metres: c / 2f; 7.49 m at 20 MHz."""
    return np.pi / phase_per_metre(frequency_hz)


def amplitude(phasor: ArrayLike) -> NDArray[np.float64]:
    """A = |z|, any shape, in the unit of `phasor`."""
    return np.abs(np.asarray(phasor))


def phase(phasor: ArrayLike) -> NDArray[np.float64]:
    """phi = atan2(Im z, Re z) in [0, 2π), radians, any shape; 0 where the phasor is 0."""
    wrapped = np.mod(np.angle(np.asarray(phasor, dtype=np.complex128)), 2 * np.pi)
    # mod(-tiny, 2π) is rounded to 2π, which is outside the half-open interval.
    return np.where(wrapped >= 2 * np.pi, 0.0, wrapped)


def depth_from_phase(phase_rad: ArrayLike, frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Radial depth of a single return, metres: d = c phi / (4π f), in [0, c / 2f) for phi in [0, 2π).

    `phase_rad` and `frequency_hz` broadcast against each other. Depth is half the optical path.
    """
    opl_m = np.asarray(phase_rad, dtype=np.float64) / phase_per_metre(frequency_hz)
    return opl_m / 2  # depth is half the optical path: out and back


def phasor_of_return(radial_depth_m: ArrayLike, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
    """Phasor of amplitude 1 of a single return from depth d: exp(j 4π f d / c). Inputs broadcast."""
    opl_m = 2 * np.asarray(radial_depth_m, dtype=np.float64)  # the optical path goes out and back
    return np.exp(1j * phase_per_metre(frequency_hz) * opl_m)
