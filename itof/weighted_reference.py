"""The direct return of a wall whose brightness varies within a pixel, weighted by what was measured.

Arrays may be of numpy or of any other library that supports the array API standard.
"""

from __future__ import annotations

from types import ModuleType
from typing import Literal, get_args

from array_api_compat import array_namespace

from itof.arrays import A, Array, PhasorsOf, PixelsOf

SubpixelWeights = Literal["measured", "uniform"]
# Neighbours that differ in brightness by more than this factor belong to different surfaces: the edge of a
# wall, not a gradient on it. The lobe of a rough wall changes by up to 6 % from pixel to pixel at 20 x 15.
_EDGE = 1.25


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
    xp = array_namespace(reference)
    brightness = quotient(xp, xp.asarray(amplitude), xp.abs(reference[..., 0]))  # (..., H, W)
    change = xp.zeros_like(reference)
    for axis in (-1, -2):
        along = log_slope(xp, brightness, axis, _EDGE)[..., None]  # (..., H, W, 1)
        change = change + along * log_slope(xp, reference, axis - 1)  # (..., H, W, F)
    return reference * (1 + change / 12)


def quotient(xp: ModuleType, dividend: A, divisor: Array) -> A:
    """`dividend` / `divisor`, 0 where the divisor is 0."""
    defined = divisor != 0
    quotient = dividend / xp.where(defined, divisor, xp.ones_like(divisor))
    return xp.where(defined, quotient, xp.zeros_like(quotient))


def check_weights(weights: str) -> None:
    """Refuse anything but the names of `SubpixelWeights`."""
    if weights not in get_args(SubpixelWeights):
        raise ValueError(f"subpixel weights are {' or '.join(get_args(SubpixelWeights))}, got {weights!r}")


def log_slope(xp: ModuleType, values: A, axis: int, largest_ratio: float | None = None) -> A:
    """Gradient of log(values) along an axis, per pixel; 0 where no neighbour can be compared.

    Neighbours are compared if both are not 0 and their ratio is at most `largest_ratio`. All differences are
    of second order where there are enough neighbours.
    """
    v = xp.moveaxis(values, axis, -1)
    ratio = quotient(xp, v[..., 1:], v[..., :-1])  # (..., n - 1)
    known = ratio != 0
    step = _log(xp, xp.where(known, ratio, xp.ones_like(ratio)))
    if largest_ratio is not None:
        known = known & (xp.exp(xp.abs(step)) <= largest_ratio)
    of_all = v.shape[-1] > 2 and bool(xp.all(known))
    slope = _slope_of_all(xp, step) if of_all else _slope_of_some(xp, step, known, xp.zeros_like(v[..., :1]))
    return xp.moveaxis(slope, -1, axis)


def _log(xp: ModuleType, values: A) -> A:
    """Logarithm of real or complex numbers; PyTorch's complex one takes twice the time of its two parts."""
    if not xp.isdtype(values.dtype, "complex floating"):
        return xp.log(values)
    return xp.log(xp.abs(values)) + 1j * xp.atan2(xp.imag(values), xp.real(values))


def _slope_of_all(xp: ModuleType, step: A) -> A:
    """As `_slope_of_some`, and faster, where all of at least two steps are known."""
    first = step[..., :1] - (step[..., 1:2] - step[..., :1]) / 2
    last = step[..., -1:] + (step[..., -1:] - step[..., -2:-1]) / 2
    return xp.concat([first, (step[..., :-1] + step[..., 1:]) / 2, last], axis=-1)


def _slope_of_some(xp: ModuleType, step: A, known: Array, none: A) -> A:
    """(..., n) slopes of (..., n - 1) steps between neighbours, of which only some are known.

    `none` is (..., 1) zeros.
    """
    unknown = xp.zeros_like(none, dtype=xp.bool)
    before, after = (xp.concat(pair, axis=-1) for pair in ([none, step], [step, none]))  # (..., n)
    has_before, has_after = (xp.concat(pair, axis=-1) for pair in ([unknown, known], [known, unknown]))
    bend = xp.where(has_before & has_after, after - before, xp.zeros_like(before))
    bend_before, bend_after = (
        xp.concat(pair, axis=-1) for pair in ([none, bend[..., :-1]], [bend[..., 1:], none])
    )
    one_sided = xp.where(has_after, after - bend_after / 2, before + bend_before / 2)
    slope = xp.where(has_before & has_after, (before + after) / 2, one_sided)
    return xp.where(has_before | has_after, slope, xp.zeros_like(before))
