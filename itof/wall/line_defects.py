"""Rows and columns of an image in a wrong order: repeated, exchanged, rolled, or shifted in a part of it.

The phase of a wall changes smoothly from line to line. *Bend* is a second difference across the lines,
averaged along a line. Limits are in radians, at any frequency.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.ndimage import binary_erosion

from itof.arrays import Floats, Phasors
from itof.wall.wall_fit import RobustFit

_AXES: Final = ("rows", "columns")
_REPEATED = 0.1  # part of the lines
_EXCHANGED = 5e-3  # median bend that calls for an explanation, and
_CLEARLY = 0.25  # what an explanation leaves of it
_BREAK = 0.1  # step of a rolled image where the first line is,
_ALONE = 5.0  # and over the step from its last line to the first, and over the median step
_LEAST = 1e-3  # of a step
_SEAM = 1e-5  # bend about a wall: less is rounding,
_OF_LIGHT = 0.04  # or an error of the hidden light that renders for a training may have
_ABOVE_OTHERS = 3.5  # times the largest bend away from it; up to 2.6 in 200 images of two presets
_FEWEST_OTHERS = 4
_WHOLE = 0.5  # of the median weight of a line


def lines_in_disorder(phasor: Phasors) -> str:
    """What is wrong with the order of the lines of an image (H, W, F); empty if nothing."""
    for axis, name in enumerate(_AXES):
        lines = np.moveaxis(phasor, axis, 0)
        lit = lines[(lines != 0).any(axis=(1, 2))]
        same = int((lit[1:] == lit[:-1]).all(axis=(1, 2)).sum())
        if same > max(1, _REPEATED * len(lit)):
            return f"{same + 1} {name} of the image are copies of each other"
        if len(lines) < 8:
            continue
        if _in_pairs_exchanged(lines):
            return f"{name} of the image seem exchanged in pairs"
        if by := _rolled(lines):
            return f"the image seems rolled: its first {by} {name} belong to the other side"
    return ""


def seam(fit: RobustFit) -> str:
    """Where an image is put together of parts that do not fit each other; empty if nowhere."""
    # Where a neighbour shows no wall, the wall may fill a part of the pixel: its mean path is another one.
    alone = binary_erosion(fit.weight > 0, np.ones((3, 3)), border_value=1)
    weight = fit.weight * fit.fits * alone
    least = max(_SEAM, _OF_LIGHT * _rms(weight, fit.residual_rad))
    for axis, name in enumerate(_AXES):
        left, strength = np.moveaxis(fit.residual_rad, axis, 0), np.moveaxis(weight, axis, 0)
        bend = left[2:] - 2 * left[1:-1] + left[:-2]  # (n - 2, m, F)
        both = np.minimum(np.minimum(strength[2:], strength[1:-1]), strength[:-2])
        total = both.sum(axis=1)
        if not total.any():
            continue
        # Both the even and the odd pixels of a line: a few damaged ones are no seam.
        size = np.minimum(*(_size(both[:, some::2], bend[:, some::2]) for some in range(2)))
        size *= np.sqrt(total / total.max()) * (total > _WHOLE * np.median(total))  # dim lines are noisier
        place = int(size.argmax())
        others = np.delete(size, slice(max(place - 1, 0), place + 2))
        if np.count_nonzero(others) < _FEWEST_OTHERS:
            continue
        if size[place] > max(least, _ABOVE_OTHERS * others.max()):
            return f"the phases have a seam near {name[:-1]} {place + 1}: shifted or foreign {name}?"
    return ""


def _rms(weight: Floats, phases: Floats) -> float:
    """Root mean square of phases (n, m, F) with weights (n, m)."""
    power = float((weight[..., None] * phases**2).sum()) / phases.shape[-1]
    return math.sqrt(power / max(float(weight.sum()), 1e-300))


def _size(weight: Floats, bend: Floats) -> Floats:
    """(n,) root mean square over the frequencies of the mean bends (n, m, F) of lines."""
    mean = (weight[..., None] * bend).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)[:, None]
    return np.asarray(np.sqrt((mean**2).mean(axis=-1)))


def _in_pairs_exchanged(lines: Phasors) -> bool:
    before = _median_bend(lines)
    if before < _EXCHANGED:
        return False
    starts = range(2)
    return any(_median_bend(_pairs_exchanged(lines[start:])) < _CLEARLY * before for start in starts)


def _pairs_exchanged(lines: Phasors) -> Phasors:
    even = len(lines) // 2 * 2
    return lines[:even].reshape(-1, 2, *lines.shape[1:])[:, ::-1].reshape(even, *lines.shape[1:])


def _median_bend(lines: Phasors) -> float:
    """Of the mean bends of lines (n, m, F), radians, at the frequency with the largest one."""
    strength, turn = np.abs(lines), np.exp(1j * np.angle(lines))
    weight = np.minimum(np.minimum(strength[2:], strength[1:-1]), strength[:-2])
    mean = (weight * turn[2:] * turn[1:-1].conj() ** 2 * turn[:-2]).sum(axis=1)  # (n - 2, F)
    return float(np.median(np.abs(np.angle(mean)), axis=0).max())


def _rolled(lines: Phasors) -> int:
    """By how many of its n lines (n, m, F) an image is rolled; 0 if it is not."""
    after = np.roll(lines, -1, axis=0)
    weight = np.minimum(np.abs(after), np.abs(lines))
    total = weight.sum(axis=1)  # (n, F)
    # (n, F) steps from each line to the next one, as on a ring
    step = (weight * np.abs(np.angle(after * lines.conj()))).sum(axis=1) / np.maximum(total, 1e-300)
    step = np.where(total > 0, step, 0)
    times = (step / np.maximum(np.maximum(np.median(step, axis=0), step[-1]), _LEAST)).max(axis=-1)  # (n,)
    place = int(times[:-1].argmax())
    others: Floats = np.delete(times, place)
    broken = step[place].max() > _BREAK and times[place] > max(_ALONE, 2 * others.max())
    return place + 1 if broken and total[[place, -1]].all() else 0
