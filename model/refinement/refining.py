"""Refines a network's depth map: finds the solid that explains the measured hidden light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap
from itof.wall.expected_wall import ExpectedWall
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Comparison, Fit, fitted
from model.refinement.light.corner_light import CornerLight
from model.refinement.search import Sketch
from model.refinement.settings import LARGEST_DIFFERENCE, LARGEST_MISFIT
from scenegen.scene import HiddenObject, Scene
from scenegen.shapes import Shape

_USUAL_MISFIT = 0.006  # of the right solid; its square weighs as much against a fit as that of `_USUAL_M`
_USUAL_M = 0.02  # difference of a network's depth map
_SAME_M = 0.004  # two fits whose mirror images differ by less are one
_CERTAIN = 0.006  # a fit that leaves less unexplained ends the search
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

    sizes: Mapping[Shape, tuple[float, float, float]]
    fits_sizes: bool = False
    reflectance: float | None = 1.0


@dataclass(frozen=True)
class Refined:
    """The solid that explains a measurement best.

    Attributes
    ----------
    solid : in world axes; its own reflectance is 1.
    reflectance : of the solid.
    roughness : of the relay wall; None if it is Lambertian.
    misfit : part of the hidden light that is not explained (root mean squares), without noise.
    noise : of the measurement, as part of its hidden light (root mean squares).
    depth_map : mirror image of the solid.
    """

    solid: HiddenObject
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
    corner: Scene,
    light: CornerLight,
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
    corner : its relay wall is moved to where the measurement shows it; its hidden objects do not matter.
    light : of the corner, at the frequencies of `wall`.
    seed : of the rotations that are tried.

    Returns
    -------
    None where the prediction shows no object, or too little of the relay wall is seen.
    """
    fine, coarse = (HiddenLight.of(phasor, wall, fine=fine) for fine in (True, False))
    if fine is None or coarse is None:
        return None
    sketch = Sketch.of(light, corner, fine.plane_per_m, wall.rays, prediction)
    if sketch.is_empty:
        return None
    search = _Search(
        Comparison(coarse, corner, light, fine=False, reflectance=family.reflectance),
        Comparison(fine, corner, light, fine=True, reflectance=family.reflectance),
        sketch,
        family,
    )
    best = search.best(np.random.default_rng(seed))
    if best is None:
        return None
    comparison, candidate = best.comparison, best.candidate
    rays = wall.rays.reshape(-1, 3)
    depth_m = light.mirrored_depth_m([comparison.placed(candidate)], rays).reshape(wall.rays.shape[:2])
    depth_map = DepthMap.of_object(depth_m, depth_m > 0, prediction.frequency_hz)
    return Refined(
        candidate.hidden_objects[0],
        comparison.reflectance_of(candidate),
        candidate.relay_wall.roughness,
        best.unexplained,
        comparison.noise,
        depth_map,
    )


@dataclass(frozen=True)
class _Search:
    """One measurement with coarse and fine comparisons."""

    coarse: Comparison
    fine: Comparison
    sketch: Sketch
    family: Family

    def best(self, rng: np.random.Generator) -> Fit | None:
        """The best fit, with the wall where it is behind this solid; None without any."""
        best: list[Fit] = []
        for effort in _ROUNDS:
            best = self._sorted([*best, *self._round(effort, rng)])[:1]
            if best and best[0].unexplained <= _CERTAIN:
                break
        return best[0] if best else None

    def _round(self, effort: _Effort, rng: np.random.Generator) -> list[Fit]:
        """The fits of a search."""
        stepped: list[tuple[Comparison, Scene]] = []
        for lit in self._lit(effort, rng):
            stepped += self._different(lit, effort.stepped)
        few = fitted(stepped, steps=_FEW_STEPS, roughness=True)
        chosen = self._different(self._sorted(few), effort.finished)
        many = fitted(chosen, steps=_MANY_STEPS, roughness=True)
        return self._polished(self._sorted(many)[: effort.polished])

    def _lit(self, effort: _Effort, rng: np.random.Generator) -> list[list[Fit]]:
        """Starts of each shape with the roughness of the wall that explains most; the best come first."""
        sizes = self.family.sizes.items()
        shapes = [self.sketch.starts(*each, effort.drawn, rng)[: effort.lit] for each in sizes]
        wall = self.sketch.corner.relay_wall
        walls = [wall]
        if wall.roughness is not None:
            walls = [replace(wall, roughness=roughness) for roughness in _ROUGHNESS]
        starts = [
            (self.coarse, replace(start, relay_wall=each))
            for found in shapes
            for start in found
            for each in walls
        ]
        fits = fitted(starts, steps=0)
        best = [
            min(fits[place : place + len(walls)], key=lambda fit: fit.misfit)
            for place in range(0, len(fits), len(walls))
        ]
        ordered = []
        for found in shapes:
            own, best = best[: len(found)], best[len(found) :]
            ordered.append(sorted(own, key=lambda fit: fit.misfit))
        return ordered

    def _different(self, fits: Sequence[Fit], count: int) -> list[tuple[Comparison, Scene]]:
        """The first fits of which none is like another one."""
        depths_m = self.sketch.depths_m([fit.candidate for fit in fits]) if fits else np.zeros((0, 0))
        chosen: list[int] = []
        for place, depth_m in enumerate(depths_m):
            apart_m = [np.abs(depth_m - depths_m[other]).mean() for other in chosen]
            if len(chosen) < count and all(each >= _SAME_M for each in apart_m):
                chosen.append(place)
        return [(fits[place].comparison, fits[place].candidate) for place in chosen]

    def _polished(self, fits: Sequence[Fit]) -> list[Fit]:
        """Minima of the fine comparison, with the wall found again behind each solid."""
        starts = [(self.fine, fit.candidate) for fit in fits]
        found: list[Fit] = []
        for _ in range(_WALLS):
            starts = [(each.with_wall_behind(candidate), candidate) for each, candidate in starts]
            found = fitted(starts, steps=_FINE_STEPS, roughness=True, sizes=self.family.fits_sizes)
            starts = [(fit.comparison, fit.candidate) for fit in found]
        return found

    def _sorted(self, fits: Sequence[Fit]) -> list[Fit]:
        """By squares of the misfit and of the difference to the network's depth map, in units of their own.

        Noise adds the same to the misfit of every fit.
        """
        if not fits:
            return []
        apart_m = self.sketch.differences_m([fit.candidate for fit in fits])
        costs = [
            (fit.misfit / _USUAL_MISFIT) ** 2 + (difference_m / _USUAL_M) ** 2
            for fit, difference_m in zip(fits, apart_m, strict=True)
        ]
        return [fits[place] for place in np.argsort(costs, kind="stable")]
