"""Whether the probabilities of a network, and the errors that it expects of its depth, hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from model.prediction.expected_error import probabilities

BINS: Final = 20  # of the probability
_ERRORS_M: Final = np.geomspace(5e-4, 0.5, 19)  # edges of the bins of the expected error of the depth


@dataclass(frozen=True)
class Reliability:
    """Pixels by their predicted probability of showing the object; empty bins are left out.

    Attributes
    ----------
    predicted : mean probability of the pixels of each bin, ascending.
    observed : part of these pixels that shows the object.
    pixels : their number.
    """

    predicted: tuple[float, ...]
    observed: tuple[float, ...]
    pixels: tuple[int, ...]

    @property
    def calibration_error(self) -> float | None:
        """Mean |predicted - observed| over the pixels of all bins but the first and the last.

        Nearly all pixels are in these two, where every network is right. None if no pixel is between them.

        Source: the expected calibration error of Naeini et al., "Obtaining well calibrated probabilities
        using Bayesian binning", AAAI 2015, without the two bins.
        """
        inner = [
            (n, abs(p - seen))
            for p, seen, n in zip(self.predicted, self.observed, self.pixels, strict=True)
            if 1 / BINS <= p < 1 - 1 / BINS
        ]
        if not inner:
            return None
        return sum(n * gap for n, gap in inner) / sum(n for n, _ in inner)

    def as_data(self) -> dict[str, Any]:
        """The curve as plain data."""
        return {**asdict(self), "calibration_error": self.calibration_error}


class _BinMeans:
    """Means of what was expected and of what was there, over the pixels of each bin."""

    def __init__(self, bins: int) -> None:
        self._sums = np.zeros((3, bins))  # pixels, expected, there

    def add(self, places: NDArray[np.intp], expected: NDArray[Any], there: NDArray[Any]) -> None:
        """Add pixels (n,) in the bins `places`."""
        for total, weights in zip(self._sums, (None, expected, there), strict=True):
            total += np.bincount(places, weights, minlength=len(total))

    def curve(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[int, ...]]:
        """Both means and the number of pixels of the bins that are not empty."""
        count, expected, there = self._sums[:, self._sums[0] > 0]
        return (
            tuple((expected / count).tolist()),
            tuple((there / count).tolist()),
            tuple(count.astype(int).tolist()),
        )


class ReliabilityCount:
    """Counts the pixels of many images for a `Reliability`."""

    def __init__(self) -> None:
        self._means = _BinMeans(BINS)

    def add(self, phasor: NDArray[np.complexfloating[Any, Any]], mask_gt: NDArray[np.uint8]) -> None:
        """Add images (..., H, W): predicted phasors, whose amplitude is the probability, and true mask."""
        probability = probabilities(phasor).ravel()
        places = np.minimum((probability * BINS).astype(np.intp), BINS - 1)
        self._means.add(places, probability, (mask_gt > 0).ravel())

    def curve(self) -> Reliability:
        """The curve of all images so far."""
        return Reliability(*self._means.curve())


@dataclass(frozen=True)
class DepthReliability:
    """Object pixels that were found, by the expected error of their depth; empty bins are left out.

    Attributes
    ----------
    expected_m : mean expected error of the pixels of each bin, metres, ascending.
    actual_m : mean absolute error of the depth of these pixels, metres.
    pixels : their number.
    """

    expected_m: tuple[float, ...]
    actual_m: tuple[float, ...]
    pixels: tuple[int, ...]

    @property
    def means_m(self) -> tuple[float, float]:
        """Expected and actual error as means over all these pixels, metres."""
        expected_m, actual_m = (
            float(np.average(values, weights=self.pixels)) for values in (self.expected_m, self.actual_m)
        )
        return expected_m, actual_m

    def as_data(self) -> dict[str, Any]:
        """The curve and its means as plain data."""
        expected_m, actual_m = self.means_m
        return {**asdict(self), "mean_expected_m": expected_m, "mean_actual_m": actual_m}


class DepthReliabilityCount:
    """Counts the pixels of many images for a `DepthReliability`."""

    def __init__(self) -> None:
        self._means = _BinMeans(len(_ERRORS_M) + 1)

    def add(
        self,
        prediction: DepthMap,
        radial_depth_gt_m: NDArray[np.float32],
        mask_gt: NDArray[np.uint8],
    ) -> None:
        """Add images (..., H, W): predictions, true radial depth in metres and true mask."""
        if prediction.depth_error_m is None:
            return
        found = prediction.mask & (mask_gt > 0)
        expected_m = prediction.depth_error_m[found].astype(np.float64)
        actual_m = np.abs(prediction.radial_depth_m[found].astype(np.float64) - radial_depth_gt_m[found])
        self._means.add(np.searchsorted(_ERRORS_M, expected_m), expected_m, actual_m)

    def curve(self) -> DepthReliability | None:
        """The curve of all images so far; None without a pixel that has an expected error."""
        expected_m, actual_m, pixels = self._means.curve()
        return DepthReliability(expected_m, actual_m, pixels) if pixels else None
