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

`solve` is the solver. There are two ways to weight the pixels: `itof.wall.robust_solution` adapts to the
noise of one image and knows how large its errors may be, and `itof.wall.self_calibration` has the weights of
a diffuse wall, the same for every image.
Arrays may be of numpy or of any other library that supports the array API standard with linear algebra.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Final, Generic, TypeAlias

from array_api_compat import device

from itof.arrays import A
from itof.frequency_images import FrequencyImages
from itof.wall.expected_wall import ExpectedWall, depth_or_else, inverse_depth_of_plane

_BLOCK: Final = 1024  # pixels that a matrix product sums
_RIDGE: Final = 1e-12  # of the normal matrix with a unit diagonal: an unknown that no pixel shows stays 0


@dataclass(frozen=True)
class WallRays(Generic[A]):
    """The n pixels' rays to the expected wall, float64.

    Attributes
    ----------
    rays : ([N,] 3, n).
    meets : ([N,] n) whether a ray meets the wall.
    expected_depth_m : ([N,] n) with 1 where the ray misses the wall.
    slope : (F, 1) rad/m, in the precision of phases.
    """

    xp: ModuleType
    rays: A
    meets: A
    expected_depth_m: A
    slope: A

    @classmethod
    def of(cls, wall: ExpectedWall[A]) -> WallRays[A]:
        """Rays of all pixels of images."""
        xp, number = wall.images.xp, wall.images.real.dtype
        meets = by_pixel(xp, wall.meets)
        return cls(
            xp,
            by_pixel(xp, wall.rays_by_axis),
            meets,
            xp.where(meets, by_pixel(xp, wall.radial_depth_m), 1.0),
            xp.asarray(wall.slope, dtype=number, device=device(wall.rays))[:, None],
        )

    def depth_m(self, plane: A) -> tuple[A, A]:
        """Depth (..., n) of a plane (..., 3), and whether each ray meets it; else it is the expected one."""
        xp = self.xp
        inverse_per_m = inverse_depth_of_plane(xp.matrix_transpose(self.rays), plane)
        return depth_or_else(xp, inverse_per_m, self.expected_depth_m)

    def shift_m(self, depth_m: A) -> A:
        """(..., n) change of the depth, in the precision of phases."""
        return self.xp.astype(depth_m - self.expected_depth_m, self.slope.dtype)

    def turn(self, depth_m: A, offset: A) -> A:
        """Phases (..., F, n) that a depth (..., n) and offsets (..., F) give."""
        shift_m = self.shift_m(depth_m)[..., None, :]
        return shift_m * self.slope + self.xp.astype(offset, self.slope.dtype)[..., None]

    def tangent(self, depth_m: A) -> A:
        """(..., 3, n) derivative dL / dm of the depth by the plane."""
        return -(depth_m**2)[..., None, :] * self.rays


@dataclass(frozen=True)
class Residual(Generic[A]):
    """What a plane and the unknowns of the frequencies leave of the phases.

    Attributes
    ----------
    left : (..., F, n) radians in [-π, π], float64.
    depth_m : (..., n) of the plane; the expected depth where the ray misses it.
    meets : (..., n) whether the ray meets the plane.
    """

    left: A
    depth_m: A
    meets: A


