"""Phase steps and taps: the weights with which the numbers of a pixel add up to its phasor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_FEWEST = 3  # samples of a period that tell amplitude, phase and background
_SHORT = 1e-6  # smallest singular value over the largest, below which a phase is not told


def phasor_weights(steps_rad: Sequence[float], taps_rad: Sequence[float]) -> NDArray[np.complex128]:
    """(S T) complex weights of the numbers of S steps and T taps whose sum is the phasor.

    The numbers of tap t in step s are b_t + A cos(φ - θ_s - τ_t); b_t holds the background, dark current and
    offset of the tap. Least squares give A exp(j φ), and T times this is the phasor of all light. With one or
    two steps, the taps must share one background. For differences (T = 1) in N even steps this is
    2 / N sum_n D_n exp(j θ_n), the formula of `itof.sensor.demodulation`.

    Raises
    ------
    ValueError : the steps and taps do not tell a phase.
    """
    steps, taps = np.array(steps_rad), np.array(taps_rad)
    angle = (steps[:, None] + taps).reshape(-1)  # (S T,)
    own = len(steps) >= _FEWEST and len(taps) > 1
    background = np.tile(np.eye(len(taps)), (len(steps), 1)) if own else np.ones((len(angle), 1))
    model = np.concatenate([background, np.cos(angle)[:, None], np.sin(angle)[:, None]], axis=1)
    size = np.linalg.svd(model, compute_uv=False)
    if len(angle) < _FEWEST or size[-1] < _SHORT * size[0] or len(size) < model.shape[1]:
        raise ValueError(
            f"{len(steps)} steps and {len(taps)} taps do not tell amplitude, phase and background: give the "
            "phases of at least three different samples of a period by step_count or steps_rad, and by "
            "tap_count or taps_rad"
        )
    re, im = np.linalg.pinv(model)[-2:]
    return np.asarray(len(taps) * (re + 1j * im))
