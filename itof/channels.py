"""Network channels: normalised measurements as network input, and the way back.

Arrays may be of numpy or of any other library that supports the array API standard, such as torch on a GPU.
The result is an array of the same library on the same device.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np
from array_api_compat import array_namespace, is_numpy_array

from itof.arrays import A, Array, ChannelsOf, PhasorsOf, PixelsOf
from itof.other_surfaces import is_dark, only_wall
from itof.weighted_reference import SubpixelWeights, check_weights, quotient, weighted_reference


def network_channels(phasor: PhasorsOf[Array], amplitude_scale: float) -> ChannelsOf[Array]:
    """The paper's network input: [A_0 / scale, Re_f / A_0 (F of them), Im_f / A_0 (F of them)].

    A_0 is the amplitude at the first frequency (20 MHz in the paper). Pixels without light (A_0 = 0) are 0 in
    every channel.

    Parameters
    ----------
    phasor : (..., H, W, F) complex.
    amplitude_scale : positive constant of the dataset, in the unit of `phasor`, for example its mean or
        largest A_0.

    Returns
    -------
    (..., 1 + 2F, H, W) float32; with three frequencies the paper's seven channels.

    Raises
    ------
    ValueError : an array without image axes, or a scale that is not a positive number.

    Source: Caligiuri et al. 2024, sec. 4.2.
    """
    xp, z = _phasors(phasor)
    _check_scale(amplitude_scale)
    magnitude = xp.abs(z[..., :1])  # (..., H, W, 1)
    direction = quotient(xp, z, magnitude)  # (..., H, W, F)
    return _image_axes_last(xp, [magnitude / amplitude_scale, xp.real(direction), xp.imag(direction)])


def residual_channels(
    phasor: PhasorsOf[Array],
    reference: PhasorsOf[Array],
    weights: SubpixelWeights = "measured",
    *,
    wall_alone: bool = False,
) -> ChannelsOf[Array]:
    """Channels without the direct return: [Im r_f (F of them), Re r_f - Re r_0 (F - 1 of them)].

    r_f = (z_f / reference_f) |reference_0| / |z_0|. The division by the relay wall's known direct return
    removes its phase, and the loss of amplitude at higher frequencies that the different paths within a pixel
    cause. The direct part of r_f is 1 at every frequency and cancels in the channels; the hidden part, about
    0.2 % of the signal, remains (docs/science/design.md, Input channels). Pixels that show no wall are 0
    (`itof.other_surfaces.is_dark`).

    *Weights.* The reference is that of a Lambertian wall. For a wall with another lobe, the different paths
    within a pixel have other weights. They are taken from the measured amplitudes
    (`itof.weighted_reference`). With ``uniform`` weights, direct light is left, 2 to 5 % of the hidden part
    at 40 x 30 pixels; runs that were trained in this way are used in this way.

    *Error.* If the wall is δ metres farther along the ray than in the reference, the optical path is longer
    by 2 δ, and the phase by ε_f = 4π f δ / c: for 1 mm 0.8, 2.1 and 2.5 mrad at 20, 50 and 60 MHz. To first
    order, Im r_f changes by ε_f, which is as much as the hidden part itself (1-3 mrad), and Re r_f - Re r_0
    does not change. Its error is of second order: (ε_0² - ε_f²) / 2, 3e-6 for a millimetre, and the hidden
    part times ε. A wrong gain of the sensor has no effect on any channel.

    Parameters
    ----------
    phasor : (..., H, W, F) complex.
    reference : (H, W, F) complex, the direct return up to a positive factor: from
        `itof.direct_phasors`, or a capture without a hidden object. Or (..., H, W, F), one for each image:
        see `itof.wall.self_calibration`.
    weights : ``measured``: the reference is weighted by the amplitudes of `phasor`; ``uniform``: it is used
        as it is.
    wall_alone : pixels that show something else than the relay wall, and those at its edge, are 0
        (`itof.other_surfaces`).

    Returns
    -------
    (..., 2F - 1, H, W) float32.

    Raises
    ------
    ValueError : a reference with another image size or another number of frequencies, or unknown weights.
    """
    xp, z = _phasors(phasor)
    known = _array(reference)
    _check_reference(known.shape, z.shape)
    known = _weighted(known, xp.abs(z[..., 0]), weights)
    light = xp.abs(z[..., :1])  # (..., H, W, 1)
    strength = xp.abs(known[..., :1])
    turned = quotient(xp, z, known) * quotient(xp, strength, light)
    dark = is_dark(quotient(xp, light, strength)[..., 0])
    turned = only_wall(turned) if wall_alone else turned
    turned = xp.where(dark[..., None], xp.zeros_like(turned), turned)
    real = xp.real(turned)
    return _image_axes_last(xp, [xp.imag(turned), real[..., 1:] - real[..., :1]])


def _array(values: Array) -> Array:
    """Lists become numpy arrays."""
    found: Array = np.asarray(values) if isinstance(values, Sequence) else values
    return found


def _phasors(phasor: PhasorsOf[Array]) -> tuple[ModuleType, PhasorsOf[Array]]:
    """Array namespace, and the phasors as an array of it."""
    z = _array(phasor)
    if z.ndim < 3:
        raise ValueError(f"expected phasors of shape (..., H, W, F), got {tuple(z.shape)}")
    return array_namespace(z), z


def _weighted(reference: PhasorsOf[A], amplitude: PixelsOf[Array], weights: SubpixelWeights) -> PhasorsOf[A]:
    check_weights(weights)
    return weighted_reference(reference, amplitude) if weights == "measured" else reference


def _image_axes_last(xp: ModuleType, parts: list[Array]) -> ChannelsOf[Array]:
    """(..., C, H, W) float32 of parts (..., H, W, c); numpy arrays in C order."""
    joined = xp.moveaxis(xp.astype(xp.concat(parts, axis=-1), xp.float32), -1, -3)
    return np.ascontiguousarray(joined) if is_numpy_array(joined) else joined


def _check_reference(reference: tuple[int, ...], phasor: tuple[int, ...]) -> None:
    if tuple(reference) not in (tuple(phasor[-3:]), tuple(phasor)):
        raise ValueError(
            f"reference of shape {tuple(reference)} does not fit phasors of shape {tuple(phasor)}"
        )


def _check_scale(amplitude_scale: float) -> None:
    if not (np.isfinite(amplitude_scale) and amplitude_scale > 0):
        raise ValueError(f"the amplitude scale must be a positive number, got {amplitude_scale}")