@dataclass(frozen=True)
class WallPhases(Generic[A]):
    """Phases of n pixels over those of the expected wall; leading axes are those of the images.

    The unknowns are a plane (..., 3), and Q of each frequency, `local` (..., F, Q). G is F, or 1 for what is
    the same at all frequencies.

    Attributes
    ----------
    pixels : rays of the pixels.
    phases : (..., F, n) measured over expected, radians, modulo 2π.
    basis : (..., G, Q, n) what the local unknowns multiply: nothing; 1; or 1 and the four cycles.
    weight : (..., 1, n) weights of the pixels; 0 where a pixel holds no light.
    """

    xp: ModuleType
    pixels: WallRays[A]
    phases: A
    basis: A
    weight: A

    def thinned(self, every: int) -> WallPhases[A]:
        """The same with one of `every` pixels."""
        xp, pixels = self.xp, self.pixels
        some = xp.arange(0, self.phases.shape[-1], every, device=device(self.phases))
        rays, meets, depth_m, phases, basis, weight = (
            xp.take(values, some, axis=-1)
            for values in (
                *(pixels.rays, pixels.meets, pixels.expected_depth_m),
                *(self.phases, self.basis, self.weight),
            )
        )
        pixels = replace(pixels, rays=rays, meets=meets, expected_depth_m=depth_m)
        return replace(self, pixels=pixels, phases=phases, basis=basis, weight=weight)

    def first_guess(self, plane: A) -> A:
        """(..., F, Q) offsets that turn the mean phasor to 0; the other unknowns are 0."""
        xp, count = self.xp, self.basis.shape[-2]
        none = xp.zeros_like(self.phases[..., :1], dtype=xp.float64)  # (..., F, 1)
        left = self.phases - self.pixels.turn(self.pixels.depth_m(plane)[0], none[..., 0])
        along, across = (
            xp.sum(self.weight * part(left), axis=-1, keepdims=True) for part in (xp.cos, xp.sin)
        )
        return xp.concat([xp.atan2(across, along), *[none] * (count - 1)], axis=-1)[..., :count]

    def residual(self, plane: A, local: A) -> Residual[A]:
        """Phases that the unknowns leave."""
        xp, number = self.xp, self.phases.dtype
        offset = xp.sum(local[..., :1], axis=-1)  # 0 if there is none
        depth_m, meets = self.pixels.depth_m(plane)
        left = self.phases - self.pixels.turn(depth_m, offset)
        for place in range(1, local.shape[-1]):
            left = left - self.basis[..., place, :] * xp.astype(local[..., place, None], number)
        left = left - 2 * math.pi * xp.round(left / (2 * math.pi))
        return Residual(xp.astype(left, xp.float64), depth_m, meets)

    def step(
        self, plane: A, local: A, residual: Residual[A], weight: A, known: A | None = None
    ) -> tuple[A, A]:
        """Plane and local unknowns after one Gauss-Newton step from those that have this residual.

        `weight` (..., G, n) is that of each phase, `known` (P,) that of the knowledge that an unknown is 0.
        """
        xp, shape = self.xp, tuple(local.shape)
        normal, right = self.normal_equations(residual, weight)
        if known is not None:
            values = xp.concat([plane, xp.reshape(local, (*shape[:-2], -1))], axis=-1)
            normal = normal + known * xp.eye(known.shape[-1], dtype=known.dtype, device=device(known))
            right = right - known * values
        diagonal = xp.linalg.diagonal(normal)
        size = xp.where(diagonal > 0, xp.sqrt(xp.where(diagonal > 0, diagonal, 1.0)), 1.0)
        scaled = normal / (size[..., :, None] * size[..., None, :])
        ridge = _RIDGE * xp.eye(size.shape[-1], dtype=size.dtype, device=device(size))
        change = xp.linalg.solve(scaled + ridge, (right / size)[..., None])[..., 0] / size
        return plane + change[..., :3], local + xp.reshape(change[..., 3:], shape)

    def normal_equations(self, residual: Residual[A], weight: A) -> tuple[A, A]:
        """Matrix (..., P, P) and right side (..., P) for a `step` of the P = 3 + F Q unknowns."""
        xp, basis, left = self.xp, self.basis, residual.left
        k = xp.astype(self.pixels.slope, xp.float64)[..., None]  # (F, 1, 1)
        shape, (frequencies, count) = left.shape[:-2], (left.shape[-2], basis.shape[-2])
        tangent = self.pixels.tangent(residual.depth_m)[..., None, :, :]
        groups = (*shape, max(weight.shape[-2], basis.shape[-3]))
        rows = [xp.broadcast_to(each, (*groups, *each.shape[-2:])) for each in (tangent, basis)]
        rows = xp.concat(rows, axis=-2)  # (..., G, 3 + Q, n)
        # Where all frequencies have the same rows, one product has their right sides side by side.
        is_shared = groups[-1] == 1
        sides = left[..., None, :, :] if is_shared else left[..., None, :]  # (..., G, F or 1, n)
        normal, moments = _sums(xp, rows * weight[..., None, :], (rows, sides))
        # (..., F, 3 + Q)
        moments = xp.matrix_transpose(moments[..., 0, :, :]) if is_shared else moments[..., 0]
        top = xp.sum(normal[..., :3, :3] * k**2, axis=-3)
        side = xp.reshape(normal[..., 3:, :3] * k, (*shape, frequencies * count, 3))
        apart = xp.eye(frequencies, dtype=xp.float64, device=device(left))[:, None, :, None]
        own = normal[..., 3:, None, 3:] * apart  # frequencies share the plane alone
        own = xp.reshape(own, (*shape, frequencies * count, frequencies * count))
        matrix = xp.concat(
            [xp.concat([top, xp.matrix_transpose(side)], axis=-1), xp.concat([side, own], axis=-1)], axis=-2
        )
        along = xp.sum(moments[..., :3] * k[..., 0], axis=-2)  # (..., 3)
        each = xp.reshape(moments[..., 3:], (*shape, frequencies * count))
        return matrix, xp.concat([along, each], axis=-1)


# The arguments of `WallPhases.step` beside the unknowns, for the unknowns so far; None ends the steps.
Weighted: TypeAlias = tuple[WallPhases[A], Residual[A], A, A | None]
Weighting: TypeAlias = Callable[[A, A], Weighted[A] | None]


def solve(plane: A, local: A, schedule: Iterable[Weighting[A]]) -> tuple[A, A]:
    """Plane and local unknowns after a Gauss-Newton step with each weighting, until one ends the steps."""
    for weighting in schedule:
        weighted = weighting(plane, local)
        if weighted is None:
            break
        problem, residual, weight, known = weighted
        plane, local = problem.step(plane, local, residual, weight, known)
    return plane, local


def _sums(xp: ModuleType, rows: A, others: Sequence[A]) -> list[A]:
    """(..., I, J) sums over n pixels of the products of rows (..., I, n) with each of `others` (..., J, n).

    Libraries may divide a long sum among threads if they have no other images to do, which rounds it
    otherwise. So the sums are short.
    """
    blocks = [slice(start, start + _BLOCK) for start in range(0, rows.shape[-1], _BLOCK)]
    return [
        sum(rows[..., some] @ xp.matrix_transpose(other[..., some]) for some in blocks) for other in others
    ]


def four_cycles(images: FrequencyImages[A]) -> list[A]:
    """Cosine and sine of four times the phases of measured images, (..., F, H, W)."""
    xp, cycles = images.xp, 4 * images.phase
    return [xp.cos(cycles), xp.sin(cycles)]


def by_pixel(xp: ModuleType, values: A) -> A:
    """(..., n) of (..., H, W)."""
    return xp.reshape(values, (*values.shape[:-2], -1))
