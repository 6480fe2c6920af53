"""Depth from the phases at several frequencies, beyond the unambiguous range of each frequency."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof.light import phase_per_metre, unambiguous_range_m

DEFAULT_LIMIT_M = 100.0  # radial depth; more than the range of any iToF camera


def combined_range_m(frequencies_hz: Sequence[float]) -> float:
    """Unambiguous depth of all frequencies together, metres: c / (2 gcd); 14.99 m for 20, 50, 60 MHz."""
    phase_per_metre(frequencies_hz)  # raises ValueError for values that are not frequencies
    base = Fraction(round(frequencies_hz[0]))
    for frequency_hz in frequencies_hz[1:]:
        other = Fraction(round(frequency_hz))
        while other:
            base, other = other, base % other
    return float(unambiguous_range_m(float(base)))


def unwrap_depth(
    phase_rad: ArrayLike, frequencies_hz: Sequence[float], max_radial_depth_m: float | None = None
) -> NDArray[np.float64]:
    """Radial depth that fits the wrapped phases at all frequencies best.

    Every whole number of turns of the highest frequency gives a candidate depth. Each candidate predicts the
    numbers of turns of the other frequencies. With these numbers, the least-squares depth follows in closed
    form (weights f²: the same phase noise at every frequency). The candidate with the smallest phase residual
    is taken.

    Parameters
    ----------
    phase_rad : (..., F) phases, radians, modulo 2π.
    frequencies_hz : F modulation frequencies, Hz.
    max_radial_depth_m : search limit, metres. The default is the unambiguous depth of all frequencies
        together, but at most 100 m: frequencies without a large common divisor repeat only after millions of
        metres, and the work is proportional to the limit.

    Returns
    -------
    (...) float64 radial depth, metres, of a single return per pixel.

    Raises
    ------
    ValueError : the last axis does not match the frequencies, or the limit is not positive.

    Source: Droeschel, Holz, Behnke, "Multi-frequency phase unwrapping for time-of-flight cameras",
    IROS 2010 (candidate wraps judged by their residual); the least-squares refinement is ours.
    """
    phi = np.asarray(phase_rad, dtype=np.float64)
    if phi.ndim == 0 or phi.shape[-1] != len(frequencies_hz):
        raise ValueError(f"expected {len(frequencies_hz)} phases on the last axis, got shape {phi.shape}")
    limit_m = max_radial_depth_m
    if limit_m is None:
        limit_m = min(combined_range_m(frequencies_hz), DEFAULT_LIMIT_M)
    if not limit_m > 0:
        raise ValueError(f"the depth limit must be positive, got {limit_m} m")

    slope = 2 * phase_per_metre(frequencies_hz)  # (F,), rad per metre of depth: the path goes out and back
    fastest = int(np.argmax(slope))
    start_m = np.mod(phi[..., fastest], 2 * np.pi) / slope[fastest]  # (...)
    best_depth_m = np.zeros(phi.shape[:-1])
    best_cost = np.full(phi.shape[:-1], np.inf)
    step_m = 2 * np.pi / slope[fastest]
    for turn in range(int(np.ceil(limit_m / step_m))):
        candidate_m = start_m + turn * step_m  # (...)
        wraps = np.round((candidate_m[..., None] * slope - phi) / (2 * np.pi))  # (..., F)
        unwrapped = phi + 2 * np.pi * wraps  # (..., F)
        depth_m = (unwrapped * slope).sum(-1) / (slope**2).sum()  # least squares of unwrapped = slope * depth
        cost = ((unwrapped - depth_m[..., None] * slope) ** 2).sum(-1)
        # The margin makes the nearer of two equal candidates win in spite of rounding.
        better = (cost < best_cost - 1e-12) & (candidate_m < limit_m)
        best_depth_m = np.where(better, depth_m, best_depth_m)
        best_cost = np.where(better, cost, best_cost)
    return best_depth_m
