"""A modulation frequency that is not the one declared, by how the phases change over the image.

Over a wall, the phase at each frequency is the frequency times one and the same image of distances, plus an
offset. So the phases at two frequencies are a straight line of each other, whose slope is the ratio of the
frequencies, whatever the wall and the offsets.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from disk.frequency_text import megahertz
from itof.arrays import Floats, Phasors
from itof.wall.phase_defects import CLEAR
from itof.wall.wall_fit import RobustFit

_TRIED: Final = 5e-6  # mismatch of a fit from which another frequency is tried: 3 mrad
_PIXELS = 600  # that decide, about
_LARGEST = 20.0  # ratio of frequencies
_SLOPES = np.concatenate([sign * np.geomspace(0.1, _LARGEST, 1000) for sign in (1, -1)])
_LINE: Final = 1e-3  # mismatch of a straight line: 45 mrad
_APART = 0.02  # of the logarithm of a ratio: less is the error of a camera's waves


def other_frequency(phasor: Phasors, fit: RobustFit) -> str:
    """Which frequency of phasors (H, W, F) was declared wrongly; empty if none, or if that is not clear.

    Straight lines must explain the phases much better than the fit of the wall does, and better than the fit
    with the waves of a camera: of a frontal wall, whose phases change little, these look like another slope.
    """
    frequencies_hz = fit.wall.frequencies_hz
    count = len(frequencies_hz)
    if count == 1 or fit.mismatch < _TRIED:
        return ""
    used = np.flatnonzero(fit.weight > 0)
    used = used[:: max(1, len(used) // _PIXELS)]
    pixels, first = phasor.reshape(-1, count)[used], int(np.argmin(frequencies_hz))
    weight = np.abs(pixels[:, first]).astype(np.float64) ** 2
    weight /= weight.sum()
    around = pixels[:, first] / np.abs(pixels[:, first])
    around = np.angle(around * (weight @ around).conj())
    # The same without turns, if the fit is near enough.
    depth_m = (fit.wall.radial_depth_m + fit.shift_m).reshape(-1)[used]
    whole = fit.wall.slope[first] * depth_m + fit.residual_rad.reshape(-1, count)[used, first]
    lines = [_scales(pixels, angle - weight @ angle, weight, frequencies_hz) for angle in (around, whole)]
    scale, left = min(lines, key=lambda each: each[1])
    of_waves = float((1 - np.tensordot(fit.weight, np.cos(fit.rest_rad), axes=2)).max())
    if left > min(_LINE, CLEAR * fit.mismatch, of_waves):
        return ""
    spread = [float(np.ptp(np.log(np.delete(scale, place)))) for place in range(count)]
    wrong = [int(np.argmin(spread))] if count > 2 else [0, 1]
    true_hz = [
        frequencies_hz[place] * scale[place] / np.exp(np.log(np.delete(scale, place)).mean())
        for place in wrong
    ]
    if abs(np.log(true_hz[0] / frequencies_hz[wrong[0]])) < max(_APART, 2 * min(spread)):
        return ""
    given = megahertz(*(frequencies_hz[place] for place in wrong), between=" and ")
    like = megahertz(*true_hz, between=" or ", digits=3)
    if count == 2:
        return f"the phases at {given} do not fit each other: is one of them {like}, respectively?"
    rest = megahertz(*(each for place, each in enumerate(frequencies_hz) if place not in wrong))
    return f"the phases at {given} do not fit those at {rest}: they are those of about {like}"


def _scales(
    pixels: Phasors, angle: Floats, weight: Floats, frequencies_hz: tuple[float, ...]
) -> tuple[Floats, float]:
    """(F,) true over declared frequencies, up to a common factor; and what straight lines leave.

    `angle` (n,) are the phases of pixels (n, F) at the lowest frequency. The second result is the largest
    mean of 1 - cos of phase errors, like the mismatch of a fit; 1 if a phase falls where another one grows.
    """
    first = int(np.argmin(frequencies_hz))
    turn = np.exp(1j * np.angle(pixels))
    waves = np.exp(-1j * np.outer(_SLOPES, angle)) * weight  # (R, n)
    scale, left = np.ones(len(frequencies_hz)), [0.0]
    for place, frequency_hz in enumerate(frequencies_hz):
        if place == first:
            continue
        slope = float(_SLOPES[np.abs(waves @ turn[:, place]).argmax()])
        apart = turn[:, place] * np.exp(-1j * slope * angle)
        apart = np.angle(apart * (weight @ apart).conj())
        slope += float((weight * angle) @ apart / max((weight * angle) @ angle, 1e-300))
        apart = turn[:, place] * np.exp(-1j * slope * angle)
        left.append(float(1 - abs(weight @ apart)) if slope > 0 else 1.0)
        scale[place] = abs(slope) * frequencies_hz[first] / frequency_hz
    return scale, max(left)
