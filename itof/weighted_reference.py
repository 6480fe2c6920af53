"""The direct return of a wall whose brightness varies within a pixel, weighted by what was measured.

Arrays may be of numpy or of any other library that supports the array API standard.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Literal, get_args

from itof.arrays import A, Array, PhasorsOf, PixelsOf
from itof.frequency_images import LARGEST_LOG_STEP, FrequencyImages, Slopes, dot, slopes

SubpixelWeights = Literal["measured", "uniform"]
# Neighbours that differ in brightness by more than this factor belong to different surfaces: the edge of a
# wall, not a gradient on it. The lobe of a rough wall changes by up to 6 % from pixel to pixel at 20 x 15.
_EDGE = 1.25
_ANY_PHASE = 10.0  # radians; phases differ by at most 2π


def weighted_reference(reference: PhasorsOf[A], amplitude: PixelsOf[Array]) -> PhasorsOf[A]:
    """The direct return `reference` of a Lambertian wall, for the wall that a measurement shows.

    The light of a pixel comes over different paths. `reference` weights them as a Lambertian wall does. A
    glossy wall is brighter on one side of the pixel than on the other, which changes the mean phase. The
    brightness b of the wall, relative to `reference`, is known from the measured amplitudes: b = |z_0| /
    |reference_0|. With its relative change per pixel s = ∇ log b, a place x of the pixel (from -1/2 to 1/2 in
    both axes) has the weight 1 + s · x. Over a pixel the reference is proportional to exp(g · x), with
    g = ∇ log reference, and the mean of x x' is 1/12, so that

        weighted = reference (1 + s · g / 12).

    Both gradients are central differences; at the border of the image, and for b beside an edge or a dark
    pixel, they are one-sided. The hidden light takes part in b, with 0.2 % of it, and is smooth.

    *Error.* The neglected terms fall with the fourth power of the pixel size (a test); what is left is in
    notebook/training.md, Rough walls. Noise of relative size σ in the amplitudes turns the phase by σ|g|/17:
    by less than σ / 40 at 40 x 30 pixels and 60 MHz, where |g| is at most 0.42.

    Parameters
    ----------
    reference : ([N,] H, W, F) complex direct return of a Lambertian wall; or a capture of the empty corner,
        which has the brightness of the measurement and therefore stays as it is.
    amplitude : (..., H, W) measured |z_0|, in any unit.

    Returns
    -------
    (..., H, W, F) complex, in the unit of `reference`.
    """
    images = FrequencyImages.of(reference)
    xp = images.xp
    seen = xp.astype(xp.asarray(amplitude), images.real.dtype)[..., None, :, :]  # (..., 1, H, W)
    weights = brightness_slopes(images.first, FrequencyImages(xp, seen, xp.zeros_like(seen)))
    log_amplitude = slopes(xp, images.log_amplitude, LARGEST_LOG_STEP)
    # A pixel without light has no phase: one that is too far from all others to be compared with them.
    phase = xp.where(images.log_amplitude > -LARGEST_LOG_STEP, images.phase, 4 * _ANY_PHASE)
    phase = slopes(xp, phase, _ANY_PHASE, period=2 * math.pi)
    real, imaginary = (dot(weights, each) / 12 for each in (log_amplitude, phase))
    return images.times(1 + real, imaginary)


def brightness_slopes(reference: FrequencyImages[A], seen: FrequencyImages[A]) -> Slopes[A]:
    """s, the gradient of a wall's log brightness, from images (..., 1, H, W) at the first frequency."""
    return slopes(reference.xp, seen.log_amplitude - reference.log_amplitude, math.log(_EDGE))


def quotient(xp: ModuleType, dividend: A, divisor: Array) -> A:
    """`dividend` / `divisor`, 0 where the divisor is 0."""
    defined = divisor != 0
    quotient = dividend / xp.where(defined, divisor, xp.ones_like(divisor))
    return xp.where(defined, quotient, xp.zeros_like(quotient))


def check_weights(weights: str) -> None:
    """Refuse anything but the names of `SubpixelWeights`."""
    if weights not in get_args(SubpixelWeights):
        raise ValueError(f"subpixel weights are {' or '.join(get_args(SubpixelWeights))}, got {weights!r}")
