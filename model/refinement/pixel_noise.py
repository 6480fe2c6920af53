"""The noise of a measurement, told from its light, which is smooth over the wall."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

_POWER: Final = 70.0  # of fourth differences of white noise: 1² + 4² + 6² + 4² + 1²
_FAR = 30.0  # medians of the modulus; noise differs between pixels, and edges are farther still
_ROUNDS = 4  # each with the weights that follow from the noise of the last one
_FAINTEST = 1e-3  # of the median amplitude: fainter pixels have the noise of these


def pixel_noise(phases: NDArray[np.float64], amplitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W) standard deviation of the white noise in phases (H, W, F) of smooth light, radians.

    A camera's variance is a sum of three parts: a constant one, that of shot noise, which falls with the
    amplitude, and that of read-out and rounding, which falls with its square. The parts are fitted to the
    squares of the fourth differences along rows, which hold almost nothing of the light, and noise with 70
    times its power. NaN and values far above the median, as at edges, are left out.

    Parameters
    ----------
    amplitude : (H, W) of the light, in any unit; where it is 0 or NaN, the noise is NaN.
    """
    lit = np.isfinite(amplitude) & (amplitude > 0)
    if phases.shape[1] < 5 or not lit.any():
        return np.where(lit, 0.0, np.nan)
    relative = np.where(lit, amplitude / np.median(amplitude[lit]), np.nan)
    parts = np.clip(relative, _FAINTEST, None)[..., None] ** np.array([0.0, -1.0, -2.0])  # (H, W, 3)
    rough = np.abs(np.diff(phases, 4, axis=1))  # (H, W - 4, F), about the third of five pixels
    known = np.isfinite(rough) & lit[:, 2:-2, None]
    of_value = np.broadcast_to(parts[:, 2:-2, None], (*rough.shape, 3))[known]
    squares = rough[known] ** 2 / _POWER
    shares, expected = np.zeros(3), of_value[:, 1]
    for _ in range(_ROUNDS if squares.any() else 0):
        over = np.sqrt(squares / expected)
        usual = over <= _FAR * np.median(over)
        rows = of_value[usual] / expected[usual, None]
        shares = nnls(rows, squares[usual] / expected[usual])[0]
        if not shares.any():
            break
        expected = of_value @ shares
    return np.asarray(np.sqrt(parts @ shares))
