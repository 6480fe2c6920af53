"""Whether the probabilities of a network hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from model.prediction.expected_error import probabilities

BINS: Final = 20  # of the probability


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


class ReliabilityCount:
    """Counts the pixels of many images for a `Reliability`."""

    def __init__(self) -> None:
        self._pixels, self._probable, self._shown = np.zeros((3, BINS))

    def add(self, phasor: NDArray[np.complexfloating[Any, Any]], mask_gt: NDArray[np.uint8]) -> None:
        """Add images (..., H, W): predicted phasors, whose amplitude is the probability, and true mask."""
        probability = probabilities(phasor).ravel()
        places = np.minimum((probability * BINS).astype(np.intp), BINS - 1)
        for total, weights in (
            (self._pixels, None),
            (self._probable, probability),
            (self._shown, (mask_gt > 0).ravel()),
        ):
            total += np.bincount(places, weights, minlength=BINS)

    def curve(self) -> Reliability:
        """The curve of all images so far."""
        there = self._pixels > 0
        count = self._pixels[there]
        return Reliability(
            tuple((self._probable[there] / count).tolist()),
            tuple((self._shown[there] / count).tolist()),
            tuple(count.astype(int).tolist()),
        )
