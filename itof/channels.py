"""Network channels: how a measurement is normalised for the network, and back.

Arrays may be numpy's or any other library's that the array API describes (torch's tensors on a GPU): the
result is of the same library, on the same device.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from array_api_compat import array_namespace, is_array_api_obj, is_numpy_array


def network_channels(phasor: Any, amplitude_scale: float) -> Any:
    """The paper's network input: [A_0 / scale, Re_f / A_0 (F of them), Im_f / A_0 (F of them)].

    A_0 is the amplitude at the first frequency (20 MHz in the paper). Pixels that received no light
    have A_0 = 0 and become 0 in every channel.

    Parameters
    ----------
    phasor : (..., H, W, F) complex.
    amplitude_scale : constant of the dataset that brings A_0 near 1, in the unit of `phasor`, above 0.

    Returns
    -------
    (..., 1 + 2F, H, W) float32; with three frequencies the paper's seven channels.

    Raises
    ------
    ValueError : no image axes, or a scale that is not a positive number.

    Source: Caligiuri et al. 2024, sec. 4.1.
    """
    xp, z = _phasors(phasor)
    _check_scale(amplitude_scale)
    magnitude = xp.abs(z[..., :1])  # (..., H, W, 1)
    ratio = _quotient(xp, z, magnitude)  # (..., H, W, F)
    return _image_axes_last(xp, [magnitude / amplitude_scale, xp.real(ratio), xp.imag(ratio)])


def phasors_of_channels(channels: Any, amplitude_scale: float) -> Any:
    """Inverse of `network_channels`: (..., 1 + 2F, H, W) reals to (..., H, W, F) complex phasors."""
    _, c = _channels(channels)
    count = c.shape[-1] // 2  # components come in twos
    if c.shape[-1] < 3 or c.shape[-1] % 2 == 0:
        raise ValueError(f"expected 1 + 2F channels for F frequencies, got {c.shape[-1]}")
    _check_scale(amplitude_scale)
    return (c[..., 1 : 1 + count] + 1j * c[..., 1 + count :]) * (c[..., :1] * amplitude_scale)


def residual_channels(phasor: Any, reference: Any) -> Any:
    """Channels that hold hidden light alone: [Im r_f (F of them), Re r_f - Re r_0 (F - 1 of them)].

    r_f = (z_f / reference_f) |reference_0| / |z_0|: every phasor is divided by the relay wall's known direct
    return, which turns it back by its phase and undoes what the spread of paths within a pixel takes from
    the amplitude at higher frequencies. The direct part becomes 1 at every frequency, so it drops out of
    these differences, and the hidden 0.2 % is no longer buried under it. Pixels without light become 0.

    *Error.* A wall that stands δ metres from where the reference puts it, along the ray, adds an optical
    path of 2 δ, and so a phase ε_f = 4π f δ / c: 1 mm makes 0.8, 2.1 and 2.5 mrad at 20, 50 and 60 MHz. To
    first order Im r_f gains ε_f, as much as the hidden light itself (1-3 mrad), and Re r_f - Re r_0 gains
    nothing: there ε enters squared, (ε_0² - ε_f²) / 2, 3e-6 for a millimetre, and as hidden light times
    ε. A wrong gain of the sensor drops out of all of them.

    Parameters
    ----------
    phasor : (..., H, W, F) complex.
    reference : (H, W, F) complex, the direct return up to a real factor per pixel (`itof.direct_phasors`,
        or one capture of the empty corner).

    Returns
    -------
    (..., 2F - 1, H, W) float32.

    Raises
    ------
    ValueError : a reference of another image size or frequency count.
    """
    xp, z = _phasors(phasor)
    known = reference if is_array_api_obj(reference) else np.asarray(reference)
    _check_reference(known.shape, z.shape)
    turned = _quotient(xp, z, known) * _quotient(xp, xp.abs(known[..., :1]), xp.abs(z[..., :1]))
    real = xp.real(turned)
    return _image_axes_last(xp, [xp.imag(turned), real[..., 1:] - real[..., :1]])


def phasors_of_residual(channels: Any, reference: Any, amplitude: Any) -> Any:
    """Inverse of `residual_channels`, where hidden light is less than the direct return.

    The channels know every r_f but for the common Re r_0, and |r_0| = 1, so Re r_0 = √(1 - Im² r_0); the
    sign is that of the direct return. How bright a pixel was must be given.

    Parameters
    ----------
    channels : (..., 2F - 1, H, W).
    reference : (H, W, F) complex, as given to `residual_channels`.
    amplitude : (..., H, W) |z_0|, the amplitude at the first frequency.

    Returns
    -------
    (..., H, W, F) complex.

    Raises
    ------
    ValueError : a number of channels that does not fit the reference.
    """
    xp, c = _channels(channels)
    known = reference if is_array_api_obj(reference) else np.asarray(reference)
    count = known.shape[-1]
    if c.shape[-1] != 2 * count - 1:  # two components a frequency, less Re r_0
        raise ValueError(
            f"{c.shape[-1]} residual channels do not fit a reference at {count} frequencies: "
            f"there are {2 * count - 1} of them"  # two components a frequency, less one
        )
    imaginary = c[..., :count]  # (..., H, W, F)
    first = xp.sqrt(1 - imaginary[..., :1] ** 2)  # Re r_0, (..., H, W, 1)
    real = xp.concat([first, first + c[..., count:]], axis=-1)
    brightness = xp.asarray(amplitude)[..., None] / xp.abs(known[..., :1])
    return (real + 1j * imaginary) * known * brightness


def _phasors(phasor: Any) -> tuple[ModuleType, Any]:
    """Namespace and array of phasors; lists become numpy arrays."""
    z = phasor if is_array_api_obj(phasor) else np.asarray(phasor)
    if z.ndim < 3:
        raise ValueError(f"expected phasors of shape (..., H, W, F), got {tuple(z.shape)}")
    return array_namespace(z), z


def _channels(channels: Any) -> tuple[ModuleType, Any]:
    """Namespace and channels with the channel axis last; numpy's as float64."""
    c = channels if is_array_api_obj(channels) else np.asarray(channels)
    xp = array_namespace(c)
    return xp, xp.moveaxis(c.astype(np.float64) if is_numpy_array(c) else c, -3, -1)


def _quotient(xp: ModuleType, dividend: Any, divisor: Any) -> Any:
    """`dividend` / `divisor`, 0 where the divisor is 0."""
    defined = divisor != 0
    quotient = dividend / xp.where(defined, divisor, xp.ones_like(divisor))
    return xp.where(defined, quotient, xp.zeros_like(quotient))


def _image_axes_last(xp: ModuleType, parts: list[Any]) -> Any:
    """(..., C, H, W) float32 of parts (..., H, W, c); numpy's in C order."""
    joined = xp.moveaxis(xp.astype(xp.concat(parts, axis=-1), xp.float32), -1, -3)
    return np.ascontiguousarray(joined) if is_numpy_array(joined) else joined


def _check_reference(reference: tuple[int, ...], phasor: tuple[int, ...]) -> None:
    if tuple(reference) != tuple(phasor[-3:]):
        raise ValueError(
            f"reference of shape {tuple(reference)} does not fit phasors of shape {tuple(phasor)}"
        )


def _check_scale(amplitude_scale: float) -> None:
    if not (np.isfinite(amplitude_scale) and amplitude_scale > 0):
        raise ValueError(f"the amplitude scale must be a positive number, got {amplitude_scale}")
