"""Self-calibration: the direct return of the relay wall as the measurement itself shows it.

All but 0.2 % of a phasor z_f is the direct return of the relay wall, so its phase over the expected direct
return d_f says by how much the wall is elsewhere and by how much the camera's phases are off:

    arg(z_f conj d_f) = k_f (L - L_0) + o_f + a_f cos 4 φ_f + b_f sin 4 φ_f + hidden,   k_f = 4π f / c

L is the wall's distance along the ray r of a pixel and L_0 the expected one. For a plane, 1 / L = m · r is
linear in m, so dL = -L² r · dm. The unknowns are the plane (3), a phase offset per frequency (F) and, as an
option, the four-cycle error of a square-wave camera (2F). They follow by least squares over all pixels and
frequencies; the step is repeated because L depends on the plane (Gauss-Newton). φ_f = arg z_f is the measured
phase, of which the four-cycle error is a function.

The fit takes as many dimensions of the hidden light with it as it has unknowns. A pixel has the weight |d|²
of a diffuse wall in the fitted plane, the inverse of its phase variance under noise: |d_0|² of the expected
wall, even where a capture of the empty corner gives the direct return, times (L_0 / L)^6
(`itof.wall.expected_wall.strength_elsewhere`). It does not depend on the brightness of the measurement, so
the lost dimensions are the same in every scene, and they are those of the wall where it is, not where it was
expected. Only pixels that are off by more than about 0.1 rad, because they do not see the wall, lose their
weight step by step (Tukey's biweight with a falling width, of the frequency that fits worst).

`itof.wall.wall_fit` serves the diagnosis of one image: it adapts to the noise and estimates the errors.
Arrays may be of numpy or of any other library that supports the array API standard with linear algebra.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final

from array_api_compat import array_namespace, device

from itof.other_surfaces import ELSEWHERE_RAD
from itof.wall.expected_wall import ExpectedWall, radial_depth_of_plane, strength_elsewhere
from itof.weighted_reference import log_slope, quotient, weighted_reference

# Widths of the biweight in radians, one per step. With the first, a wall 0.4 m off at 60 MHz counts. With the
# last, a pixel with 45 mrad of hidden light has the weight 0.94; 99.9 % of those in the paper's have less.
_WIDTHS_RAD: Final = (2.0, 0.7, *(ELSEWHERE_RAD,) * 3)
_RIDGE: Final = 1e-12  # of the normal matrix with a unit diagonal: an unknown that no pixel shows stays 0
_DARKEST: Final = 1e-300  # of a wall without any return, which then has no weight
_STEEPEST: Final = 0.5  # radians per pixel; a larger step of the phase is the edge of the wall


@dataclass(frozen=True)
class FittedWall:
    """Wall and phases that images show; arrays of the library of the measurement.

    Attributes
    ----------
    plane_per_m : (..., 3) fitted plane m in camera axes, 1/m.
    offsets_rad : (..., F) fitted phase offsets, modulo 2π.
    wiggling_rad : (..., F, 2) fitted a_f and b_f; None if they were not fitted.
    """

    plane_per_m: Any
    offsets_rad: Any
    wiggling_rad: Any = None

    def moved(self, phasor: Any, wall: ExpectedWall) -> Any:
        """(..., H, W, F) complex, the direct return of the expected `wall`, moved to this wall and phases.

        It has the brightness of the expected wall. `phasor` (..., H, W, F) are the images that were fitted.
        """
        xp = array_namespace(phasor)
        shape = tuple(phasor.shape)
        turn, _ = _Rays.of(xp, phasor, wall).turn(self.plane_per_m, self.offsets_rad)
        direct = turned_reference(wall.direct, xp.reshape(xp.matrix_transpose(turn), shape))
        if self.wiggling_rad is not None:  # the camera's error is that of the phase of a whole pixel
            waves = xp.stack(_waves(xp, _by_frequency(xp, phasor)), axis=-2)  # (..., F, 2, n)
            wiggle = xp.sum(waves * self.wiggling_rad[..., None], axis=-2)
            wiggle = xp.reshape(xp.matrix_transpose(wiggle), shape)
            direct = xp.astype(direct * (xp.cos(wiggle) + 1j * xp.sin(wiggle)), direct.dtype)
        return direct


@dataclass(frozen=True)
class Calibration(FittedWall):
    """Outcome of `calibrate`: a fitted wall, with `wiggling_rad` 0 if it was not fitted.

    Attributes
    ----------
    direct : (..., H, W, F) complex, the expected direct return, `moved` to the fitted wall and phases.
    """

    direct: Any = None


def calibrate(
    phasor: Any, wall: ExpectedWall, *, wiggling: bool = False, start_per_m: Any = None
) -> Calibration:
    """Fit the wall to each image (`fitted_wall`, with its parameters), and move the expected wall there."""
    fit = fitted_wall(phasor, wall, wiggling=wiggling, start_per_m=start_per_m)
    waves = fit.wiggling_rad
    if waves is None:
        xp, shape = array_namespace(phasor), (*fit.offsets_rad.shape, 2)
        waves = xp.zeros(shape, dtype=fit.offsets_rad.dtype, device=device(phasor))
    return Calibration(fit.plane_per_m, fit.offsets_rad, waves, fit.moved(phasor, wall))


def fitted_wall(
    phasor: Any, wall: ExpectedWall, *, wiggling: bool = False, start_per_m: Any = None
) -> FittedWall:
    """Fit plane, phase offsets and, with `wiggling`, the four-cycle error to each image.

    Parameters
    ----------
    phasor : (..., H, W, F) complex. Pixels that are 0 at some frequency are not used.
    wall : the expected wall, with arrays of the library and on the device of `phasor`. Its `direct` may be a
        capture of the empty corner (`ExpectedWall.captured`).
    start_per_m : (..., 3) plane to start from; by default the expected one, which must be right to about
        c / 8f. `itof.wall.wall_search.plane_from_nothing` finds another one.

    A wall of N cameras (`ExpectedWall.stacked`) is for N images (N, H, W, F), one each.

    An image that shows no wall keeps the plane and the offsets that it started with, or nearly so.
    """
    xp = array_namespace(phasor)
    problem = _Problem.of(xp, phasor, wall, wiggling)
    batch = tuple(phasor.shape[:-3])
    start = wall.plane_per_m if start_per_m is None else start_per_m
    plane = xp.broadcast_to(xp.astype(start, xp.float64), (*batch, 3))
    local = problem.first_guess(plane)
    for width in _WIDTHS_RAD:
        plane, local = problem.step(plane, local, width)
    plane, local = _kept(xp, plane), _kept(xp, local)
    return FittedWall(plane, local[..., 0], local[..., 1:] if wiggling else None)


def turned_reference(reference: Any, turn_rad: Any) -> Any:
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


@dataclass(frozen=True)
class _Rays:
    """The n pixels' rays to the expected wall, float64.

    Attributes
    ----------
    rays : ([N,] n, 3).
    meets : ([N,] n) whether a ray meets the wall.
    expected_depth_m : ([N,] n) with 0 where the ray misses the wall.
    slope : (F, 1) rad/m.
    """

    xp: ModuleType
    rays: Any
    meets: Any
    expected_depth_m: Any
    slope: Any

    @classmethod
    def of(cls, xp: ModuleType, phasor: Any, wall: ExpectedWall) -> _Rays:
        pixels = (*wall.rays.shape[:-3], -1)  # ([N,] n)
        meets = xp.reshape(xp.isfinite(wall.radial_depth_m), pixels)
        depth_m = xp.reshape(wall.radial_depth_m, pixels)
        return cls(
            xp,
            xp.reshape(wall.rays, (*pixels, 3)),
            meets,
            xp.where(meets, depth_m, xp.zeros_like(depth_m)),
            xp.asarray(wall.slope, dtype=xp.float64, device=device(phasor))[:, None],
        )

    def turn(self, plane: Any, offset: Any) -> tuple[Any, Any]:
        """Phases (..., F, n) of the plane and the offsets (..., F); the depth (..., n)."""
        xp = self.xp
        depth_m = radial_depth_of_plane(self.rays, plane)  # (..., n)
        depth_m = xp.where(xp.isfinite(depth_m), depth_m, self.expected_depth_m)
        return (depth_m - self.expected_depth_m)[..., None, :] * self.slope + offset[..., None], depth_m


@dataclass(frozen=True)
class _Problem:
    """Phases of n pixels over those of the expected wall, float64; leading axes are those of the images.

    Attributes
    ----------
    pixels : rays of the pixels.
    phases : (..., F, n) measured over expected, radians, modulo 2π.
    basis : (..., F, Q, n) what the Q unknowns of each frequency multiply: 1, and the four cycles.
    weight : (..., 1, n) weights of the pixels; 0 where a pixel holds no light.
    """

    xp: ModuleType
    pixels: _Rays
    phases: Any
    basis: Any
    weight: Any

    @classmethod
    def of(cls, xp: ModuleType, phasor: Any, wall: ExpectedWall, wiggling: bool) -> _Problem:
        known = weighted_reference(wall.direct, xp.abs(phasor[..., 0]))
        ratio = phasor * xp.conj(quotient(xp, known, xp.abs(known)))  # (..., H, W, F)
        ratio, measured = (_by_frequency(xp, each) for each in (ratio, phasor))
        phases = _phases(xp, ratio)
        waves = _waves(xp, measured) if wiggling else []
        pixels = _Rays.of(xp, phasor, wall)
        lit = xp.all(ratio != 0, axis=-2, keepdims=True) & pixels.meets[..., None, :]  # (..., 1, n)
        strength = xp.reshape(xp.astype(wall.fit_strength, xp.float64), pixels.meets.shape)[..., None, :]
        strongest = xp.max(strength, axis=-1, keepdims=True)
        return cls(
            xp,
            pixels,
            phases,
            xp.stack([xp.ones_like(phases), *waves], axis=-2),
            (strength / xp.clip(strongest, min=_DARKEST)) ** 2 * xp.astype(lit, xp.float64),
        )

    def first_guess(self, plane: Any) -> Any:
        """(..., F, Q) offsets that turn the mean phasor to 0; the other unknowns are 0."""
        xp = self.xp
        none = xp.zeros_like(self.basis[..., 0])  # (..., F, Q)
        left = self.phases - self.pixels.turn(plane, none[..., 0])[0]
        along, across = (xp.sum(self.weight * part(left), axis=-1) for part in (xp.cos, xp.sin))
        return xp.concat([xp.atan2(across, along)[..., None], none[..., 1:]], axis=-1)

    def step(self, plane: Any, local: Any, width_rad: float) -> tuple[Any, Any]:
        """Plane and local unknowns after one step of least squares."""
        xp, k = self.xp, self.pixels.slope
        basis = self.basis
        turn, depth_m = self.pixels.turn(plane, local[..., 0])
        left = self.phases - turn - xp.sum(basis[..., 1:, :] * local[..., 1:, None], axis=-2)
        left = left - 2 * math.pi * xp.round(left / (2 * math.pi))
        farthest = xp.max(xp.abs(left), axis=-2, keepdims=True)  # (..., 1, n)
        weight = self.weight * strength_elsewhere(self.pixels.expected_depth_m, depth_m)[..., None, :] ** 2
        weight = weight * (1 - xp.clip((farthest / width_rad) ** 2, max=1.0)) ** 2
        weight = xp.broadcast_to(weight, left.shape)  # (..., F, n)
        tangent = -(depth_m**2)[..., None, :] * xp.matrix_transpose(self.pixels.rays)  # (..., 3, n) dL / dm
        seen = basis * weight[..., None, :]  # (..., F, Q, n)
        rows = (*local.shape[:-2], local.shape[-2] * local.shape[-1], left.shape[-1])
        seen_rows, columns = xp.reshape(seen, rows), xp.matrix_transpose(xp.reshape(basis, rows))
        top = (tangent * xp.sum(weight * k**2, axis=-2, keepdims=True)) @ xp.matrix_transpose(tangent)
        side = tangent @ xp.matrix_transpose(xp.reshape(seen * k[..., None], rows))  # (..., 3, F Q)
        own = (seen_rows @ columns) * self._blocks(*local.shape[-2:])  # frequencies share the plane alone
        upper = xp.concat([top, side], axis=-1)
        lower = xp.concat([xp.matrix_transpose(side), own], axis=-1)
        along = xp.sum(tangent * xp.sum(weight * left * k, axis=-2, keepdims=True), axis=-1)  # (..., 3)
        each = xp.reshape(xp.sum(seen * left[..., None, :], axis=-1), rows[:-1])  # (..., F Q)
        right = xp.concat([along, each], axis=-1)
        change = _solved(xp, xp.concat([upper, lower], axis=-2), right)
        return plane + change[..., :3], local + xp.reshape(change[..., 3:], tuple(local.shape))

    def _blocks(self, frequencies: int, count: int) -> Any:
        """(F Q, F Q): 1 where both unknowns are of the same frequency."""
        xp = self.xp
        place = xp.arange(frequencies * count, device=device(self.phases)) // count
        return xp.astype(place[:, None] == place, xp.float64)


def _by_frequency(xp: ModuleType, values: Any) -> Any:
    """(..., F, n) of (..., H, W, F)."""
    return xp.moveaxis(xp.reshape(values, (*values.shape[:-3], -1, values.shape[-1])), -1, -2)


def _phases(xp: ModuleType, z: Any) -> Any:
    """Phases of complex numbers, radians, float64."""
    return xp.astype(xp.atan2(xp.imag(z), xp.real(z)), xp.float64)


def _waves(xp: ModuleType, measured: Any) -> list[Any]:
    """Four cycles of the phases of measured phasors (..., F, n), their cosine and sine."""
    cycles = _phases(xp, measured)
    return [xp.cos(4 * cycles), xp.sin(4 * cycles)]


def _solved(xp: ModuleType, normal: Any, right: Any) -> Any:
    """Solutions (..., P) of normal equations (..., P, P), scaled to a unit diagonal."""
    diagonal = xp.linalg.diagonal(normal)
    size = xp.where(diagonal > 0, xp.sqrt(xp.where(diagonal > 0, diagonal, 1.0)), 1.0)
    scaled = normal / (size[..., :, None] * size[..., None, :])
    ridge = _RIDGE * xp.eye(size.shape[-1], dtype=size.dtype, device=device(size))
    return xp.linalg.solve(scaled + ridge, (right / size)[..., None])[..., 0] / size


def _kept(xp: ModuleType, values: Any) -> Any:
    return xp.where(xp.isfinite(values), values, xp.zeros_like(values))


def _derivatives(xp: ModuleType, values: Any, axis: int) -> tuple[Any, Any]:
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
