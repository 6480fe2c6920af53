"""Refines a network's depth map: finds the solid that explains the measured hidden light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from itof.wall.expected_wall import ExpectedWall
from model.device import one_thread
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, Fit, Guess, fitted
from model.refinement.light.room import Room
from model.refinement.light.solids import Solid
from model.refinement.light.three_bounces import Bounces
from model.refinement.search import Sketch, starts
from model.refinement.settings import LARGEST_DIFFERENCE, LARGEST_MISFIT

_USUAL_MISFIT = 0.006  # of the right solid; its square weighs as much against a fit as that of `_USUAL_M`
_USUAL_M = 0.02  # difference of a network's depth map
_SAME_M = 0.004  # two fits whose mirror images differ by less are one
_CERTAIN = 0.006  # a fit that leaves less unexplained ends the search
_PROMISING = 0.012  # a few steps on coarse grids that leave less are followed at once, if noise allows
_ROUGHNESS = (0.25, 0.4, 0.55, 0.75, 0.95)  # of the relay wall, to start with
_FEW_STEPS, _MANY_STEPS, _FINE_STEPS, _WALLS = 3, 10, 4, 2


@dataclass(frozen=True)
class _Effort:
    """How far a search goes.

    Attributes
    ----------
    drawn : rotations of each shape that are compared with the depth map.
    lit : of these, how many are compared with the hidden light.
    stepped : of these, how many move a few steps.
    finished : of all shapes, how many move to their minimum.
    polished : of these, how many move on finer grids.
    """

    drawn: int
    lit: int
    stepped: int
    finished: int
    polished: int


_ROUNDS = (_Effort(300, 10, 4, 6, 2), _Effort(600, 16, 6, 10, 3))  # the second if the first finds too little


@dataclass(frozen=True)
class Family:
    """What the hidden object may be.

    Attributes
    ----------
    sizes : extents of each shape that may be there, metres; to start with, if `fits_sizes`.
    fits_sizes : whether the extents are unknowns.
    reflectance : of the object; None: it is not known.
    """

    sizes: Mapping[str, tuple[float, float, float]]
    fits_sizes: bool = False
    reflectance: float | None = 1.0


@dataclass(frozen=True)
class Refined:
    """The solid that explains a measurement best.

    Attributes
    ----------
    solid : in camera axes.
    reflectance : of the solid.
    roughness : of the relay wall; None if it is Lambertian.
    misfit : part of the hidden light that is not explained (root mean squares), without noise.
    noise : of the measurement, as part of its hidden light (root mean squares).
    depth_map : mirror image of the solid.
    """

    solid: Solid
    reflectance: float
    roughness: float | None
    misfit: float
    noise: float
    depth_map: DepthMap

    def is_right(
        self,
        prediction: DepthMap,
        expected_m: float | None,
        *,
        largest_misfit: float = LARGEST_MISFIT,
        largest_difference: float = LARGEST_DIFFERENCE,
    ) -> bool:
        """Whether the solid may be believed.

        It must explain the light. Where noise, or what is not explained, is more than 1 % of the light (or
        than `largest_misfit`, if that is less), other solids explain it as well; then the solid must also be
        near the network's depth map.

        Parameters
        ----------
        prediction, expected_m : depth map of the network, and the MAE that it expects of it, metres; None if
            the network expects none, and then the light decides alone.
        largest_misfit : share of the hidden light that may stay unexplained.
        largest_difference : of both depth maps, mean over all pixels, over `expected_m`.
        """
        if self.misfit > largest_misfit:
            return False
        if max(self.noise, self.misfit) <= min(largest_misfit, LARGEST_MISFIT) or expected_m is None:
            return True
        return self.difference_m(prediction) <= largest_difference * expected_m

    def difference_m(self, prediction: DepthMap) -> float:
        """Mean absolute difference to another depth map over all pixels; background counts as 0."""
        return float(np.abs(self.depth_map.radial_depth_m - prediction.radial_depth_m).mean())


def refined(
    phasor: NDArray[np.complexfloating[Any, Any]],
    prediction: DepthMap,
    wall: ExpectedWall,
    room: Room,
    family: Family,
    *,
    seed: int = 0,
) -> Refined | None:
    """The solid of a family whose hidden light is that of a measurement, near the depth map of a network.

    Parameters
    ----------
    phasor : (H, W, F) complex at the frequencies of `wall`.
    prediction : the network's depth map (H, W).
    wall : where the relay wall is expected; it may be off as far as for ``reference = "self"``.
    room : the corner; its relay wall is moved to where the measurement shows it.
    seed : of the rotations that are tried.

    Returns
    -------
    None where the prediction shows no object, or too little of the relay wall is seen.
    """
    reflectance = family.reflectance
    fine, coarse = (_comparison(phasor, wall, room, reflectance, fine=fine) for fine in (True, False))
    if fine is None or coarse is None:
        return None
    sketch = Sketch.of(fine.bounces.room, wall.rays, prediction)
    if sketch.is_empty:
        return None
    with one_thread():
        found = _Search(coarse, fine, sketch, family).best(np.random.default_rng(seed))
    if found is None:
        return None
    best, comparison = found
    depth_m = comparison.bounces.room.mirrored_depth_m(best.guess.solids, wall.rays)
    depth_map = DepthMap.of_object(depth_m, depth_m > 0, prediction.frequency_hz)
    explaining = comparison.reflectance_of(best.guess)
    return Refined(
        best.guess.solids[0], explaining, best.guess.roughness, best.unexplained, comparison.noise, depth_map
    )


def _comparison(
    phasor: NDArray[np.complexfloating[Any, Any]],
    wall: ExpectedWall,
    room: Room,
    reflectance: float | None,
    *,
    fine: bool,
) -> Comparison | None:
    observed = HiddenLight.of(phasor, wall, fine=fine)
    if observed is None:
        return None
    found, aspect = room.with_plane(observed.plane_per_m), phasor.shape[1] / phasor.shape[0]
    bounces = Bounces(found, observed.rays, aspect, wall.frequencies_hz, fine=fine)
    return Comparison(observed, bounces, reflectance)


@dataclass(frozen=True)
class _Search:
    """One measurement with coarse and fine comparisons."""

    coarse: Comparison
    fine: Comparison
    sketch: Sketch
    family: Family

    def best(self, rng: np.random.Generator) -> tuple[Fit, Comparison] | None:
        """The best fit, and the comparison with the wall where it is behind this solid; None without any."""
        best: tuple[Fit, Comparison] | None = None
        for effort in _ROUNDS:
            found = self._round(effort, rng)
            if found is not None and (best is None or self._cost(found[0]) < self._cost(best[0])):
                best = found
            if found is not None and found[0].unexplained <= _CERTAIN:
                break
        return best

    def _round(self, effort: _Effort, rng: np.random.Generator) -> tuple[Fit, Comparison] | None:
        """The best fit of a search; shapes whose mirror images are most like the depth map come first."""
        sizes = self.family.sizes.items()
        drawn = [starts(self.sketch, shape, size_m, effort.drawn, rng) for shape, size_m in sizes]
        drawn = [solids[: effort.lit] for solids in drawn if solids]
        drawn.sort(key=lambda solids: self.sketch.difference_m(solids[:1]))
        stepped: list[Fit] = []
        for solids in drawn:
            stepped += self._stepped([self._lit(solid) for solid in solids], effort.stepped)
            nearest = min(stepped, key=self._cost)
            if nearest.unexplained <= _PROMISING and self.fine.noise <= _CERTAIN:
                found = self._polished(self._finished(nearest))
                if found[0].unexplained <= _CERTAIN:
                    return found
        finished: list[Fit] = []
        for start in sorted(stepped, key=self._cost)[: effort.finished]:
            if not any(self._same(start, other) for other in finished):
                finished.append(self._finished(start))
        polished = [self._polished(fit) for fit in sorted(finished, key=self._cost)[: effort.polished]]
        return min(polished, key=lambda found: self._cost(found[0]), default=None)

    def _finished(self, start: Fit) -> Fit:
        return fitted(self.coarse, start.guess, steps=_MANY_STEPS, roughness=True)

    def _lit(self, solid: Solid) -> Fit:
        """With the roughness of the wall that explains most."""
        choices = _ROUGHNESS if self.coarse.bounces.room.is_rough else (None,)
        guesses = [Guess((solid,), roughness) for roughness in choices]
        fits = [fitted(self.coarse, guess, steps=0) for guess in guesses]
        return min(fits, key=lambda fit: fit.misfit)

    def _stepped(self, lit: Sequence[Fit], count: int) -> list[Fit]:
        """The best of some guesses, none like another, after a few steps."""
        chosen: list[Fit] = []
        for fit in sorted(lit, key=lambda fit: fit.misfit):
            if len(chosen) < count and not any(self._same(fit, other) for other in chosen):
                chosen.append(fit)
        return [fitted(self.coarse, fit.guess, steps=_FEW_STEPS, roughness=True) for fit in chosen]

    def _polished(self, fit: Fit) -> tuple[Fit, Comparison]:
        """Minimum of the fine comparison, with the wall found again behind the solid."""
        comparison = self.fine
        for _ in range(_WALLS):
            comparison = comparison.with_wall_behind(fit.guess)
            sizes = self.family.fits_sizes
            fit = fitted(comparison, fit.guess, steps=_FINE_STEPS, roughness=True, sizes=sizes)
        return fit, comparison

    def _same(self, one: Fit, two: Fit) -> bool:
        depths = [self.sketch.room.mirrored_depth_m(fit.guess.solids, self.sketch.rays) for fit in (one, two)]
        return float(np.abs(depths[0] - depths[1]).mean()) < _SAME_M

    def _cost(self, fit: Fit) -> float:
        """Squares of the misfit and of the difference to the network's depth map, in units of their own.

        Noise adds the same to the misfit of every fit.
        """
        difference_m = self.sketch.difference_m(fit.guess.solids)
        return (fit.misfit / _USUAL_MISFIT) ** 2 + (difference_m / _USUAL_M) ** 2
