"""Robust least squares for a plane, and phase offsets, from the phases of the pixels that see it.

Huber's weights for the first steps, then Tukey's biweight. `itof.wall.wall_fit` has the equation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from itof.wall.expected_wall import radial_depth_of_plane

Floats = NDArray[np.float64]

MOST_PIXELS = 2**14  # that decide a fit, evenly spread: more cost time and tell nothing new
_STEPS = 40  # at most; ten to twenty are usual
_HUBER_STEPS = 5  # Huber's weights have one minimum only: a good start for Tukey's
_SCALE_STEPS = 10  # then the scale of the residual is kept, so that the steps converge
_SMALL_STEP_RAD = 1e-8
_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficiency for Gaussian noise (Huber 1964; Beaton and Tukey 1974)
_DEVIATION_OF_MEDIAN = 1.4826  # standard deviation of Gaussian noise over its median absolute deviation
_LEAST_SCALE_RAD = 1e-7  # rounding of complex64
_NOTHING = 1e-100  # root of a normal matrix's entry: from there on its inverse would overflow
_HOPELESS_RAD = 1.0  # scale of the residual that ends the steps early; 2.3 rad for random phases


@dataclass(frozen=True)
class PlanePhases:
    """Phases of the pixels that see a wall, over those of the expected wall, as a least-squares problem.

    Attributes
    ----------
    phases : (n, F) measured over expected, radians, modulo 2π.
    rays : (n, 3) unit vectors of the pixels.
    expected_depth_m : (n,) expected distance along the rays, metres.
    weight : (n,) weights of the pixels.
    slope : (F,) phase per metre of depth, rad/m.
    with_offsets : whether a phase offset for each frequency is unknown, beside the plane.
    """

    phases: Floats
    rays: Floats
    expected_depth_m: Floats
    weight: Floats
    slope: Floats
    with_offsets: bool

    def thinned(self) -> PlanePhases:
        """The same with at most about `MOST_PIXELS` pixels."""
        every = slice(None, None, max(1, len(self.weight) // MOST_PIXELS))
        return replace(
            self,
            phases=self.phases[every],
            rays=self.rays[every],
            expected_depth_m=self.expected_depth_m[every],
            weight=self.weight[every],
        )

    def residual(self, plane: Floats, offset: Floats) -> tuple[Floats, Floats, Floats]:
        """Phases (n, F) that plane and offsets leave; the depth's derivative (n, 3); the depth (n,)."""
        depth_m = radial_depth_of_plane(self.rays, plane)
        meets = np.isfinite(depth_m)
        depth = np.where(meets, depth_m, 0.0)
        model = (depth - self.expected_depth_m)[:, None] * self.slope + offset
        left = np.where(meets[:, None], wrapped(self.phases - model), np.pi)
        return left, -(depth**2)[:, None] * self.rays, depth_m

    def solve(self, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Plane, offsets and the covariance of both (without offsets: of the plane)."""
        plane, offset, scale = start.copy(), np.zeros(len(self.slope)), 1.0
        if self.with_offsets:
            offset = np.angle(self.weight @ np.exp(1j * self.residual(plane, offset)[0]))
        for step in range(_STEPS):
            left, tangent, depth_m = self.residual(plane, offset)
            if step < _SCALE_STEPS:
                scale = self._scale(left)
            weights = self._robust(left / scale, tukey=step >= _HUBER_STEPS)
            weights *= np.isfinite(depth_m)[:, None]
            change = self._step(left, tangent, weights)
            plane, offset = plane + change[:3], offset + change[3:]
            moved_rad = np.abs(tangent @ change[:3]).max() * self.slope.max() + np.abs(change[3:]).max()
            if step >= _SCALE_STEPS and (moved_rad < _SMALL_STEP_RAD or scale > _HOPELESS_RAD):
                break
        return plane, offset, self._covariance(left, tangent, scale)

    def _scale(self, left: Floats) -> float:
        """Standard deviation of what is left, from its weighted median."""
        values, every = np.abs(left).reshape(-1), np.repeat(self.weight, left.shape[1])
        order = np.argsort(values)
        total = np.cumsum(every[order])
        median = float(values[order[np.searchsorted(total, total[-1] / 2)]])
        return max(_DEVIATION_OF_MEDIAN * median, _LEAST_SCALE_RAD)

    def _robust(self, times: Floats, *, tukey: bool) -> Floats:
        """(n, F) weights that are small where the residual is many `times` its scale."""
        if tukey:
            return self.weight[:, None] * (1 - np.minimum(np.abs(times) / _TUKEY, 1.0) ** 2) ** 2
        return self.weight[:, None] * _HUBER / np.maximum(np.abs(times), _HUBER)

    def _step(self, left: Floats, tangent: Floats, weights: Floats) -> Floats:
        """Least-squares change (3 + F) of the unknowns."""
        right = np.concatenate([tangent.T @ ((weights * left) @ self.slope), (weights * left).sum(axis=0)])
        inverse = _inverse(self._normal(tangent, weights))
        change = np.zeros(len(right))
        change[: len(inverse)] = inverse @ right[: len(inverse)]
        return change

    def _normal(self, tangent: Floats, weights: Floats) -> Floats:
        """Sum of weight · gradient · gradientᵀ over all phases; gradients by plane and offsets."""
        k, count = self.slope, 3 + (len(self.slope) if self.with_offsets else 0)
        normal = np.zeros((count, count))
        normal[:3, :3] = (tangent * (weights @ k**2)[:, None]).T @ tangent
        if self.with_offsets:
            normal[:3, 3:] = tangent.T @ weights * k
            normal[3:, :3] = normal[:3, 3:].T
            normal[3:, 3:] = np.diag(weights.sum(axis=0))
        return normal

    def _covariance(self, left: Floats, tangent: Floats, scale: float) -> Floats:
        """Covariance of the unknowns of Tukey's estimate, for noise of any strength in each pixel.

        Source: the sandwich estimator of M-estimates (Huber 1967).
        """
        square = np.minimum(np.abs(left / scale) / _TUKEY, 1.0) ** 2
        slope_of_influence = self.weight[:, None] * (1 - square) * (1 - 5 * square)
        influence = self.weight[:, None] * (1 - square) ** 2 * left
        bread = _inverse(self._normal(tangent, slope_of_influence))
        return bread @ self._normal(tangent, influence**2) @ bread


def _inverse(normal: Floats) -> Floats:
    """Inverse of a normal matrix; unknowns that no phase depends on get a variance and a change of 0."""
    size = np.sqrt(np.abs(np.diag(normal)))  # unknowns of the same size: a better condition
    told = size > _NOTHING
    size = np.where(told, size, 1.0)
    scaled: Floats = np.where(np.outer(told, told), normal, 0.0) / np.outer(size, size)
    return np.linalg.pinv(scaled, rcond=1e-12, hermitian=True) / np.outer(size, size)


def wrapped(phases: Floats) -> Floats:
    """Phases modulo 2π, in [-π, π]."""
    return phases - 2 * np.pi * np.round(phases / (2 * np.pi))
