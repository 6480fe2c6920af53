"""Moves objects until their hidden light is that of a measurement: Levenberg and Marquardt's method.

The derivatives are central differences of light with few nodes, because visibility has no derivatives of
its own, and because one-sided ones end a fit in a long valley, as of size and reflectance. Many fits go side
by side, because the engine computes the light of many candidates for little more than that of one.

Source: Marquardt 1963, with the damping of each unknown in proportion to its own curvature.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.refinement.hidden_light import HiddenLight
from model.refinement.light.corner_light import CornerLight, with_camera_at, with_wall_at
from model.refinement.unknowns import Fitted, Unknown, changed, unknowns
from model.refinement.wall_brightness import walls_as_bright
from scenegen.scene import Scene

Floats = NDArray[np.float64]
_DAMPING, _MORE, _LESS, _LEAST_DAMPING = 1e-2, 4.0, 0.2, 1e-5
_REFLECTANCE = (0.01, 1.5)  # above 1: the model and its quadrature may be too dark
_TRIALS = 4  # of larger damping, before it is a minimum
_RIDGE: Final = 1e-12
_POSES: Final = Fitted()


@dataclass(frozen=True)
class Comparison:
    """The hidden light of a measurement, and how that of candidates is computed.

    Attributes
    ----------
    corner : known, but for the plane of its relay wall; its hidden objects do not matter.
    light : of the corner.
    fine : for an error of 1 % and not 3 %.
    reflectance : of the objects, over that of the candidates'; None: the one that explains most of the light,
        for each candidate.
    knows_camera : whether it is the relay wall that is moved, not the camera, so that the camera sees it
        where the measurement shows it.
    """

    observed: HiddenLight
    corner: Scene
    light: CornerLight
    fine: bool
    reflectance: float | None = 1.0
    knows_camera: bool = True

    def placed(self, candidate: Scene) -> Scene:
        """The candidate with its relay wall where the measurement shows it from its camera."""
        wall, camera = self._place.relay_wall, self._place.camera
        wall = replace(candidate.relay_wall, location_m=wall.location_m, rotation_deg=wall.rotation_deg)
        return replace(candidate, relay_wall=wall, camera=camera)

    @cached_property
    def _place(self) -> Scene:
        placed = with_wall_at if self.knows_camera else with_camera_at
        return placed(self.corner, self.observed.plane_per_m)

    def misfits(self, candidates: Sequence[Scene]) -> list[Floats]:
        """(M,) values of each candidate less those of the measurement."""
        return misfits([(self, candidate) for candidate in candidates])

    def reflectance_of(self, candidate: Scene) -> float:
        """Reflectance of the objects: the known one, or the one that explains most."""
        return _hidden([(self, candidate)])[0][1]

    def behind(self, candidate: Scene) -> tuple[Comparison, Scene]:
        """With the relay wall that the measurement shows once the light of a candidate is taken out."""
        hidden = _hidden([(self, candidate)])[0][0]
        moved = replace(self, observed=self.observed.with_wall_behind(hidden))
        amplitude = self.observed.amplitude / np.abs(1 + hidden[:, 0])
        (wall,) = walls_as_bright([moved.placed(candidate)], self.observed.rays, amplitude, self.light)
        return moved, replace(candidate, relay_wall=wall)

    def unexplained(self, misfit: Floats) -> float:
        """Like `relative`, of the part of a misfit that is not noise."""
        beyond = max(float(misfit @ misfit) - self.observed.noise_power, 0.0)
        return math.sqrt(beyond) / float(np.linalg.norm(self.observed.values))

    @property
    def noise(self) -> float:
        """Noise of the measurement's values over these values, root mean squares."""
        return math.sqrt(self.observed.noise_power) / float(np.linalg.norm(self.observed.values))

    def relative(self, misfit: Floats) -> float:
        """Root mean square of a misfit over that of the measurement's values."""
        return float(np.linalg.norm(misfit) / np.linalg.norm(self.observed.values))


Asked = Sequence[tuple[Comparison, Scene]]


def misfits(asked: Asked) -> list[Floats]:
    """(M,) values of candidates less those of their measurements, all with the same rays and one engine."""
    return [
        comparison.observed.of_model(hidden) - comparison.observed.values
        for (comparison, _), (hidden, _) in zip(asked, _hidden(asked), strict=True)
    ]


def _hidden(asked: Asked) -> list[tuple[NDArray[np.complex128], float]]:
    """(P, F) hidden over direct light of each candidate, and the reflectance by which it is in proportion."""
    first = asked[0][0]
    placed = [comparison.placed(candidate) for comparison, candidate in asked]
    found = []
    whites = first.light.over_direct(placed, first.observed.rays, fine=first.fine)
    for (comparison, _), white in zip(asked, whites, strict=True):
        reflectance = comparison.reflectance
        if reflectance is None:
            light = comparison.observed.of_model(white)
            power = max(float(light @ light), float(np.finfo(float).tiny))
            reflectance = float(np.clip(light @ comparison.observed.values / power, *_REFLECTANCE))
        found.append((reflectance * white, reflectance))
    return found


