"""Moves solids until their hidden light is that of a measurement: Levenberg and Marquardt's method.

The unknowns are place and rotation of each solid, its extents if wanted, and the roughness of the relay wall.
The derivatives are differences, because visibility has no derivatives of its own.

Source: Marquardt 1963, with the damping of each unknown in proportion to its own curvature.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.refinement.hidden_light import HiddenLight
from model.refinement.light.rough_wall import ROUGHNESS
from model.refinement.light.solids import Solid
from model.refinement.light.three_bounces import Bounces

_STEP_M, _STEP_RAD, _STEP_SIZE, _STEP_ROUGHNESS = 5e-3, 0.0125, 1e-2, 2e-2  # of the differences
_FARTHEST_M, _FARTHEST_RAD, _FARTHEST_SIZE, _FARTHEST_ROUGHNESS = 0.15, 0.5, 0.2, 0.3  # of one step
_DAMPING, _MORE, _LESS, _LEAST_DAMPING = 1e-2, 4.0, 0.2, 1e-5
_REFLECTANCE = (0.01, 1.5)  # above 1: the model and its quadrature may be too dark
_TRIALS = 4  # of larger damping, before it is a minimum
_RIDGE: Final = 1e-12


@dataclass(frozen=True)
class Guess:
    """Solids that may be there, and the roughness of the relay wall (None: it is Lambertian)."""

    solids: tuple[Solid, ...]
    roughness: float | None


@dataclass(frozen=True)
class Comparison:
    """The hidden light of a measurement, and how that of a guess is computed.

    Attributes
    ----------
    reflectance : of the solids; None: the one that explains most of the light, for each guess.
    """

    observed: HiddenLight
    bounces: Bounces
    reflectance: float | None = 1.0

    def misfit(self, guess: Guess) -> NDArray[np.float64]:
        """(M,) values of a guess less those of the measurement."""
        return self.observed.of_model(self._hidden(guess)[0]) - self.observed.values

    def reflectance_of(self, guess: Guess) -> float:
        """Reflectance of the solids: the known one, or the one that explains most."""
        return self._hidden(guess)[1]

    def with_wall_behind(self, guess: Guess) -> Comparison:
        """With the relay wall where the measurement shows it once the light of a guess is taken out."""
        observed = self.observed.with_wall_behind(self._hidden(guess)[0])
        return replace(self, observed=observed, bounces=self.bounces.with_plane(observed.plane_per_m))

    def unexplained(self, misfit: NDArray[np.float64]) -> float:
        """Like `relative`, of the part of a misfit that is not noise."""
        beyond = max(float(misfit @ misfit) - self.observed.noise_power, 0.0)
        return math.sqrt(beyond) / float(np.linalg.norm(self.observed.values))

    @property
    def noise(self) -> float:
        """Noise of the measurement's values over these values, root mean squares."""
        return math.sqrt(self.observed.noise_power) / float(np.linalg.norm(self.observed.values))

    def relative(self, misfit: NDArray[np.float64]) -> float:
        """Root mean square of a misfit over that of the measurement's values."""
        return float(np.linalg.norm(misfit) / np.linalg.norm(self.observed.values))

    def _hidden(self, guess: Guess) -> tuple[NDArray[np.complex128], float]:
        """(P, F) hidden over direct light, and the reflectance by which it is in proportion."""
        white = self.bounces.over_direct(guess.solids, guess.roughness)
        if self.reflectance is not None:
            return self.reflectance * white, self.reflectance
        light = self.observed.of_model(white)
        power = max(float(light @ light), float(np.finfo(float).tiny))
        reflectance = float(np.clip(light @ self.observed.values / power, *_REFLECTANCE))
        return reflectance * white, reflectance


@dataclass(frozen=True)
class Fit:
    """A guess, and the part of the hidden light that it does not explain.

    Attributes
    ----------
    misfit : root mean square of what is not explained, over that of the comparable light; with noise.
    unexplained : the same without noise.
    """

    guess: Guess
    misfit: float
    unexplained: float


