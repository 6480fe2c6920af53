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
from model.refinement.unknowns import Fitted, Unknown, changed, unknowns, within_reach
from model.refinement.wall_brightness import WallBrightness
from scenegen.scene import Scene

Floats = NDArray[np.float64]
_DAMPING, _MORE, _LESS, _LEAST_DAMPING = 1e-2, 4.0, 0.2, 1e-5
_REFLECTANCE = (0.01, 1.5)  # above 1: the model and its quadrature may be too dark
_ROUNDS: Final = 2  # of the reflectance: phases are not quite in proportion to the light of bright objects
_TRIALS = 4  # of larger damping, before it is a minimum
_ENOUGH: Final = 1e-3  # a step that lowers the squared misfit by a smaller share is the last
_REUSED: Final = 2
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
    lacking : (P, F) what the light in the middles of blocks lacks near one candidate (`corrected`), or None.
    brightness : of the relay walls; None: that of each candidate.
    """

    observed: HiddenLight
    corner: Scene
    light: CornerLight
    fine: bool
    reflectance: float | None = 1.0
    knows_camera: bool = True
    lacking: NDArray[np.complex128] | None = None
    brightness: WallBrightness | None = None

    def placed(self, candidate: Scene) -> Scene:
        """The candidate with its relay wall where, and as bright as, the measurement shows it."""
        wall, own = self._place.relay_wall, candidate.relay_wall
        darkening = own.darkening if self.brightness is None else self.brightness.darkening(own.roughness)
        own = replace(own, location_m=wall.location_m, rotation_deg=wall.rotation_deg, darkening=darkening)
        return replace(candidate, relay_wall=own, camera=self._place.camera)

    def as_bright(self, amplitude: Floats | None = None) -> Comparison:
        """With walls as bright as an amplitude (P,) of the direct light shows, or that of the measurement."""
        shown = self.observed.amplitude if amplitude is None else amplitude
        found = WallBrightness.of(self._place, self.observed.rays, shown, self.light)
        return replace(self, brightness=found)

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
        return moved.as_bright(self.observed.amplitude / np.abs(1 + hidden[:, 0])), candidate

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
        for (comparison, _), (hidden, _) in zip(asked, _hidden(asked) if asked else [], strict=True)
    ]


def _hidden(asked: Asked) -> list[tuple[NDArray[np.complex128], float]]:
    """(P, F) hidden over direct light of each candidate, and the reflectance by which it is in proportion."""
    first = asked[0][0]
    placed = [comparison.placed(candidate) for comparison, candidate in asked]
    found = []
    whites = _light(first, placed)
    for (comparison, _), white in zip(asked, whites, strict=True):
        if comparison.lacking is not None:
            white = white + comparison.lacking
        reflectance = comparison.reflectance
        if reflectance is None:
            reflectance = _likeliest_reflectance(comparison.observed, white)
        found.append((reflectance * white, reflectance))
    return found


def _likeliest_reflectance(observed: HiddenLight, white: NDArray[np.complex128]) -> float:
    """The reflectance of objects with which the light (P, F) of white ones explains most."""
    reflectance = 1.0
    for _ in range(_ROUNDS):
        light = observed.of_model(reflectance * white)
        power = max(float(light @ light), float(np.finfo(float).tiny))
        reflectance = float(np.clip(reflectance * (light @ observed.values) / power, *_REFLECTANCE))
    return reflectance


def _light(comparison: Comparison, placed: Sequence[Scene]) -> NDArray[np.complex128]:
    """(N, P, F) hidden over direct light of candidates: in the middles of blocks, or as means of parts."""
    observed, is_exact = comparison.observed, comparison.fine and comparison.lacking is None
    rays = observed.parts.reshape(-1, 3) if is_exact else observed.rays
    light = comparison.light.over_direct(placed, rays, fine=comparison.fine)
    if not is_exact:
        return light
    parts = light.reshape(len(placed), *observed.parts.shape[:2], -1)
    return np.stack([observed.blocks.middles_of_parts(each, observed.where) for each in parts])


def corrected(asked: Asked, *, fine: bool = False) -> Asked:
    """The comparisons with what their light in the middles of blocks lacks at their own candidates.

    Near these, few nodes then are as right as many, at a hundredth of the price. But their light is not
    smooth, and fits in long valleys end on their way: with `fine`, it is that of many.
    """
    first = asked[0][0]
    placed = [comparison.placed(candidate) for comparison, candidate in asked]
    exact = _light(replace(first, fine=True, lacking=None), placed)
    near = first.light.over_direct(placed, first.observed.rays, fine=fine)
    return [
        (replace(comparison, fine=fine, lacking=lacking), candidate)
        for (comparison, candidate), lacking in zip(asked, exact - near, strict=True)
    ]


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


_Slopes = tuple[Sequence[Unknown], Floats]  # unknowns, and (M, U) derivatives of the values by them
_NO_SLOPES: Final[_Slopes] = ((), np.zeros((0, 0)))


@dataclass
class _Going:
    """A fit on its way.

    Attributes
    ----------
    reused : steps with slopes that are only corrected along the last one (Broyden 1965).
    age : such steps so far; None where slopes have to be computed.
    """

    comparison: Comparison
    candidate: Scene
    misfit: Floats
    reused: int
    damping: float = _DAMPING
    has_ended: bool = False
    slopes: _Slopes = _NO_SLOPES
    age: int | None = None

    @property
    def with_few_nodes(self) -> _Going:
        """The fit with cheap derivatives: those of few nodes, which will not do in long valleys."""
        return replace(self, comparison=replace(self.comparison, fine=False))

    def change(self, trial: int) -> Floats:
        """(U,) the step with a damping that grows with each trial."""
        numbers, jacobian = self.slopes
        normal, slope = jacobian.T @ jacobian, jacobian.T @ self.misfit
        least = _RIDGE * np.trace(normal) + np.finfo(float).tiny
        damping = self.damping * _MORE**trial * np.diag(normal) + least
        return within_reach(self.candidate, numbers, np.linalg.solve(normal + np.diag(damping), -slope))

    def takes(self, change: Floats, candidate: Scene, misfit: Floats, trial: int) -> bool:
        """Go to a candidate if its misfit is smaller; whether it was."""
        before, after = self.misfit @ self.misfit, misfit @ misfit
        if not after < before:
            return False
        numbers, jacobian = self.slopes
        wrong = misfit - self.misfit - jacobian @ change
        self.slopes = numbers, jacobian + np.outer(wrong, change / (change @ change))
        self.candidate, self.misfit = candidate, misfit
        self.damping = max(self.damping * _MORE**trial * _LESS, _LEAST_DAMPING)
        self._grows_old(is_enough=bool(before - after < _ENOUGH * before))
        return True

    def _grows_old(self, is_enough: bool) -> None:
        """A fit ends only with slopes of its own."""
        self.has_ended = is_enough and self.age == 0
        self.age = None if is_enough or self.age == self.reused else (self.age or 0) + 1

    def stays(self) -> None:
        """No damping led to a smaller misfit."""
        self.has_ended, self.age = self.age == 0, None


def least_misfits(
    starts: Asked,
    *,
    steps: int,
    fitted: Fitted = _POSES,
    one_sided: bool = False,
) -> list[Fit]:
    """The nearest minimum of the misfit of each start, after at most so many steps.

    Parameters
    ----------
    starts : comparisons with the same rays and one engine.
    fitted : what is unknown besides poses.
    one_sided : differences of half the price, for the first steps; of comparisons that are not `fine`.
    """
    if not starts:
        return []
    # Long valleys need all slopes where light is not smooth; without sizes, slopes of few nodes cost nothing.
    reused = _REUSED if fitted.sizes == starts[0][0].fine else 0
    fits = [_Going(*start, misfit, reused) for start, misfit in zip(starts, misfits(starts), strict=True)]
    for _ in range(steps):
        going = [fit for fit in fits if not fit.has_ended]
        if going:
            _step(going, fitted, one_sided)
    return [
        Fit(
            *(fit.comparison, fit.candidate),
            *(fit.comparison.relative(fit.misfit), fit.comparison.unexplained(fit.misfit)),
        )
        for fit in fits
    ]


def _step(fits: Sequence[_Going], fitted: Fitted, one_sided: bool) -> None:
    """One step of each fit: it takes the smallest of a few dampings that lowers its misfit."""
    old = [fit for fit in fits if fit.age is None]
    few = old if fitted.sizes else [fit.with_few_nodes for fit in old]
    for fit, slopes in zip(old, (_forward if one_sided else jacobians)(few, fitted), strict=True):
        fit.slopes, fit.age = slopes, 0
    left = list(fits)
    for trial in range(_TRIALS):
        changes = [fit.change(trial) for fit in left]
        asked = [
            (fit.comparison, changed(fit.candidate, fit.slopes[0], change))
            for fit, change in zip(left, changes, strict=True)
        ]
        tried = misfits(asked)
        left = [
            fit
            for fit, change, (_, candidate), misfit in zip(left, changes, asked, tried, strict=True)
            if not fit.takes(change, candidate, misfit, trial)
        ]
    for fit in left:
        fit.stays()


def jacobians(fits: Sequence[Fit | _Going], fitted: Fitted) -> list[_Slopes]:
    """The unknowns of each fit, and (M, U) the derivatives of its values by them: central differences."""
    return [(own, derivatives(own, sides)) for own, sides in beside(fits, fitted)]


def derivatives(numbers: Sequence[Unknown], sides: Floats) -> Floats:
    """(M, U) derivatives of values by unknowns, from those on both sides (`beside`)."""
    widths = np.array([np.ptp(each.steps) for each in numbers])
    found: Floats = (sides[:, 0] - sides[:, 1]).T / widths
    return found


def beside(fits: Sequence[Fit | _Going], fitted: Fitted) -> list[tuple[Sequence[Unknown], Floats]]:
    """The unknowns of each fit, and (U, 2, M) its misfits with one of them changed by either of its steps."""
    numbers = [unknowns(fit.candidate, fitted, fit.comparison.fine) for fit in fits]
    moved = [
        (fit.comparison, changed(fit.candidate, [each], np.array([step])))
        for fit, own in zip(fits, numbers, strict=True)
        for each in own
        for step in each.steps
    ]
    found = iter(misfits(moved))
    return [(own, np.array([[next(found), next(found)] for _ in own])) for own in numbers]


def _forward(fits: Sequence[_Going], fitted: Fitted) -> list[_Slopes]:
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
