"""What makes phasors no image of a scene, whatever it shows: noise, few bits, lines or planes in disorder.

Nothing is known here of walls, except in `fit_defects`. Valid measurements have no such finding
(`benchmarks/foreign_measurements.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from disk.frequency_text import megahertz
from itof.arrays import Floats, Phasors
from itof.light import phase_per_metre
from itof.unwrapping import unwrap_depth
from itof.wall.finding import Finding
from itof.wall.line_defects import lines_in_disorder, seam
from itof.wall.wall_fit import RobustFit

NOISE_RAD: Final = 0.3  # of a pixel's phase; 9.6 % of the pixels then leave the phase of a wall by 0.5 rad
_FEWEST_BENDS = 30  # that tell noise
_COARSE = 2**8  # different numbers, of either sign
_TIMES = 8  # a number of a coarse image is there; mirror images of a wall repeat it four times
_UNLIKE = 0.02  # spread of the amplitude at a frequency over the mean one that calls for an explanation
_CLEARLY = 0.5  # of it that an explanation leaves
_DIM = 0.1  # of the median amplitude; darker pixels tell nothing about rounding
_ROUNDED = 2.0  # noise of a coarse image over that of rounding
_SAME_RAD = 2e-6  # phases of one depth; rounding of complex64 is 6e-8
_FLAT_RAD = 1e-5  # of a computed wall, which one depth explains as well
_NEAREST_M = 1e-3
_MOST = 0.9  # of the pixels
_MOST_FREQUENCIES = 4  # of which all pairs of planes are tried


def image_defects(phasor: Phasors, frequencies_hz: tuple[float, ...]) -> Iterator[Finding]:
    """What is wrong with phasors (H, W, F), which are then refused.

    Raises
    ------
    ValueError : values that are not finite.
    """
    if not np.isfinite(phasor).all():
        raise ValueError("the phasors hold NaN or infinite values")
    parts = np.ascontiguousarray(phasor, dtype=np.complex128).view(np.float64)
    phasor = (parts / max(float(np.abs(parts).max(initial=0)), 1e-300)).view(np.complex128)
    pixels = phasor[(phasor != 0).all(axis=-1)]
    if (pixels == pixels[:1]).all():
        return  # also if there are none: other checks say so
    noise_rad = phase_noise_rad(phasor)  # (F,)
    if words := lines_in_disorder(phasor):
        yield Finding("convention", words, True)
    elif noise_rad.max() > NOISE_RAD:
        noisy = [f for f, each in zip(frequencies_hz, noise_rad, strict=True) if each > NOISE_RAD]
        words = (
            f"the phases at {megahertz(*noisy)} are noise: those of neighbouring pixels have little in common"
        )
        yield Finding("no-wall", words + "; too little light, another array, or wrong axes?", True)
    elif count := _few_numbers(pixels, float(noise_rad.max())):
        words = f"the phasors hold only {count} different numbers, as of 8 bits: too coarse for hidden light"
        yield Finding("no-hidden-light", words, True)
    elif words := _mixed_planes(pixels, frequencies_hz):
        yield Finding("convention", words, True)


def fit_defects(phasor: Phasors, fit: RobustFit) -> Iterator[Finding]:
    """The same of what a fit of the wall leaves of phasors (H, W, F)."""
    if words := seam(fit):
        yield Finding("convention", words, True)
    yield from depth_defects(phasor, fit.wall.frequencies_hz, fit.wall.rays)


def depth_defects(phasor: Phasors, frequencies_hz: tuple[float, ...], rays: Floats) -> Iterator[Finding]:
    """The same of phasors (H, W, F) all of whose phases are those of one depth, which is not a plane's.

    `rays` (H, W, 3) are those of the pixels.
    """
    if len(frequencies_hz) == 1:
        return
    # the brighter half: far pixels may be beyond the unambiguous range
    strength = np.abs(phasor).min(axis=-1)
    if not strength.any():
        return
    used = strength >= np.median(strength[strength > 0])
    slope = 2 * phase_per_metre(frequencies_hz)
    angle, rays = np.angle(phasor[used]), rays[used]
    depth_m = np.maximum(unwrap_depth(angle, frequencies_hz), _NEAREST_M)
    left = np.angle(np.exp(1j * (angle - slope * depth_m[:, None])))
    if np.quantile(np.abs(left).max(axis=-1), _MOST) > _SAME_RAD:
        return
    plane = np.linalg.lstsq(rays, 1 / depth_m, rcond=None)[0]
    bump_m = (rays @ plane - 1 / depth_m) * depth_m**2
    if np.abs(bump_m).max() * slope.max() > _FLAT_RAD:
        words = "no hidden light can be in it: the phases at all frequencies are those of one depth image"
        yield Finding("no-hidden-light", words, True)


def phase_noise_rad(phasor: Phasors) -> Floats:
    """(F,) noise of a pixel's phase by second differences in a row, radians; about 1 for random phases.

    The mean of e^{j bend} over the pixels is exp(-3 noise²) for noise of a normal distribution.
    """
    strength = np.abs(phasor)
    weight = np.minimum(np.minimum(strength[:, 2:], strength[:, :-2]), strength[:, 1:-1])
    if np.count_nonzero(weight.all(axis=-1)) < _FEWEST_BENDS:
        return np.zeros(phasor.shape[-1])
    turn = np.exp(1j * np.angle(phasor))
    bend = turn[:, 2:] * turn[:, 1:-1].conj() ** 2 * turn[:, :-2]
    agreement = np.abs((weight * bend).sum(axis=(0, 1))) / weight.sum(axis=(0, 1))
    return np.asarray(np.sqrt(-np.log(np.clip(agreement, 1e-6, 1)) / 3))


def _few_numbers(pixels: Phasors, noise_rad: float) -> int:
    """How many numbers the parts or phases of pixels (n, F) have, if they are rounded to few; else 0."""
    strength, angle = np.abs(pixels), np.round(np.angle(pixels), 6)
    strength = np.maximum(strength, _DIM * np.median(strength))
    parts = np.abs(np.stack([pixels.real, pixels.imag]))
    in_parts, in_phase = len(np.unique(parts)), len(np.unique(angle))
    if in_phase <= _TIMES:
        return 0  # the phase is even
    # Noise of rounding, weighted as that of neighbours.
    part_rad = parts.max() / max(in_parts, 1) * np.sqrt((1 / strength).mean() / strength.mean() / 12)
    if in_parts <= min(_COARSE, parts.size / _TIMES) and noise_rad < _ROUNDED * part_rad:
        return in_parts
    return in_phase if in_phase <= min(_COARSE, angle.size / _TIMES) else 0


def _mixed_planes(pixels: Phasors, frequencies_hz: tuple[float, ...]) -> str:
    """What is wrong if the amplitudes of pixels (n, F) are alike only with other pairs of planes.

    Light of one wall has the same amplitude at all frequencies, up to a factor.
    """
    count = pixels.shape[-1]
    if not 1 < count <= _MOST_FREQUENCIES or len(pixels) < _FEWEST_BENDS:
        return ""
    planes = np.concatenate([pixels.real, pixels.imag], axis=-1)  # (n, 2 F)
    given = tuple((place, place + count) for place in range(count))
    unlike = {pairs: _unlikeness(planes, pairs) for pairs in _all_pairs(tuple(range(2 * count)))}
    best = min(unlike, key=lambda pairs: unlike[pairs])
    if unlike[given] < _UNLIKE or unlike[best] > _CLEARLY * unlike[given]:
        return ""
    one, other = next(pair for pair in best if pair not in given)
    names = [
        f"the {'real' if place < count else 'imaginary'} part at {megahertz(frequencies_hz[place % count])}"
        for place in (one, other)
    ]
    words = "real and imaginary parts of different frequencies are paired: by their amplitudes, "
    return words + " and ".join(names) + " belong together"


def _all_pairs(places: tuple[int, ...]) -> Iterator[tuple[tuple[int, int], ...]]:
    """All ways to make pairs of an even number of places."""
    if not places:
        yield ()
        return
    first, *rest = places
    for other in rest:
        left = tuple(place for place in rest if place != other)
        for pairs in _all_pairs(left):
            yield ((first, other), *pairs)


def _unlikeness(planes: Floats, pairs: tuple[tuple[int, int], ...]) -> float:
    """Largest weighted spread of the logarithm of an amplitude, over the mean one."""
    amplitude = np.stack([np.hypot(planes[:, one], planes[:, other]) for one, other in pairs], axis=-1)
    logarithm = np.log(np.maximum(amplitude, 1e-12 * amplitude.max()))  # (n, F)
    weight = np.exp(2 * (logarithm.mean(axis=-1) - logarithm.max()))
    apart = logarithm - logarithm.mean(axis=-1, keepdims=True)
    apart -= weight @ apart / weight.sum()
    return float(np.sqrt((weight @ apart**2 / weight.sum()).max()))
