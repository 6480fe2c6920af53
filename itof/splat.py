"""How returns are put into time bins, and what that does to the phasors of the bins.

A B-spline splat of order p spreads a return over p bins. With x = f w / c, the bin width in wavelengths, and
u, the position of the return between two bin centres in bins, its phasor becomes

    sum_n B_p(u - n) exp(2j π x n) = exp(2j π x u) sum_m sinc^p(x + m) exp(2j π m u).

The term m = 0 is a factor that all returns share, the transfer function; `itof.MeasurementMatrix` divides by
it. The terms that are left, relative to it, are the residue. It differs from return to return, so that
nothing can divide it out. docs/science/renderer.md (Time-resolved output) derives both.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof.light import SPEED_OF_LIGHT, phase_per_metre

Splat = Literal["point", "tent", "quadratic"]
SPLATS: tuple[Splat, ...] = ("point", "tent", "quadratic")
_ORDER = {"point": 0, "tent": 2, "quadratic": 3}  # p; 0: Φ divides by nothing
# A return is spread over bins whose centres are at most so far from it, whatever the splat.
WIDEST_REACH_BINS = max(_ORDER.values()) / 2
_BISECTIONS = 60  # halve the interval to less than a rounding error


def splat_transfer(frequency_hz: ArrayLike, bin_width_m: float, splat: Splat) -> NDArray[np.float64]:
    """Factor sinc^p(f w / c) by which a splat multiplies the phasors of all returns; 1 for ``point``."""
    # numpy's sinc(x) is sin(πx) / (πx)
    return np.sinc(_wavelengths(frequency_hz, bin_width_m)) ** _ORDER[splat]


def splat_residue(frequency_hz: ArrayLike, bin_width_m: float, splat: Splat) -> NDArray[np.float64]:
    """Largest error of Φ x that bins cause, relative to the light in them.

    Φ has divided by `splat_transfer`. With x = f w / c, what is left of a return at the worst place between
    two bin centres is

    - ``quadratic``: sum_{m≠0} |x / (x + m)|³, at most (x / (1 - x))³ + (x / (1 + x))³
      + x³ / 2 [(3/2 - x)^-2 + (3/2 + x)^-2], about 2.4 x³. No return reaches it: the worst has 2.0 x³.
    - ``tent``: sum_{m≠0} (x / (x + m))² = sinc^-2(x) - 1, about 3.3 x²; reached at bin centres.
    - ``point``: 2 sin(π x / 2), about π x. Each return counts at the nearest bin centre, and Φ divides by
      nothing. (The sum over m does not converge absolutely for p = 1; this is its exact value.)

    Light that is spread over bins has a smaller one.

    Parameters
    ----------
    frequency_hz : modulation frequencies, Hz.
    bin_width_m : bin width in *optical path length* (out and back), metres.

    Returns
    -------
    A number, or an array of the shape of `frequency_hz`.

    Raises
    ------
    ValueError : a frequency at or above c / (2 bin_width_m), which these bins cannot resolve.

    Source: docs/science/renderer.md, for the weights of Hockney & Eastwood, Computer Simulation Using
    Particles, 1988, ch. 5.
    """
    x = _wavelengths(frequency_hz, bin_width_m)
    if np.any(x >= 0.5):
        raise ValueError(f"bins of {bin_width_m} m resolve frequencies below {_nyquist_hz(bin_width_m):g} Hz")
    if splat == "point":
        return 2 * np.sin(np.pi * x / 2)
    if splat == "tent":
        return np.sinc(x) ** -2 - 1
    nearest = (x / (1 - x)) ** 3 + (x / (1 + x)) ** 3  # m = -1 and 1
    # The integral of the convex function |m + x|^-3 from 3/2 on is above its sum from m = 2 on.
    return nearest + x**3 / 2 * ((1.5 - x) ** -2 + (1.5 + x) ** -2)


def highest_frequency_hz(bin_width_m: float, splat: Splat, residue: float) -> float:
    """Highest frequency that bins carry with a `splat_residue` of at most `residue`, Hz."""
    low, high = 0.0, _nyquist_hz(bin_width_m)
    for _ in range(_BISECTIONS):  # the residue grows with the frequency
        middle = (low + high) / 2
        if splat_residue(middle, bin_width_m, splat) <= residue:
            low = middle
        else:
            high = middle
    return low


def _nyquist_hz(bin_width_m: float) -> float:
    return SPEED_OF_LIGHT / (2 * bin_width_m)


def _wavelengths(frequency_hz: ArrayLike, bin_width_m: float) -> NDArray[np.float64]:
    """Bin widths in wavelengths, x = f w / c."""
    return np.asarray(phase_per_metre(frequency_hz)) * bin_width_m / (2 * np.pi)
