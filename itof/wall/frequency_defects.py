"""A modulation frequency that is not the one declared, by how the phases change over the image.

Over a wall, the phase at each frequency is the frequency times one and the same image of distances, plus an
offset. So the phases at two frequencies are a straight line of each other, whose slope is the ratio of the
frequencies, whatever the wall and the offsets.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from itof.arrays import Floats, Phasors
from itof.light import megahertz
from itof.wall.phase_defects import CLEAR

_TRIED: Final = 5e-6  # mismatch of a fit from which another frequency is tried: 3 mrad
_PIXELS = 600  # that decide, about
_LARGEST = 20.0  # ratio of frequencies
_RATIOS = np.concatenate([sign * np.geomspace(0.1, _LARGEST, 1000) for sign in (1, -1)])
_LINE: Final = 1e-3  # mismatch of a straight line: 45 mrad
_APART = 0.02  # of the logarithm of a ratio: less is the error of a camera's waves


def other_frequency(phasor: Phasors, frequencies_hz: tuple[float, ...], mismatch: float) -> str:
    """Which frequency of phasors (H, W, F) was declared wrongly; empty if none, or if that is not clear.

    Parameters
    ----------
    mismatch : that a fit of the wall leaves. Straight lines must explain the phases much better.
    """
    count = len(frequencies_hz)
    if count == 1 or mismatch < _TRIED:
        return ""
    scale, left = _scales(phasor, frequencies_hz)
    if left > min(_LINE, CLEAR * mismatch):
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
    like = " or ".join(f"{each / 1e6:.3g}" for each in true_hz) + " MHz"
    if count == 2:
        return f"the phases at {given} do not fit each other: is one of them {like}, respectively?"
    rest = megahertz(*(each for place, each in enumerate(frequencies_hz) if place not in wrong))
    return f"the phases at {given} do not fit those at {rest}: they are those of about {like}"


def _scales(phasor: Phasors, frequencies_hz: tuple[float, ...]) -> tuple[Floats, float]:
    """(F,) true over declared frequencies, up to a common factor; and what straight lines leave.

    The latter is the largest mean of 1 - cos of phase errors, like the mismatch of a fit; 1 if a phase falls
    where another one grows.
    """
    pixels = phasor[(phasor != 0).all(axis=-1)]
    pixels = pixels[:: max(1, len(pixels) // _PIXELS)]
    first = int(np.argmin(frequencies_hz))
    weight = np.abs(pixels[:, first]).astype(np.float64) ** 2
    weight /= weight.sum()
    turn = np.exp(1j * np.angle(pixels))
    angle = np.angle(turn[:, first] * (weight @ turn[:, first]).conj())
    about = angle - weight @ angle
    waves = np.exp(-1j * np.outer(_RATIOS, angle)) * weight  # (R, n)
    scale, left = np.ones(len(frequencies_hz)), []
    for place, frequency_hz in enumerate(frequencies_hz):
        if place == first:
            continue
        ratio = float(_RATIOS[np.abs(waves @ turn[:, place]).argmax()])
        apart = turn[:, place] * np.exp(-1j * ratio * angle)
        apart = np.angle(apart * (weight @ apart).conj())
        ratio += float((weight * about) @ apart / max((weight * about) @ about, 1e-300))
        apart = turn[:, place] * np.exp(-1j * ratio * angle)
        left.append(float(1 - abs(weight @ apart)) if ratio > 0 else 1.0)
        scale[place] = abs(ratio) * frequencies_hz[first] / frequency_hz
    return scale, max(left)