def fitted(
    comparison: Comparison,
    start: Guess,
    *,
    steps: int,
    roughness: bool = False,
    sizes: bool = False,
    enough: float = 1e-3,
) -> Fit:
    """The nearest minimum of the misfit, after at most so many steps.

    Parameters
    ----------
    roughness : whether the roughness of the relay wall is an unknown, too.
    sizes : whether the extents of the solids are unknowns, too.
    enough : stop when a step lowers the squared misfit by a smaller share.
    """
    guess, damping = start, _DAMPING
    misfit = comparison.misfit(guess)
    for _ in range(steps):
        unknowns = list(_unknowns(guess, roughness, sizes))
        columns = [(comparison.misfit(_moved(guess, u, u.step)) - misfit) / u.step for u in unknowns]
        jacobian = np.stack(columns, axis=1)  # (M, U)
        normal, slope = jacobian.T @ jacobian, jacobian.T @ misfit
        before, tried = misfit, None
        for _ in range(_TRIALS):
            ridge = damping * np.diag(normal) + _RIDGE * np.trace(normal) + np.finfo(float).tiny
            change = np.linalg.solve(normal + np.diag(ridge), -slope)
            candidate = _changed(guess, unknowns, change)
            values = comparison.misfit(candidate)
            if values @ values < before @ before:
                tried = candidate
                break
            damping *= _MORE
        if tried is None:
            break
        guess, misfit, damping = tried, values, max(damping * _LESS, _LEAST_DAMPING)
        if before @ before - misfit @ misfit < enough * (before @ before):
            break
    return Fit(guess, comparison.relative(misfit), comparison.unexplained(misfit))


@dataclass(frozen=True)
class _Unknown:
    """One number: of which solid, of which kind, and which of its kind."""

    solid: int
    kind: str
    place: int
    step: float


def _unknowns(guess: Guess, roughness: bool, sizes: bool) -> Iterator[_Unknown]:
    for index, solid in enumerate(guess.solids):
        yield from (_Unknown(index, "place", axis, _STEP_M) for axis in range(3))
        if solid.turns:
            yield from (_Unknown(index, "turn", axis, _STEP_RAD) for axis in range(3))
        if sizes:
            yield from (_Unknown(index, "size", axis, _STEP_SIZE) for axis in range(len(solid.stretches)))
    if roughness and guess.roughness is not None:
        inwards = 1 if guess.roughness < sum(ROUGHNESS) / 2 else -1
        yield _Unknown(0, "roughness", 0, inwards * _STEP_ROUGHNESS)


def _moved(guess: Guess, unknown: _Unknown, by: float) -> Guess:
    return _changed(guess, [unknown], np.array([by]))


def _changed(guess: Guess, unknowns: list[_Unknown], change: NDArray[np.float64]) -> Guess:
    """The guess with its unknowns changed, but not by more than is likely to be better."""
    solids = []
    for index, solid in enumerate(guess.solids):
        move, turn, size = np.zeros(3), np.zeros(3), np.zeros(len(solid.stretches))
        for vector, kind in ((move, "place"), (turn, "turn"), (size, "size")):
            for unknown, value in zip(unknowns, change, strict=True):
                if unknown.solid == index and unknown.kind == kind:
                    vector[unknown.place] = value
        moved = solid.moved(_shortened(move, _FARTHEST_M), _shortened(turn, _FARTHEST_RAD))
        solids.append(moved.stretched(_shortened(size, _FARTHEST_SIZE)))
    roughness = guess.roughness
    if roughness is not None and unknowns[-1].kind == "roughness":
        by = float(np.clip(change[-1], -_FARTHEST_ROUGHNESS, _FARTHEST_ROUGHNESS))
        roughness = min(max(roughness + by, ROUGHNESS[0]), ROUGHNESS[1])
    return replace(guess, solids=tuple(solids), roughness=roughness)


def _shortened(vector: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    length = math.sqrt(vector @ vector)
    return vector if length <= longest else vector * (longest / length)
