"""Where a fit of two solids may start.

Many solids of each shape are drawn about the middle of the network's depth map. A pair of them has the
nearer of both mirror images, and about the sum of both lights, each dimmed by what the other solid hides of
its mirror image. So all pairs can be compared with the depth map and the light for the price of the solids.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.refinement.least_squares import Comparison, misfits
from model.refinement.sketch import Draws, Sketch
from scenegen.scene import RelayWall, Scene
from scenegen.shapes import Shape

Floats = NDArray[np.float32]
_USUAL_M: Final = 0.02  # difference of the depth maps
_USUAL_MISFIT: Final = 0.05
_DIMMED: Final = 0.7  # exponent of what is seen of a solid; fitted to pairs near depth maps
_SCALES: Final = (0.85, 1.1)  # light of a pair over the sum of the dimmed ones
_OFTEN: Final = 3  # how many pairs may have the same solid
_FIRST: Final = 4  # pairs of two shapes that tell the roughness of the wall


@dataclass(frozen=True)
class _Library:
    """N solids of one shape, (N, P) their mirror images, infinite beside them, and (N, V) their light."""

    draws: Draws
    depths_m: Floats
    light: Floats

    @classmethod
    def of(cls, draws: Draws, sketch: Sketch) -> _Library:
        """Without light."""
        depths_m = sketch.depths_of_m(draws).astype(np.float32)
        depths_m[depths_m == 0] = np.inf
        return cls(draws, depths_m, np.zeros((0, 0), np.float32))

    def lit(self, comparison: Comparison, corner: Scene) -> _Library:
        """With the light in a corner, as values of a comparison."""
        solids = [self.draws.solid(place) for place in range(len(self.draws.axes))]
        found = misfits([(comparison, replace(corner, hidden_objects=(each,))) for each in solids])
        return replace(
            self, light=np.array(found, np.float32) + comparison.observed.values.astype(np.float32)
        )


@dataclass(frozen=True)
class Pairs:
    """The pairs of solids of two shapes each that may be behind a measurement.

    Attributes
    ----------
    sketch : the network's depth map.
    comparison : with the measured light.
    apart_m : how far the centres of two solids are apart at most, along each axis.
    corner : with the relay wall that all starts have.
    libraries : of each shape.
    """

    sketch: Sketch
    comparison: Comparison
    apart_m: float
    corner: Scene
    libraries: Mapping[Shape, _Library]

    @classmethod
    def of(
        cls,
        sketch: Sketch,
        comparison: Comparison,
        draws: Sequence[Draws],
        apart_m: float,
        walls: Sequence[RelayWall],
    ) -> Pairs:
        """Pairs of some draws, one of each shape, with that of some walls which explains most."""
        libraries = {each.shape: _Library.of(each, sketch) for each in draws}
        pairs = cls(sketch, comparison, apart_m, sketch.corner, libraries)
        corner = replace(sketch.corner, relay_wall=pairs._wall(walls))
        lit = {shape: each.lit(pairs._bright, corner) for shape, each in libraries.items()}
        return replace(pairs, corner=corner, libraries=lit)

    def starts(self, count: int, among: Collection[frozenset[Shape]] | None = None) -> list[Scene]:
        """At most so many of each two shapes, or of those `among` all, most like depth map and light."""
        return [
            start
            for one, two in itertools.combinations(self.libraries.values(), 2)
            if among is None or {one.draws.shape, two.draws.shape} in among
            for _, start in self._best(one, two, self._against(one, two), count)
        ]

    def exchanged(self, candidates: Sequence[Scene], count: int) -> list[Scene]:
        """So many pairs for each solid of some candidates: it and another solid of the libraries."""
        found: list[Scene] = []
        for candidate in candidates:
            for solid in candidate.hidden_objects:
                one = _Library.of(Draws.of_solid(solid), self.sketch).lit(self._bright, self.corner)
                best = [
                    start
                    for shape, two in self.libraries.items()
                    if shape != solid.shape
                    for start in self._best(one, two, self._against(one, two), count)
                ]
                best.sort(key=lambda start: start[0])
                found += [replace(start, relay_wall=candidate.relay_wall) for _, start in best[:count]]
        return found

    @property
    def _bright(self) -> Comparison:
        """The comparison, with white solids if their reflectance is not known."""
        return replace(self.comparison, reflectance=self.comparison.reflectance or 1.0)

    def _wall(self, walls: Sequence[RelayWall]) -> RelayWall:
        """That of some walls with which the pairs most like the depth map explain most."""
        pairs = [
            pair
            for one, two in itertools.combinations(self.libraries.values(), 2)
            for _, pair in self._best(one, two, self._images(one, two)[0], _FIRST)
        ]
        asked = [(self.comparison, replace(pair, relay_wall=wall)) for pair in pairs for wall in walls]
        found = np.array([self.comparison.relative(each) for each in misfits(asked)])
        best = np.sort(found.reshape(len(pairs), len(walls)), axis=0)[: len(pairs) // _FIRST + 1]
        return walls[int(best.mean(axis=0).argmin())]

    def _against(self, one: _Library, two: _Library) -> Floats:
        """(N, M) what speaks against pairs."""
        apart_m, *seen = self._images(one, two)
        left = self._unexplained(one, two, *(share**_DIMMED for share in seen))
        against: Floats = (apart_m / _USUAL_M) ** 2 + left / _USUAL_MISFIT**2
        return against

    def _images(self, one: _Library, two: _Library) -> tuple[Floats, Floats, Floats]:
        """(N, M) mean differences of the mirror images of pairs to the depth map, infinite if too far apart.

        And the share that each shows of both solids.
        """
        wanted_m = self.sketch.radial_depth_m.astype(np.float32)
        count = len(one.depths_m), len(two.depths_m)
        apart_m, first, second = (np.empty(count, np.float32) for _ in range(3))
        of_two = np.isfinite(two.depths_m)
        for row, depth_m in enumerate(one.depths_m):
            of_one, nearer = np.isfinite(depth_m), depth_m < two.depths_m
            nearest_m = np.where(nearer, depth_m, two.depths_m)
            nearest_m[np.isinf(nearest_m)] = 0
            apart_m[row] = np.abs(nearest_m - wanted_m).mean(axis=1)
            first[row] = nearer.sum(axis=1) / max(of_one.sum(), 1)
            second[row] = (~nearer & of_two).sum(axis=1)
        second /= np.maximum(of_two.sum(axis=1), 1)
        between_m = np.abs(one.draws.centres_m[:, None] - two.draws.centres_m)
        apart_m[(between_m > self.apart_m).any(axis=-1)] = np.inf
        return apart_m, first, second

    def _unexplained(self, one: _Library, two: _Library, of_one: Floats, of_two: Floats) -> Floats:
        """(N, M) share of the light's power that sums do not explain, with such parts of both lights."""
        values = self.comparison.observed.values.astype(np.float32)
        power = values @ values
        along = of_one * (one.light @ values)[:, None] + of_two * (two.light @ values)
        own = of_one**2 * (one.light**2).sum(1)[:, None] + of_two**2 * (two.light**2).sum(1)
        own += 2 * of_one * of_two * (one.light @ two.light.T)
        scales = _SCALES if self.comparison.reflectance is not None else (0.0, np.inf)
        scale = np.clip(along / np.maximum(own, np.finfo(np.float32).tiny), *scales)
        left: Floats = (power - 2 * scale * along + scale**2 * own) / power
        return left

    def _best(
        self, one: _Library, two: _Library, against: Floats, count: int
    ) -> Iterator[tuple[float, Scene]]:
        """So many pairs with what speaks against them, the best first; each solid is in a few only."""
        used: list[Counter[int]] = [Counter(), Counter()]
        most = [_OFTEN if len(each.depths_m) > 1 else count for each in (one, two)]
        for place in np.argsort(against, axis=None, kind="stable").tolist():
            pair = divmod(place, against.shape[1])
            if count == 0 or not np.isfinite(against[pair]):
                return
            if all(counts[each] < limit for counts, each, limit in zip(used, pair, most, strict=True)):
                for counts, each in zip(used, pair, strict=True):
                    counts[each] += 1
                count -= 1
                solids = one.draws.solid(pair[0]), two.draws.solid(pair[1])
                yield float(against[pair]), replace(self.corner, hidden_objects=solids)
