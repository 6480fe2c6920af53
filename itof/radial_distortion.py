"""Radial distortion of a lens: at the distance 1, the radius r is shown at r (1 + k1 r² + k2 r⁴ + ...).

Source: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32, 1966.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_Radii = TypeVar("_Radii", float, NDArray[np.float64])
_REAL = 1e-6  # imaginary over absolute value of a root that is real, but for rounding
_HALVINGS = 60  # of the interval in which a radius is searched: to the last bit of a float64
_LEAST = 1e-3  # radius from which the search of an upper limit starts


def radial_factor(square: _Radii, coefficients: Sequence[float]) -> _Radii:
    """(...) factor 1 + k1 s + k2 s² + ... of radii with the squares s (...)."""
    total = 0 * square
    for coefficient in reversed(coefficients):
        total = square * (coefficient + total)
    return 1 + total


def turning_square(coefficients: Sequence[float]) -> float:
    """Smallest r² where the radius that is shown stops growing with r; infinite if it always grows.

    Rays beyond it are folded back: the distortion does not hold there.
    """
    # The slope 1 + 3 k1 s + 5 k2 s² + ... for s = r² is 0; with u = 1 / s the highest factor is 1.
    slope = [1.0, *((2 * place + 3) * factor for place, factor in enumerate(coefficients))]
    roots = np.roots(slope)
    real = roots.real[np.abs(roots.imag) <= _REAL * np.abs(roots)]
    largest = float(real.max(initial=0.0))
    return 1 / largest if largest > 0 else np.inf


def undistorted_radius(shown: NDArray[np.float64], coefficients: Sequence[float]) -> NDArray[np.float64]:
    """(...) radii that the lens shows at the radii `shown` (...), which it must reach before it folds.

    By bisection between 0 and the radius up to which the shown radius grows.
    """

    def is_below(radius: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(radius * radial_factor(radius**2, coefficients) < shown)

    turning = np.sqrt(turning_square(coefficients))
    high = np.full(shown.shape, turning) if np.isfinite(turning) else np.maximum(shown, _LEAST)
    while np.isinf(turning) and is_below(high).any():
        high = np.where(is_below(high), 2 * high, high)
    low = np.zeros(shown.shape)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        below = is_below(middle)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2
