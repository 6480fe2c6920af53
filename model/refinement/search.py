"""The search for the solids whose light is that of a measurement: many starts, and fits of ever fewer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from model.refinement.evidence import Prior
from model.refinement.family import Family
from model.refinement.least_squares import Asked, Comparison, Fit, corrected, least_misfits
from model.refinement.light.corner_light import vector
from model.refinement.pairs import Pairs
from model.refinement.sketch import Draws, Sketch
from model.refinement.unknowns import Fitted, moved
from scenegen.pose import wall_normal
from scenegen.scene import HiddenObject, RelayWall, Scene
from scenegen.shapes import Shape

_SAME_M: Final = 0.001  # two fits whose mirror images differ by less are one
_CERTAIN: Final = 0.003  # a fit that leaves less unexplained ends the search
_LIKELY: Final = 2.5  # so does one with less evidence against it
_HOPELESS: Final = 40.0  # more evidence against a fit than against the best: it needs no finer grid
_ROUGHNESS: Final = (0.25, 0.4, 0.55, 0.75, 0.95)  # of the relay wall, to start with
_FINE_STEPS, _WALLS = 6, 2
_LONG_STEPS: Final = 12  # of fits of unknown sizes that go on
_RESIZED: Final = (0.85, 0.92, 1.09, 1.18)  # other sizes of the best one, as its valley may be longer
_LIBRARY: Final = 400  # solids of each shape of which pairs are made
_AROUND: Final = 0.7  # how far each is from the middle, over the largest distance of two, at most
# Pairs of which one solid is exchanged, for how many others, and how often: each time for other solids.
_EXCHANGED, _OTHERS, _EXCHANGES = 6, 6, 3


@dataclass(frozen=True)
class _Singles:
    """How many single solids of each shape are drawn, compared with the light, and fitted."""

    drawn: int
    lit: int
    fitted: int


@dataclass(frozen=True)
class _Funnel:
    """How many of some fits take how many steps, one after the other; and how many move on finer grids.

    With unknown sizes, the best of the last go on.
    """

    steps: tuple[tuple[int, int], ...]
    polished: int
    going_on: int


_FIRST, _MORE = _Singles(300, 10, 4), _Singles(900, 120, 12)
_OF_FIRST, _OF_MORE = _Funnel(((24, 3), (8, 10)), 3, 2), _Funnel(((72, 4), (24, 6), (12, 10)), 6, 6)
_OF_PAIRS: Final = _Funnel(((60, 3), (24, 4), (8, 8)), 3, 2)
_LIT_PAIRS, _LIT_LIKELY = 30, 150  # of each two shapes, and then of the likely ones
_LIKELY_SHAPES: Final = 2  # pairs of shapes
_Begin = Callable[[list[Fit]], list[Fit]]


@dataclass(frozen=True)
class Search:
    """The search for the solids of one measurement.

    Attributes
    ----------
    coarse, fine : comparisons with its light, to begin and to end with.
    sketch : depth map of the network.
    prior : of the network.
    """

    coarse: Comparison
    fine: Comparison
    sketch: Sketch
    prior: Prior
    family: Family

    @property
    def fitted(self) -> Fitted:
        """What is unknown at last."""
        return Fitted(True, self.family.fits_sizes, room=not self.fine.knows_camera)

    def fits(self, rng: np.random.Generator) -> list[Fit]:
        """The best fits, the best first, each with the wall where it is behind its solids."""
        best: list[Fit] = []
        for begin, funnel in self._rounds(rng):
            found = self._sorted([*best, *self._funnelled(begin(best), funnel)])
            best = self._different(found, len(found))
            if best and self._is_certain(best[0]):
                break
        return best

    def _rounds(self, rng: np.random.Generator) -> Iterator[tuple[_Begin, _Funnel]]:
        """How each round begins with the best fits of those before, while these are not certain."""
        walls = self._walls()
        yield lambda _: self._singles(_FIRST, walls, rng), _OF_FIRST
        yield lambda _: self._singles(_MORE, walls, rng), _OF_MORE
        if self.family.apart_m is not None and len(self.family.sizes) > 1:
            pairs = self._pairs(self.family.apart_m, walls, rng)
            yield lambda _: self._lit(pairs.starts(_LIT_PAIRS)), _OF_PAIRS
            yield lambda best: self._lit(pairs.starts(_LIT_LIKELY, _likely_shapes(best))), _OF_PAIRS
            for _ in range(_EXCHANGES):
                others = self._pairs(self.family.apart_m, walls, rng)
                yield partial(self._exchanged, others), _OF_PAIRS

    def _is_certain(self, fit: Fit) -> bool:
        """Whether a fit is so good that others need not be tried."""
        return fit.unexplained <= _CERTAIN or self.prior.against([fit])[0] <= _LIKELY

    def _walls(self) -> list[RelayWall]:
        """The relay wall as it may be: with each roughness."""
        wall = self.sketch.corner.relay_wall
        rough = [None] if wall.roughness is None else _ROUGHNESS
        return [replace(wall, roughness=each) for each in rough]

    def _singles(self, effort: _Singles, walls: Sequence[RelayWall], rng: np.random.Generator) -> list[Fit]:
        """Starts of single solids, each with the wall that explains most."""
        counts, fits_sizes = (effort.drawn, effort.lit), self.family.fits_sizes
        found = []
        for shape, size_m in self.family.sizes.items():
            starts = self.sketch.starts(shape, size_m, counts, rng, fits_sizes=fits_sizes)
            fits = self._lit([replace(start, relay_wall=each) for start in starts for each in walls])
            best: dict[tuple[HiddenObject, ...], Fit] = {}
            for fit in fits:
                best.setdefault(fit.candidate.hidden_objects, fit)
            found += list(best.values())[: effort.fitted]
        return found

    def _pairs(self, apart_m: float, walls: Sequence[RelayWall], rng: np.random.Generator) -> Pairs:
        """Solids of all shapes, of which pairs can be made."""
        sketch, fits_sizes = self.sketch, self.family.fits_sizes
        draws = [
            Draws.of(shape, size_m, sketch.inner_m, _LIBRARY, rng, fits_sizes=fits_sizes)
            for shape, size_m in self.family.sizes.items()
        ]
        moved = [each.moved(_AROUND * apart_m * rng.uniform(-1, 1, each.centres_m.shape)) for each in draws]
        return Pairs.of(sketch, self.coarse, moved, apart_m, walls)

    def _exchanged(self, others: Pairs, best: Sequence[Fit]) -> list[Fit]:
        """The best pairs, each with another solid in place of one of its own."""
        return self._lit(others.exchanged(_two_solids(best)[:_EXCHANGED], _OTHERS))

    def _lit(self, starts: Sequence[Scene]) -> list[Fit]:
        """Starts with their light; those that explain most come first."""
        fits = least_misfits([(self.coarse, start) for start in starts], steps=0)
        return sorted(fits, key=lambda fit: fit.misfit)

    def _funnelled(self, fits: Sequence[Fit], funnel: _Funnel) -> list[Fit]:
        """The minima near the best of some fits."""
        fitted = Fitted(roughness=True, sizes=self.family.fits_sizes)
        for place, (count, steps) in enumerate(funnel.steps):
            fits = self._different(fits, count)
            are_pairs = any(len(fit.candidate.hidden_objects) > 1 for fit in fits)
            starts = corrected(_starts(fits)) if place and fits else _starts(fits)
            fits = least_misfits(starts, steps=steps, fitted=fitted, one_sided=are_pairs and place == 0)
            fits = self._sorted(fits) if are_pairs else _best_of_each_shape_first(self._sorted(fits))
        return self._polished(fits[: funnel.polished], funnel.going_on)

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

    def _polished(self, fits: Sequence[Fit], going_on: int) -> list[Fit]:
        """Minima of the fine comparison; with unknown sizes, some go on: their valleys are long."""
        if not self.family.fits_sizes:
            against = self.prior.against(fits)
            likely = [
                fit
                for fit, each in zip(fits, against, strict=True)
                if each < against.min(initial=np.inf) + _HOPELESS
            ]
            return self._finer(likely, _FINE_STEPS)
        found = self._sorted(self._finer(fits, _FINE_STEPS))
        found = self._sorted([*self._finer(found[:going_on], _LONG_STEPS), *found[going_on:]])
        resized = [_resized(each, by) for each in found[:1] for by in _RESIZED]
        # Only the best of these is a candidate: all lie in one valley.
        return [*self._sorted([*found[:1], *self._finer(resized, _FINE_STEPS)])[:1], *found[1:]]

    def _finer(self, fits: Sequence[Fit], steps: int) -> list[Fit]:
        """Fits with many nodes, and with the wall found again behind each solid."""
        starts: Asked = [(self.fine, fit.candidate) for fit in fits]
        for _ in range(_WALLS if fits else 0):
            starts = [each.behind(candidate) for each, candidate in starts]
            found = least_misfits(corrected(starts, fine=True), steps=steps, fitted=self.fitted)
            starts = [(each, fit.candidate) for (each, _), fit in zip(starts, found, strict=True)]
        return least_misfits(starts, steps=0)

    def _sorted(self, fits: Sequence[Fit]) -> list[Fit]:
        """By the evidence against them."""
        return [fits[place] for place in np.argsort(self.prior.against(fits), kind="stable").tolist()]


def _likely_shapes(best: Sequence[Fit]) -> list[frozenset[Shape]]:
    """The shapes of the best pairs."""
    shapes = [frozenset(part.shape for part in each.hidden_objects) for each in _two_solids(best)]
    return list(dict.fromkeys(shapes))[:_LIKELY_SHAPES]


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


def _resized(fit: Fit, factor: float) -> Fit:
    """With other sizes of its solids, whose surfaces stay as far from the relay wall."""
    normal = wall_normal(fit.candidate.relay_wall)
    solids = tuple(
        moved(
            replace(part, size_m=vector(factor * np.asarray(part.size_m))),
            (factor - 1) / 2 * float(np.mean(part.size_m)) * normal,
        )
        for part in fit.candidate.hidden_objects
    )
    return replace(fit, candidate=replace(fit.candidate, hidden_objects=solids))


def _two_solids(fits: Sequence[Fit]) -> list[Scene]:
    """The candidates of the fits of two solids."""
    return [fit.candidate for fit in fits if len(fit.candidate.hidden_objects) > 1]
