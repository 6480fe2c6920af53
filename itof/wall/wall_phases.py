"""The relay wall in the phases of images, as a least-squares problem.

All but 0.2 % of a phasor z_f is the direct return of the relay wall. Its phase over the expected direct
return d_f is therefore small and smooth:

    arg(z_f conj d_f) = k_f (L - L_0) + o_f + a_f cos 4 φ_f + b_f sin 4 φ_f + hidden light + noise,
    k_f = 4π f / c

L is the wall's distance along the ray r of a pixel and L_0 the expected one. For a plane, 1 / L = m · r is
linear in m, so dL = -L² r · dm. The unknowns are the plane (3) and, as options, a phase offset per frequency
(F) and the four-cycle error of a square-wave camera (2F). φ_f = arg z_f is the measured phase, of which the
four-cycle error is a function. The unknowns follow by least squares over all pixels and frequencies; the step
is repeated because L depends on the plane (Gauss-Newton).

There are two ways to weight the pixels: `itof.wall.wall_fit` adapts to the noise of one image and estimates
the errors, and `itof.wall.self_calibration` has the weights of a diffuse wall, the same for every image.
Arrays may be of numpy or of any other library that supports the array API standard with linear algebra.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Generic

from array_api_compat import device

from itof.arrays import A
from itof.wall.expected_wall import ExpectedWall, radial_depth_of_plane


@dataclass(frozen=True)
class WallRays(Generic[A]):
    """The n pixels' rays to the expected wall, float64.

    Attributes
    ----------
    rays : ([N,] n, 3).
    meets : ([N,] n) whether a ray meets the wall.
    expected_depth_m : ([N,] n) with 0 where the ray misses the wall.
    slope : (F, 1) rad/m.
    """

    xp: ModuleType
    rays: A
    meets: A
    expected_depth_m: A
    slope: A

    @classmethod
    def of(cls, xp: ModuleType, wall: ExpectedWall[A]) -> WallRays[A]:
        """Rays of all pixels of images."""
        pixels = (*wall.rays.shape[:-3], -1)  # ([N,] n)
        meets = xp.reshape(xp.isfinite(wall.radial_depth_m), pixels)
        depth_m = xp.reshape(wall.radial_depth_m, pixels)
        return cls(
            xp,
            xp.reshape(wall.rays, (*pixels, 3)),
            meets,
            xp.where(meets, depth_m, xp.zeros_like(depth_m)),
            xp.asarray(wall.slope, dtype=xp.float64, device=device(wall.rays))[:, None],
        )

    def turn(self, plane: A, offset: A) -> tuple[A, A, A]:
        """Phases (..., F, n) that a plane (..., 3) and offsets (..., F) give, and the plane's depth (..., n).

        Third, whether each ray meets the plane (..., n); where it does not, the depth is the expected one.
        """
        xp = self.xp
        depth_m = radial_depth_of_plane(self.rays, plane)
        meets = xp.isfinite(depth_m)
        depth_m = xp.where(meets, depth_m, self.expected_depth_m)
        turn = (depth_m - self.expected_depth_m)[..., None, :] * self.slope + offset[..., None]
        return turn, depth_m, meets

    def tangent(self, depth_m: A) -> A:
        """(..., 3, n) derivative dL / dm of the depth by the plane."""
        return -(depth_m**2)[..., None, :] * self.xp.matrix_transpose(self.rays)


@dataclass(frozen=True)
class Residual(Generic[A]):
    """What a plane and the unknowns of the frequencies leave of the phases.

    Attributes
    ----------
    left : (..., F, n) radians in [-π, π].
    depth_m : (..., n) of the plane; the expected depth where the ray misses it.
    meets : (..., n) whether the ray meets the plane.
    """

    left: A
    depth_m: A
    meets: A


@dataclass(frozen=True)
class WallPhases(Generic[A]):
    """Phases of n pixels over those of the expected wall, float64; leading axes are those of the images.

    The unknowns are a plane (..., 3), and Q of each frequency, `local` (..., F, Q).

    Attributes
    ----------
    pixels : rays of the pixels.
    phases : (..., F, n) measured over expected, radians, modulo 2π.
    basis : (..., F, Q, n) what the local unknowns multiply: nothing; 1; or 1 and the four cycles.
    weight : (..., 1, n) weights of the pixels; 0 where a pixel holds no light.
    """

    xp: ModuleType
    pixels: WallRays[A]
    phases: A
    basis: A
    weight: A

    def thinned(self, every: int) -> WallPhases[A]:
        """The same with one of `every` pixels."""
        pixels, some = self.pixels, (..., slice(None, None, every))
        rays = pixels.rays[..., ::every, :]
        pixels = replace(
            pixels, rays=rays, meets=pixels.meets[some], expected_depth_m=pixels.expected_depth_m[some]
        )
        arrays = {name: getattr(self, name)[some] for name in ("phases", "basis", "weight")}
        return replace(self, pixels=pixels, **arrays)

    def first_guess(self, plane: A) -> A:
        """(..., F, Q) offsets that turn the mean phasor to 0; the other unknowns are 0."""
        xp = self.xp
        none = xp.zeros_like(self.basis[..., 0])  # (..., F, Q)
        if not none.shape[-1]:
            return none
        left = self.phases - self.pixels.turn(plane, none[..., 0])[0]
        along, across = (xp.sum(self.weight * part(left), axis=-1) for part in (xp.cos, xp.sin))
        return xp.concat([xp.atan2(across, along)[..., None], none[..., 1:]], axis=-1)

    def residual(self, plane: A, local: A) -> Residual[A]:
        """Phases that the unknowns leave."""
        xp = self.xp
        offset = xp.sum(local[..., :1], axis=-1)  # 0 if there is none
        turn, depth_m, meets = self.pixels.turn(plane, offset)
        left = self.phases - turn - xp.sum(self.basis[..., 1:, :] * local[..., 1:, None], axis=-2)
        return Residual(left - 2 * math.pi * xp.round(left / (2 * math.pi)), depth_m, meets)

    def normal_equations(self, residual: Residual[A], weight: A) -> tuple[A, A]:
        """Matrix (..., P, P) and right side (..., P) for a step of the P = 3 + F Q unknowns.

        `weight` (..., F, n) is that of each phase.
        """
        xp, k, basis = self.xp, self.pixels.slope, self.basis
        left, tangent = residual.left, self.pixels.tangent(residual.depth_m)
        frequencies, count = basis.shape[-3:-1]
        seen = basis * weight[..., None, :]  # (..., F, Q, n)
        rows = (*left.shape[:-2], frequencies * count, left.shape[-1])
        seen_rows, columns = xp.reshape(seen, rows), xp.matrix_transpose(xp.reshape(basis, rows))
        top = (tangent * xp.sum(weight * k**2, axis=-2, keepdims=True)) @ xp.matrix_transpose(tangent)
        side = tangent @ xp.matrix_transpose(xp.reshape(seen * k[..., None], rows))  # (..., 3, F Q)
        own = (seen_rows @ columns) * self._blocks(frequencies, count)  # frequencies share the plane alone
        upper = xp.concat([top, side], axis=-1)
        lower = xp.concat([xp.matrix_transpose(side), own], axis=-1)
        along = xp.sum(tangent * xp.sum(weight * left * k, axis=-2, keepdims=True), axis=-1)  # (..., 3)
        each = xp.reshape(xp.sum(seen * left[..., None, :], axis=-1), rows[:-1])  # (..., F Q)
        return xp.concat([upper, lower], axis=-2), xp.concat([along, each], axis=-1)

    def _blocks(self, frequencies: int, count: int) -> A:
        """(F Q, F Q): 1 where both unknowns are of the same frequency."""
        xp = self.xp
        place = xp.arange(frequencies * count, device=device(self.phases)) // max(count, 1)
        return xp.astype(place[:, None] == place, xp.float64)


def phases_of(xp: ModuleType, z: A) -> A:
    """Phases of complex numbers, radians, float64."""
    return xp.astype(xp.atan2(xp.imag(z), xp.real(z)), xp.float64)


def four_cycles(xp: ModuleType, measured: A) -> list[A]:
    """Cosine and sine of four times the phases of measured phasors (..., F, n)."""
    cycles = phases_of(xp, measured)
    return [xp.cos(4 * cycles), xp.sin(4 * cycles)]


def by_frequency(xp: ModuleType, values: A) -> A:
    """(..., F, n) of (..., H, W, F)."""
    return xp.moveaxis(xp.reshape(values, (*values.shape[:-3], -1, values.shape[-1])), -1, -2)
