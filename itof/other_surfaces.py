"""Pixels that show something else than the relay wall, or its edge.

Such a pixel's light is not that of the wall, so the phase over the wall's direct return is not that of the
hidden light: where the edge of the middle wall cuts a pixel, it is up to a hundred times as large.

Arrays may be of numpy or of any other library that supports the array API standard.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, Final

from array_api_compat import array_namespace

from itof.arrays import A, Array, PhasorsOf, PixelsOf

# Phases over the wall's direct return, radians. A pixel with the first shows another surface, and the fit of
# the wall gives it no weight (`itof.wall.self_calibration`); its neighbours may be at the edge. The second is
# above the hidden light of the preset `any-corner` (notebook/experiments.md, Many corners).
ELSEWHERE_RAD: Final = 0.25
_EDGE_RAD: Final = 0.05
# Of the mean light over that of a diffuse wall: darker pixels see no wall, and would be noise over noise. Of
# the pixels of a scene of the presets, with glossy and dark walls, fewer than one in a thousand are darker.
_DARK: Final = 0.02


def only_wall(turned: PhasorsOf[A]) -> PhasorsOf[A]:
    """The phasors of pixels that show the wall alone, and 0 in the others.

    The others are pixels without light at some frequency, or with a phase of more than 0.25 rad, and the
    eight neighbours of both; and pixels with a phase of more than 0.05 rad.

    Parameters
    ----------
    turned : (..., H, W, F) complex, phasors over the direct return of the wall.

    Returns
    -------
    (..., H, W, F) complex.

    Source: ours.
    """
    xp = array_namespace(turned)
    real, imaginary = xp.real(turned), xp.abs(xp.imag(turned))
    elsewhere = xp.any((turned == 0) | (imaginary > ELSEWHERE_RAD * real), axis=-1)  # (..., H, W)
    edge = xp.any(imaginary > _EDGE_RAD * real, axis=-1)
    left_out = _with_neighbours(xp, _with_neighbours(xp, elsewhere, -1), -2) | edge
    return xp.where(left_out[..., None], xp.zeros_like(turned), turned)


def is_dark(light: PixelsOf[Array]) -> PixelsOf[Any]:
    """(..., H, W) bool: whether pixels show no wall, such as those of a black middle wall.

    `light` (..., H, W) is measured, relative to the return of a diffuse wall, in any unit.
    """
    xp = array_namespace(light)
    return light < _DARK * xp.mean(light, axis=(-2, -1), keepdims=True)


def _with_neighbours(xp: ModuleType, chosen: A, axis: int) -> A:
    """(..., n) bool: whether a pixel or one of the two beside it, along `axis`, is chosen."""
    c = xp.moveaxis(chosen, axis, -1)
    none = xp.zeros_like(c[..., :1])
    beside = xp.concat([c[..., 1:], none], axis=-1) | xp.concat([none, c[..., :-1]], axis=-1)
    return xp.moveaxis(c | beside, -1, axis)
