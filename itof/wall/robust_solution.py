"""Robust weights for the phases of one image, in numpy: they adapt to its noise, and give its errors.

Huber's weights for the first steps, then Tukey's biweight. `itof.wall.wall_phases` has the equation.
"""

from __future__ import annotations

import numpy as np

from itof.arrays import Floats
from itof.wall.wall_phases import Residual, WallPhases

_STEPS = 40  # at most; ten to twenty are usual
_HUBER_STEPS = 5  # Huber's weights have one minimum only: a good start for Tukey's
_SCALE_STEPS = 10  # then the scale of the residual is kept, so that the steps converge
_SMALL_STEP_RAD = 1e-8
_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficiency for Gaussian noise (Huber 1964; Beaton and Tukey 1974)
_DEVIATION_OF_MEDIAN = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation
_LEAST_SCALE_RAD = 1e-7  # rounding of complex64
_NOTHING = 1e-100  # root of a normal matrix's entry: from there on its inverse would overflow
_HOPELESS_RAD = 1.0  # scale of the residual that ends the steps early; 2.3 rad for random phases


def robust_solution(problem: WallPhases, start: Floats) -> tuple[Floats, Floats, Floats]:
    """Plane (3,), local unknowns (F, Q) and the covariance (P, P) of both."""
    plane, local, scale = start.copy(), problem.first_guess(start), 1.0
    for step in range(_STEPS):
        residual = problem.residual(plane, local)
        if step < _SCALE_STEPS:
            scale = _scale(problem.weight, np.where(residual.meets, residual.left, np.pi))
        weight = problem.weight * _share(residual.left / scale, tukey=step >= _HUBER_STEPS) * residual.meets
        normal, right = problem.normal_equations(residual, weight)
        change = _inverse(normal) @ right
        plane, local = plane + change[:3], local + change[3:].reshape(local.shape)
        moved_m = np.abs(change[:3] @ problem.pixels.tangent(residual.depth_m)).max()
        moved_rad = moved_m * problem.pixels.slope.max() + np.abs(change[3:]).max(initial=0.0)
        if step >= _SCALE_STEPS and (moved_rad < _SMALL_STEP_RAD or scale > _HOPELESS_RAD):
            break
    return plane, local, _covariance_of_tukey(problem, residual, scale)


def covariance(
    problem: WallPhases, residual: Residual, slope_of_influence: Floats, influence: Floats
) -> Floats:
    """(P, P) covariance of the unknowns of an M-estimate, for noise of any strength in each pixel.

    Parameters
    ----------
    influence : (F, n) weight of each phase times what is left of it.
    slope_of_influence : (F, n) its derivative by what is left.

    Source: the sandwich estimator (Huber 1967; for least squares White 1980).
    """
    bread = _inverse(problem.normal_equations(residual, slope_of_influence)[0])
    return bread @ problem.normal_equations(residual, influence**2)[0] @ bread


def _covariance_of_tukey(problem: WallPhases, residual: Residual, scale: float) -> Floats:
    square = np.minimum(np.abs(residual.left / scale) / _TUKEY, 1.0) ** 2
    weight = problem.weight * residual.meets
    slope_of_influence = weight * (1 - square) * (1 - 5 * square)
    return covariance(problem, residual, slope_of_influence, weight * (1 - square) ** 2 * residual.left)


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
    """Inverse of a normal matrix; unknowns that no phase depends on get a variance and a change of 0."""
    size = np.sqrt(np.abs(np.diag(normal)))  # unknowns of the same size: a better condition
    told = size > _NOTHING
    size = np.where(told, size, 1.0)
    scaled: Floats = np.where(np.outer(told, told), normal, 0.0) / np.outer(size, size)
    return np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(size, size)
