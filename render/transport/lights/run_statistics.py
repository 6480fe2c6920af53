"""Error of the mean of independent runs, from their scatter.

The runs that estimate the error are those of the result (docs/science/renderer.md, Error estimate).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

CONFIDENCE = 0.975  # of the bound for normally distributed runs; rare bright points leave about 0.95


def relative_bound(z: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(F,) upper bound of ‖z̄ - truth‖ / ‖z̄‖ over P points, which holds with `CONFIDENCE` for normal runs.

    With the covariance C of the 2 P real numbers of a run, R ‖z̄ - truth‖² is distributed like sum λ χ²_1 over
    the eigenvalues λ of C. By Satterthwaite, that is tr C χ²_n / n with n = (tr C)² / tr C² degrees of
    freedom, and the estimate of tr C from R runs has n (R - 1). Their ratio follows Fisher's distribution.
    Both traces come from the R x R inner products of the deviations.

    Parameters
    ----------
    z : (R, P, F) values of R independent runs, at least 2.

    Raises
    ------
    ValueError : a value that is not finite.

    Source: Satterthwaite 1946, "An approximate distribution of estimates of variance components".
    """
    if not np.isfinite(z).all():
        raise ValueError("a value is not finite")
    runs = len(z)
    mean = z.mean(axis=0)
    off = np.moveaxis(z - mean, -1, 0)  # (F, R, P)
    inner = (off @ np.conj(np.swapaxes(off, 1, 2))).real / (runs - 1)  # (F, R, R)
    trace = np.trace(inner, axis1=1, axis2=2)
    square = (inner**2).sum(axis=(1, 2))
    freedom = np.clip(np.divide(trace**2, square, out=np.ones_like(trace), where=square > 0), 1, runs - 1)
    norm = np.linalg.norm(mean, axis=0)
    quantile = fisher.ppf(CONFIDENCE, freedom, freedom * (runs - 1))
    bound = np.sqrt(quantile * trace / runs)
    return np.divide(bound, norm, out=np.zeros_like(bound), where=norm > 0)


def common_part(difference: NDArray[np.complex128], norm: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,) size of what differences of independent runs have in common, relative to `norm` (F,).

    ‖mean‖² less its expectation if the runs had nothing in common, their variance over R. So the noise of the
    runs does not count.

    Parameters
    ----------
    difference : (R, P, F) values of R runs.
    """
    runs = len(difference)
    mean = difference.mean(axis=0)
    noise = (np.abs(difference - mean) ** 2).sum(axis=(0, 1)) / (runs * (runs - 1))
    size = np.sqrt(np.maximum((np.abs(mean) ** 2).sum(axis=0) - noise, 0))
    return np.divide(size, norm, out=np.zeros_like(size), where=norm > 0)


def needed_points(tried: int, error: float, wanted: float) -> float:
    """Points of a run that have the wanted error, if `tried` points have `error` and it falls as N^-3/4."""
    return tried * (error / wanted) ** (4 / 3)
