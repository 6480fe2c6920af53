"""The error that a network expects of its own depth map, from its probabilities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap, depth_from_phase


def expected_mae_m(prediction: DepthMap) -> float:
    """MAE over all pixels that a network expects of its own depth map (H, W), metres.

    The amplitude of the phasor is the probability p that a pixel shows the object, at the depth d of its
    phase. A pixel of the mask is background with probability 1 - p, another one shows the object with
    probability p; the error is then d. A pixel of the mask that shows the object has the error that the
    network expects of its depth; 0 if it expects none.
    """
    probability = probabilities(prediction.phasor)
    depth_m = depth_from_phase(np.angle(prediction.phasor) % (2 * np.pi), prediction.frequency_hz)
    wrong = np.where(prediction.mask, 1 - probability, probability)  # (H, W)
    error_m = wrong * depth_m
    if prediction.depth_error_m is not None:
        error_m = error_m + np.where(prediction.mask, probability * prediction.depth_error_m, 0.0)
    return float(error_m.mean())


def probabilities(phasor: NDArray[np.complexfloating[Any, Any]]) -> NDArray[np.float64]:
    """(..., H, W) probability that a pixel shows the object: the amplitude of the predicted phasor."""
    probability: NDArray[np.float64] = np.minimum(np.abs(phasor).astype(np.float64), 1.0)
    return probability