@dataclass(frozen=True)
class Fit:
    """A candidate, and the part of the hidden light that it does not explain.

    Attributes
    ----------
    misfit : root mean square of what is not explained, over that of the comparable light; with noise.
    unexplained : the same without noise.
    """

    comparison: Comparison
    candidate: Scene
    misfit: float
    unexplained: float


@dataclass
class _Going:
    """A fit on its way."""

    comparison: Comparison
    candidate: Scene
    misfit: Floats
    damping: float = _DAMPING
    has_ended: bool = False

    @property
    def with_few_nodes(self) -> _Going:
        """The fit with cheap derivatives: those of few nodes lead to the same minimum."""
        return replace(self, comparison=replace(self.comparison, fine=False))

    def takes(self, candidate: Scene, misfit: Floats, trial: int, enough: float) -> bool:
        """Go to a candidate if its misfit is smaller; whether it was."""
        before, after = self.misfit @ self.misfit, misfit @ misfit
        if not after < before:
            return False
        self.candidate, self.misfit = candidate, misfit
        self.damping = max(self.damping * _MORE**trial * _LESS, _LEAST_DAMPING)
        self.has_ended = bool(before - after < enough * before)
        return True


def least_misfits(
    starts: Asked,
    *,
    steps: int,
    fitted: Fitted = _POSES,
    enough: float = 1e-3,
    one_sided: bool = False,
) -> list[Fit]:
    """The nearest minimum of the misfit of each start, after at most so many steps.

    Parameters
    ----------
    starts : comparisons with the same rays and one engine.
    fitted : what is unknown besides poses.
    enough : stop when a step lowers the squared misfit by a smaller share.
    one_sided : differences of half the price, for the first steps; of comparisons that are not `fine`.
    """
    if not starts:
        return []
    fits = [_Going(*start, misfit) for start, misfit in zip(starts, misfits(starts), strict=True)]
    for _ in range(steps):
        going = [fit for fit in fits if not fit.has_ended]
        if going:
            _step(going, fitted, enough, one_sided)
    return [
        Fit(
            *(fit.comparison, fit.candidate),
            *(fit.comparison.relative(fit.misfit), fit.comparison.unexplained(fit.misfit)),
        )
        for fit in fits
    ]


def _step(fits: Sequence[_Going], fitted: Fitted, enough: float, one_sided: bool) -> None:
    """One step of each fit: it takes the smallest of a few dampings that lowers its misfit."""
    slopes = _forward(fits, fitted) if one_sided else jacobians([fit.with_few_nodes for fit in fits], fitted)
    left = list(range(len(fits)))
    for trial in range(_TRIALS):
        asked = []
        for place in left:
            fit, (numbers, jacobian) = fits[place], slopes[place]
            change = _change(jacobian, fit.misfit, fit.damping * _MORE**trial)
            asked.append((fit.comparison, changed(fit.candidate, numbers, change)))
        tried = misfits(asked) if asked else []
        left = [
            place
            for place, (_, candidate), misfit in zip(left, asked, tried, strict=True)
            if not fits[place].takes(candidate, misfit, trial, enough)
        ]
    for place in left:
        fits[place].has_ended = True


def _change(jacobian: Floats, misfit: Floats, damping: float) -> Floats:
    normal, slope = jacobian.T @ jacobian, jacobian.T @ misfit
    least = _RIDGE * np.trace(normal) + np.finfo(float).tiny
    change: Floats = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + least), -slope)
    return change


def jacobians(fits: Sequence[Fit | _Going], fitted: Fitted) -> list[tuple[Sequence[Unknown], Floats]]:
    """The unknowns of each fit, and (M, U) the derivatives of its values by them: central differences."""
    numbers = [unknowns(fit.candidate, fitted, fit.comparison.fine) for fit in fits]
    moved = [
        (fit.comparison, changed(fit.candidate, [each], np.array([step])))
        for fit, own in zip(fits, numbers, strict=True)
        for each in own
        for step in each.steps
    ]
    found = iter(misfits(moved))
    return [
        (own, np.stack([(next(found) - next(found)) / np.ptp(each.steps) for each in own], axis=1))
        for own in numbers
    ]


def _forward(fits: Sequence[_Going], fitted: Fitted) -> list[tuple[Sequence[Unknown], Floats]]:
    """As `jacobians`, by one-sided differences."""
    numbers = [unknowns(fit.candidate, fitted, fit.comparison.fine) for fit in fits]
    steps = [[each.steps[0] or each.steps[1] for each in own] for own in numbers]
    moved = [
        (fit.comparison, changed(fit.candidate, [each], np.array([step])))
        for fit, own, some in zip(fits, numbers, steps, strict=True)
        for each, step in zip(own, some, strict=True)
    ]
    found = iter(misfits(moved))
    return [
        (own, np.stack([(next(found) - fit.misfit) / step for step in some], axis=1))
        for fit, own, some in zip(fits, numbers, steps, strict=True)
    ]
