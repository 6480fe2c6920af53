"""The direct return of a wall that is a little elsewhere, from that of the expected wall."""

from __future__ import annotations

from types import ModuleType
from typing import Final

from array_api_compat import array_namespace

from itof.arrays import A, Array, PhasorsOf
from itof.weighted_reference import log_slope

_STEEPEST: Final = 0.5  # radians per pixel; a larger step of the phase is the edge of the wall


def turned_reference(reference: PhasorsOf[A], turn_rad: PhasorsOf[Array]) -> PhasorsOf[A]:
    """The direct return `reference` ([N,] H, W, F), with phases that grow by `turn_rad` (..., H, W, F).

    The light of a pixel comes over different paths, which cancel in part. With the gradient g of log
    reference within the pixel and its second derivatives h, the mean is 1 + (g · g + sum h) / 24 of the value
    in the middle. The turn changes both, by j times its own derivatives.

    Returns
    -------
    (..., H, W, F) complex, of the type of `reference`.
    """
    xp = array_namespace(reference)
    change = xp.zeros_like(turn_rad)
    for axis in (-2, -3):
        along, bend = _derivatives(xp, turn_rad, axis)
        change = change + (along * (2j * log_slope(xp, reference, axis) - along) + 1j * bend) / 24
    turned = reference * (xp.cos(turn_rad) + 1j * xp.sin(turn_rad)) * (1 + change)
    return xp.astype(turned, reference.dtype)


def _derivatives(xp: ModuleType, values: A, axis: int) -> tuple[A, A]:
    """First and second derivative per pixel along an axis; 0 in images too small for them, and at edges."""
    v = xp.moveaxis(values, axis, -1)
    if v.shape[-1] < 3:
        return xp.zeros_like(values), xp.zeros_like(values)
    inner = (v[..., 2:] - v[..., :-2]) / 2
    first = (4 * v[..., 1:2] - 3 * v[..., :1] - v[..., 2:3]) / 2
    last = (3 * v[..., -1:] - 4 * v[..., -2:-1] + v[..., -3:-2]) / 2
    slope = xp.concat([first, inner, last], axis=-1)
    bend = v[..., 2:] - 2 * v[..., 1:-1] + v[..., :-2]
    bend = xp.concat([bend[..., :1], bend, bend[..., -1:]], axis=-1)
    smooth = (xp.abs(slope) < _STEEPEST) & (xp.abs(bend) < _STEEPEST)
    return tuple(xp.moveaxis(xp.where(smooth, each, xp.zeros_like(each)), -1, axis) for each in (slope, bend))
