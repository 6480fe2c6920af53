"""Robust solution of the phases of one image, in numpy: it adapts to the image's errors, and states its own.

The steps are those of `itof.wall.wall_phases`, with Huber's weights at first, then with Tukey's biweight.

*Errors that are smooth over the image.* Light scattered in the lens, waves and hidden light bend the phases
smoothly, so they do not average out as the noise of pixels does. What a fit leaves is therefore projected on
polynomials of the image, orthonormal under the pixels' weights. The mean square of these coefficients per
degree of freedom is the variance of a smooth error, v. Noise of single pixels is in it with its share. What
is known of the unknowns beforehand (Gaussian, mean 0, variances P) is a ridge on the normal equations N:

    x = (N + u / P)^-1 (right side),    covariance = (N + u / P)^-1 (s N + u² / P) (N + u / P)^-1

with u = v + (1 mrad)², because a fit may hide a smooth error, and s = v + (3 mrad)², because a camera may
hide a larger one, such as the light scattered in a lens. For u = s this is the covariance of Bayes' rule; a
smaller u trusts the image more.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from itof.arrays import Floats
from itof.wall.wall_phases import Residual, WallPhases, Weighted, solve

_SMOOTH_RAD: Final = 1e-3  # for the fit: errors that it may hide;
_STATED_RAD: Final = 3e-3  # for its covariance
WAVES_STD_RAD: Final = 0.05  # of both four-cycle errors: 70 mrad together, as square waves have
_DEGREE = 3  # of the polynomials
_STEPS = 40  # at most; ten to twenty are usual
_HUBER_STEPS = 5  # Huber's weights have one minimum only: a good start for Tukey's
_SCALE_STEPS = 10  # then the scale of the residual is kept, so that the steps converge
_SMALL_STEP_RAD = 1e-8
_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficiency for Gaussian noise (Huber 1964; Beaton and Tukey 1974)
_DEVIATION_OF_MEDIAN = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation
_LEAST_SCALE_RAD = 1e-7  # rounding of complex64
_NOTHING = 1e-100  # root of a normal matrix's entry: from there on its inverse would overflow
_HOPELESS_RAD = 1.0  # scale of the residual that ends the steps early; 2.3 rad for random phases


def robust_solution(
    problem: WallPhases[Floats], start: Floats, offset_std_rad: Floats
) -> tuple[Floats, Floats, Floats]:
    """Plane (3,), offsets and four-cycle errors (F, 3), and the covariance (P, P) of both.

    Parameters
    ----------
    problem : with offsets alone. The four cycles are those of the fitted phases: noise of the measured ones
        would look like an error of the camera.
    start : (3,) plane.
    offset_std_rad : (F,) standard deviations of the offsets about 0; infinite if nothing is known.
    """
    count = len(offset_std_rad)
    local_std_rad = np.stack([offset_std_rad, *[np.full(count, WAVES_STD_RAD)] * 2], axis=-1)
    plane, local = start.copy(), np.zeros((count, 3))
    local[:, :1] = np.where(np.isinf(local_std_rad[:, :1]), problem.first_guess(start), 0.0)
    known = np.concatenate([np.zeros(3), (1 / local_std_rad**2).reshape(-1)])  # inverse variances
    weighting = _Adapting(problem, known, _smooth_modes(problem))
    plane, local = solve(plane, local, itertools.repeat(weighting, _STEPS))
    return plane, local, weighting.covariance()


@dataclass
class _Adapting:
    """Weights that adapt to what each step leaves; they end the steps when these no longer move the fit."""

    problem: WallPhases[Floats]
    known: Floats  # (P,) inverse variances
    modes: Floats
    steps: int = 0
    scale: float = 1.0  # of the residual
    variance: float = 1.0  # of a smooth error

    def __call__(self, plane: Floats, local: Floats) -> Weighted[Floats] | None:
        if self.steps > _SCALE_STEPS and (self.scale > _HOPELESS_RAD or self._is_settled(plane, local)):
            return None
        problem = _with_four_cycles(self.problem, plane)
        residual = problem.residual(plane, local)
        if self.steps < _SCALE_STEPS:
            self.scale = _scale(problem.weight, np.where(residual.meets, residual.left, np.pi))
            smooth = _smooth_variance(problem, self.modes, residual, self.scale)
            # slowly: a ridge that falls at once lets unknowns jump that hardly matter
            self.variance = float(np.sqrt(self.variance * smooth))
        share = _share(residual.left / self.scale, tukey=self.steps >= _HUBER_STEPS)
        self.ridge = (self.variance + _SMOOTH_RAD**2) * self.known
        self.steps, self.before, self.last = self.steps + 1, (plane, local), (problem, residual)
        self.weight = problem.weight * share * residual.meets
        return problem, residual, self.weight, self.ridge

    def _is_settled(self, plane: Floats, local: Floats) -> bool:
        pixels, (_, residual), (before, before_rad) = self.problem.pixels, self.last, self.before
        moved_m = np.abs((plane - before) @ pixels.tangent(residual.depth_m)).max()
        moved_rad = moved_m * pixels.slope.max() + np.abs(local - before_rad).max(initial=0.0)
        return bool(moved_rad < _SMALL_STEP_RAD)

    def covariance(self) -> Floats:
        """(P, P) of the unknowns after the last step."""
        problem, residual = self.last
        variance = _smooth_variance(problem, self.modes, residual, self.scale)
        normal, _ = problem.normal_equations(residual, self.weight)
        inverse = _inverse(normal + np.diag(self.ridge))
        stated = (variance + _STATED_RAD**2) * normal + np.diag((variance + _SMOOTH_RAD**2) * self.ridge)
        covariance: Floats = inverse @ stated @ inverse
        return covariance


def _with_four_cycles(problem: WallPhases[Floats], plane: Floats) -> WallPhases[Floats]:
    """The problem with the four cycles of the phases of a plane."""
    waves = four_cycles_of(problem.pixels.depth_m(plane)[0], problem.pixels.slope)
    return replace(problem, basis=np.concatenate([np.ones_like(waves[:, :1]), waves], axis=1))


def four_cycles_of(depth_m: Floats, slope: Floats) -> Floats:
    """(F, 2, n) cosine and sine of four times the phases of depths (n,), for slopes (F, 1) in rad/m."""
    cycles = 4 * slope * depth_m
    return np.stack([np.cos(cycles), np.sin(cycles)], axis=1)


def _smooth_modes(problem: WallPhases[Floats]) -> Floats:
    """(n, M) polynomials of the image times the roots of the weights, orthonormal."""
    x, y, z = problem.pixels.rays
    root = np.sqrt(problem.weight[0])
    powers = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    rows = np.stack([(x / z) ** i * (y / z) ** j * root for i, j in powers])
    modes: Floats = np.linalg.qr(rows.T)[0]
    return modes


def _smooth_variance(
    problem: WallPhases[Floats], modes: Floats, residual: Residual[Floats], scale: float
) -> float:
    """Variance of a smooth error, radians²; pixels that see no wall count with three times the scale."""
    left = np.clip(np.where(residual.meets, residual.left, np.pi), -3 * scale, 3 * scale)
    found = (left * np.sqrt(problem.weight)) @ modes  # (F, M)
    freedom = max(found.size - 3 - len(found), 1)
    return float((found**2).sum() / freedom)


def _scale(weight: Floats, left: Floats) -> float:
    """Standard deviation of what is left (F, n), from its median with the weights (1, n) of the pixels."""
    values, every = np.abs(left).reshape(-1), np.broadcast_to(weight, left.shape).reshape(-1)
    order = np.argsort(values)
    total = np.cumsum(every[order])
    median = float(values[order[np.searchsorted(total, total[-1] / 2)]])
    return max(_DEVIATION_OF_MEDIAN * median, _LEAST_SCALE_RAD)


def _share(times: Floats, *, tukey: bool) -> Floats:
    """Shares of the weights that are small where the residual is many `times` its scale."""
    if tukey:
        return np.square(1 - np.square(np.minimum(np.abs(times) / _TUKEY, 1.0)))
    return _HUBER / np.maximum(np.abs(times), _HUBER)


def _inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix; unknowns that no phase depends on get a variance of 0."""
    size = np.sqrt(np.abs(np.diag(normal)))  # unknowns of the same size: a better condition
    told = size > _NOTHING
    size = np.where(told, size, 1.0)
    scaled: Floats = np.where(np.outer(told, told), normal, 0.0) / np.outer(size, size)
    return np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(size, size)
