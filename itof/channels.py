"""Network channels: how a measurement is normalised for the network, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof.measurement import join_components, split_components


def network_channels(phasor: ArrayLike, amplitude_scale: float) -> NDArray[np.float32]:
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
    z = np.asarray(phasor)
    if z.ndim < 3:
        raise ValueError(f"expected phasors of shape (..., H, W, F), got {z.shape}")
    _check_scale(amplitude_scale)
    reference = np.abs(z[..., :1])  # (..., H, W, 1)
    lit = reference > 0
    ratio = np.where(lit, split_components(z) / np.where(lit, reference, 1.0), 0.0)  # (..., H, W, 2F)
    channels = np.concatenate([reference / amplitude_scale, ratio], axis=-1)  # (..., H, W, 1 + 2F)
    return np.ascontiguousarray(np.moveaxis(channels, -1, -3), dtype=np.float32)


def phasors_of_channels(channels: ArrayLike, amplitude_scale: float) -> NDArray[np.complex128]:
    """Inverse of `network_channels`: (..., 1 + 2F, H, W) reals to (..., H, W, F) complex phasors."""
    c = np.moveaxis(np.asarray(channels, dtype=np.float64), -3, -1)  # (..., H, W, 1 + 2F)
    if c.shape[-1] < 3 or c.shape[-1] % 2 == 0:
        raise ValueError(f"expected 1 + 2F channels for F frequencies, got {c.shape[-1]}")
    _check_scale(amplitude_scale)
    return join_components(c[..., 1:]) * (c[..., :1] * amplitude_scale)


def residual_channels(phasor: ArrayLike, reference: ArrayLike) -> NDArray[np.float32]:
    """Channels that hold hidden light alone: [Im r_f (F of them), Re r_f - Re r_0 (F - 1 of them)].

    r_f = (z_f / reference_f) |reference_0| / |z_0|: every phasor is divided by the relay wall's known direct
    return, which turns it back by its phase and undoes what the spread of paths within a pixel takes from
    the amplitude at higher frequencies. The direct part becomes 1 at every frequency, so it drops out of
    these differences, and the hidden 0.2 % is no longer buried under it. Pixels without light become 0.

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
    z, known = np.asarray(phasor), np.asarray(reference)
    if z.ndim < 3 or known.shape != z.shape[-3:]:
        raise ValueError(f"reference of shape {known.shape} does not fit phasors of shape {z.shape}")
    magnitude = np.abs(z[..., :1])  # (..., H, W, 1)
    lit = magnitude > 0
    lit = lit & (known != 0)
    ratio = z / np.where(lit, known, 1.0) * np.abs(known[..., :1]) / np.where(lit, magnitude, 1.0)
    turned = np.where(lit, ratio, 0.0)  # (..., H, W, F)
    channels = np.concatenate([turned.imag, turned.real[..., 1:] - turned.real[..., :1]], axis=-1)
    return np.ascontiguousarray(np.moveaxis(channels, -1, -3), dtype=np.float32)


def _check_scale(amplitude_scale: float) -> None:
    if not (np.isfinite(amplitude_scale) and amplitude_scale > 0):
        raise ValueError(f"the amplitude scale must be a positive number, got {amplitude_scale}")
