"""Refines a network's depth map: finds the solid that explains the measured hidden light."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from disk.quantities import Extent
from itof import DepthMap
from itof.wall.expected_wall import ExpectedWall
from model.refinement.evidence import Prior, Spread, against_nothing
from model.refinement.hidden_light import HiddenLight
from model.refinement.least_squares import Asked, Comparison, Fit, least_misfits
from model.refinement.light.corner_light import CornerLight
from model.refinement.search import Sketch
from model.refinement.settings import LARGEST_MISFIT
from model.refinement.unknowns import Fitted
from model.refinement.wall_brightness import walls_as_bright
from scenegen.scene import HiddenObject, RelayWall, Scene
from scenegen.shapes import Shape

_SAME_M = 0.001  # two fits whose mirror images differ by less are one
_CERTAIN = 0.004  # a fit that leaves less unexplained ends the search
_LIKELY = 2.5  # so does one with less evidence against it
_MORE_THAN_NOTHING = 50.0  # evidence that a fit needs, for its dozen unknowns and many starts
_ROUGHNESS = (0.25, 0.4, 0.55, 0.75, 0.95)  # of the relay wall, to start with
_MANY_STEPS, _FINE_STEPS, _WALLS = 10, 4, 2


@dataclass(frozen=True)
class _Effort:
    """How far a search goes.

    Attributes
    ----------
    drawn : rotations of each shape that are compared with the depth map.
    lit : of these, how many are compared with the hidden light.
    stepped : of these, how many move `few` steps.
    finished : of all shapes, but at least one of each, how many move to their minimum.
    polished : of these, how many move on finer grids.
    """

    drawn: int
    lit: int
    stepped: int
    few: int
    finished: int
    polished: int


# The next one if the last finds too little.
_ROUNDS = (_Effort(300, 10, 4, 3, 8, 3), _Effort(900, 24, 8, 6, 16, 6))


@dataclass(frozen=True)
class Family:
    """What the hidden object may be.

    Attributes
    ----------
    sizes : extents of each shape that may be there, metres; to start with, if `fits_sizes`.
    fits_sizes : whether the extents are unknowns.
    reflectance : of the object; None: it is not known.
    """

    sizes: Mapping[Shape, Extent]
    fits_sizes: bool = False
    reflectance: float | None = 1.0


@dataclass(frozen=True)
class Refined:
    """The solid that explains a measurement best.

    Attributes
    ----------
    fit : the solid in its corner, with the light that was compared.
    reflectance : of the solid.
    spread : how wrong it may be.
    depth_map : mirror image of the solid.
    """

    fit: Fit
    reflectance: float
    spread: Spread
    depth_map: DepthMap

    @property
    def solid(self) -> HiddenObject:
        """In world axes; its own reflectance is 1."""
        return self.fit.candidate.hidden_objects[0]

    @property
    def roughness(self) -> float | None:
        """Of the relay wall; None if it is Lambertian."""
        return self.fit.candidate.relay_wall.roughness

    @property
    def misfit(self) -> float:
        """Part of the hidden light that is not explained (root mean squares), without noise."""
        return self.fit.unexplained

    @property
    def noise(self) -> float:
        """Of the measurement, as part of its hidden light (root mean squares)."""
        return self.fit.comparison.noise

    def is_right(self, expected_m: float | None, *, largest_misfit: float = LARGEST_MISFIT) -> bool:
        """Whether the solid may be believed.

        It must explain the light, and more of it than chance explains of noise. Its mirror image must be
        better than the depth map of the network, as far as both can tell.

        Parameters
        ----------
        expected_m : MAE that the network expects of its depth map, metres; None if it expects none.
        largest_misfit : share of the hidden light that a solid of known extents and reflectance may leave
            unexplained; one with more unknowns must leave less (`Spread.freedom`).
        """
        limit = largest_misfit * self.spread.freedom
        explains = self.misfit <= limit and against_nothing(self.fit) > _MORE_THAN_NOTHING
        return explains and (expected_m is None or self.spread.expected_mae_m < expected_m)

    def difference_m(self, prediction: DepthMap) -> float:
        """Mean absolute difference to another depth map over all pixels; background counts as 0."""
        return float(np.abs(self.depth_map.radial_depth_m - prediction.radial_depth_m).mean())


def refined(
    phasor: NDArray[np.complexfloating[Any, Any]],
    prediction: DepthMap,
    expected_m: float | None,
    wall: ExpectedWall,
    corner: Scene,
    light: CornerLight,
    family: Family,
    *,
    knows_camera: bool = True,
    seed: int = 0,
) -> Refined | None:
    """The solid of a family whose hidden light is that of a measurement, near the depth map of a network.

    Parameters
    ----------
    phasor : (H, W, F) complex at the frequencies of `wall`.
    prediction, expected_m : the network's depth map (H, W), and the MAE that it expects, metres, or None.
    wall : where the relay wall is expected; it may be off as far as for ``reference = "self"``.
    corner : its hidden objects do not matter.
    knows_camera : whether the camera of the corner is exactly where it was. Otherwise the measurement shows
        how far and how turned it is from the relay wall.
    light : of the corner, at the frequencies of `wall`.
    seed : of the rotations that are tried.

    Returns
    -------
    None where the prediction shows no object, or too little of the relay wall is seen.
    """
    fine, coarse = (HiddenLight.of(phasor, wall, fine=fine) for fine in (True, False))
    if fine is None or coarse is None:
        return None
    close, wide = (
        Comparison(observed, corner, light, is_fine, family.reflectance, knows_camera)
        for observed, is_fine in ((fine, True), (coarse, False))
    )
    shown = (light, close.placed(corner), fine.plane_per_m, wall.rays, prediction)
    sketch = Sketch.of(*shown)
    if sketch.is_empty:
        return None
    search = _Search(wide, close, Prior.of(sketch, expected_m), family)
    fits = search.fits(np.random.default_rng(seed))
    if not fits:
        return None
    comparison, candidate = fits[0].comparison, fits[0].candidate
    height, width = wall.rays.shape[:2]
    rays = wall.rays.reshape(-1, 3)
    depth_m = light.mirrored_depth_m([comparison.placed(candidate)], rays).reshape(height, width)
    depth_map = DepthMap.of_object(depth_m, depth_m > 0, prediction.frequency_hz)
    every = Sketch.of(*shown, columns=width)
    spread = Spread.of_fits(fits, search.prior, every, search.fitted, seed)
    return Refined(fits[0], comparison.reflectance_of(candidate), spread, depth_map)


@dataclass(frozen=True)
class _Search:
    """One measurement with coarse and fine comparisons."""

    coarse: Comparison
    fine: Comparison
    prior: Prior
    family: Family

    @property
    def fitted(self) -> Fitted:
        """What is unknown at last."""
        return Fitted(True, self.family.fits_sizes, room=not self.fine.knows_camera)

    def fits(self, rng: np.random.Generator) -> list[Fit]:
        """The best fits, the best first, each with the wall where it is behind its solid."""
        best, walls = [], self._walls()  # type: list[Fit], list[RelayWall]
        for effort in _ROUNDS:
            found = self._sorted([*best, *self._round(effort, walls, rng)])
            best = self._different(found, len(found))
            if best and (best[0].unexplained <= _CERTAIN or self.prior.against(best[:1])[0] <= _LIKELY):
                break
        return best

    def _walls(self) -> list[RelayWall]:
        """The relay wall as it may be: with each roughness, and as bright as the amplitudes show."""
        corner, observed = self.prior.sketch.corner, self.coarse.observed
        wall = corner.relay_wall
        rough = [None] if wall.roughness is None else _ROUGHNESS
        corners = [replace(corner, relay_wall=replace(wall, roughness=each)) for each in rough]
        return walls_as_bright(corners, observed.rays, observed.amplitude, self.coarse.light)

    def _round(self, effort: _Effort, walls: Sequence[RelayWall], rng: np.random.Generator) -> list[Fit]:
        """The fits of a search that begins with one of some walls."""
        fitted = Fitted(roughness=True, sizes=self.family.fits_sizes)
        stepped = [fit for lit in self._lit(effort, walls, rng) for fit in lit[: effort.stepped]]
        few = least_misfits(_starts(stepped), steps=effort.few, fitted=fitted)
        chosen = self._different(_best_of_each_shape_first(self._sorted(few)), effort.finished)
        many = least_misfits(_starts(chosen), steps=_MANY_STEPS, fitted=fitted)
        return self._polished(self._sorted(many)[: effort.polished])

    def _lit(
        self, effort: _Effort, walls: Sequence[RelayWall], rng: np.random.Generator
    ) -> Iterator[list[Fit]]:
        """Starts of each shape with the wall that explains most; the best come first."""
        sketch = self.prior.sketch
        counts, fits_sizes = (effort.drawn, effort.lit), self.family.fits_sizes
        for shape, size_m in self.family.sizes.items():
            found = sketch.starts(shape, size_m, counts, rng, fits_sizes=fits_sizes)
            starts = [(self.coarse, replace(start, relay_wall=each)) for start in found for each in walls]
            fits = least_misfits(starts, steps=0)
            best = [
                min(fits[place : place + len(walls)], key=lambda fit: fit.misfit)
                for place in range(0, len(fits), len(walls))
            ]
            yield sorted(best, key=lambda fit: fit.misfit)

    def _different(self, fits: Sequence[Fit], count: int) -> list[Fit]:
        """The first fits of which none is like another one."""
        sketch = self.prior.sketch
        depths_m = sketch.depths_m([fit.candidate for fit in fits]) if fits else np.zeros((0, 0))
        chosen: list[int] = []
        for place, depth_m in enumerate(depths_m):
            apart_m = [np.abs(depth_m - depths_m[other]).mean() for other in chosen]
            if len(chosen) < count and all(each >= _SAME_M for each in apart_m):
                chosen.append(place)
        return [fits[place] for place in chosen]

    def _polished(self, fits: Sequence[Fit]) -> list[Fit]:
        """Minima of the fine comparison, with the wall found again behind each solid."""
        starts: Asked = [(self.fine, fit.candidate) for fit in fits]
        found: list[Fit] = []
        for _ in range(_WALLS):
            starts = [each.behind(candidate) for each, candidate in starts]
            found = least_misfits(starts, steps=_FINE_STEPS, fitted=self.fitted)
            starts = _starts(found)
        return found

    def _sorted(self, fits: Sequence[Fit]) -> list[Fit]:
        """By the evidence against them."""
        return [fits[place] for place in np.argsort(self.prior.against(fits), kind="stable").tolist()]


def _starts(fits: Sequence[Fit]) -> Asked:
    """Where fits have ended, to go on."""
    return [(fit.comparison, fit.candidate) for fit in fits]


def _best_of_each_shape_first(fits: Sequence[Fit]) -> list[Fit]:
    """Fits in their order, but the first of each shape before all others: long valleys need many steps."""
    seen: set[Shape] = set()
    later = []
    for fit in fits:
        (solid,) = fit.candidate.hidden_objects
        later.append(solid.shape in seen)
        seen.add(solid.shape)
    return [fits[place] for place in np.argsort(later, kind="stable").tolist()]
