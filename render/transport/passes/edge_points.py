"""The hidden signal of pixels with edges, from a few points of every surface there.

Over a pixel, the ratio of the signal to the carrier is nearly a polynomial of degree 2, whatever shape the
visible part has. The carrier is known at all points of `EdgePixels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.transport.film.pixels import group_sums
from render.transport.passes.direct_pass import DirectImage

_EDGE_POINTS = 8  # for each surface in a pixel that sees several
_WILD = 4.0  # weights over the carrier's, from which a polynomial extrapolates
_NARROWEST = 1e-4  # of a pixel: what is narrower is a line
_ALIKE = 1e-9  # polynomials that differ by less of their squares on points that lie on a line
_CURVE_BITS = 9  # of each coordinate of a space-filling curve through such a pixel: its smallest cells


@dataclass(frozen=True)
class ChosenPoints:
    """A few points for every surface in every pixel with an edge: G such groups, C points.

    Attributes
    ----------
    points, weights : (C, 2) film positions, (C,) share of the pixel.
    group : (C,) group of each point.
    pixels : (G,) row-major index of the pixel of each group.
    seen : (M,) those of the points of `EdgePixels` that see a surface.
    seen_points, seen_weights, seen_groups : (M, 2) and (M,) film position, share and group of each of them.
    pixel_size : (2,) width and height of a pixel on the film.
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    group: NDArray[np.int64]
    pixels: NDArray[np.int64]
    seen: NDArray[np.int64]
    seen_points: NDArray[np.float64]
    seen_weights: NDArray[np.float64]
    seen_groups: NDArray[np.int64]
    pixel_size: NDArray[np.float64]

    def sums(self, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(G, F) sum over the chosen points (C, F) of each group."""
        return group_sums(values, self.group, len(self.pixels))

    def totals(self, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(G, F) sum over all points (M, F) of each group."""
        return group_sums(values, self.seen_groups, len(self.pixels))

    def means(
        self, values: NDArray[np.complex128], carrier: NDArray[np.complex128], whole: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """(G, F) part of each group in its pixel: by polynomials of degree 1 and 2 for value / carrier.

        The weights of the chosen points are those of the plain mean with the least change by which the
        products of the carrier and all polynomials have their sums over the whole group.

        Parameters
        ----------
        values, carrier : (C, F) at the chosen points.
        whole : (M, F) carrier at all points.
        """
        plain = self.sums(values * self.weights[:, None])
        over_carrier = np.divide(values, carrier, out=np.zeros_like(values), where=carrier != 0)
        over_carrier = over_carrier.reshape(len(plain), _EDGE_POINTS, values.shape[1])  # (G, K, F)
        start = (carrier * self.weights[:, None]).reshape(over_carrier.shape)
        powers, all_powers = self._powers()  # (6, G, K), (6, M)
        weighted = whole * self.seen_weights[:, None]
        moments = np.stack([self.totals(weighted * each[:, None]) for each in all_powers])  # (6, G, F)
        lacks = np.moveaxis(moments, 0, 1) - np.einsum("igk,gkf->gif", powers, start)
        dark, found = (start == 0).any(axis=(1, 2))[:, None], [plain, plain]
        most = _WILD * self.totals(np.abs(weighted))
        for count in (1, 3, 6):
            p = powers[:count].transpose(1, 0, 2)
            inverse = np.linalg.pinv(p @ p.transpose(0, 2, 1), rcond=_ALIKE, hermitian=True)
            change = np.einsum("gik,gij,gjf->gkf", p, inverse, lacks[:, :count], optimize=True)
            by_degree = ((start + change) * over_carrier).sum(axis=1)
            # A carrier with steps keeps the degree before.
            kept = dark | (np.abs(start + change).sum(axis=1) > most)
            found = [np.where(kept, found[0], found[1]), np.where(kept, found[1], by_degree)]
        return found[0], found[1]

    def _powers(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(6, G, K) and (6, M) polynomials of degree 0 to 2 at the chosen points and at all points.

        Their origin is the mean of the chosen points of each group, their unit the spread along each axis.
        """
        own = self.points.reshape(len(self.pixels), _EDGE_POINTS, 2)
        mean = own.mean(axis=1)
        spread = np.maximum(own.std(axis=1), _NARROWEST * self.pixel_size)
        near = (own - mean[:, None]) / spread[:, None]
        far = (self.seen_points - mean[self.seen_groups]) / spread[self.seen_groups]
        one, other = (
            np.stack([0 * x + 1, x, y, x * x, x * y, y * y])
            for x, y in (np.moveaxis(each, -1, 0) for each in (near, far))
        )
        return one, other


def choose_points(direct: DirectImage) -> ChosenPoints:
    """Points that are spread over what each surface fills of each pixel with an edge, of equal weights."""
    edges, surface = direct.edges, direct.edge_samples.surface.astype(np.int64)
    seen = np.flatnonzero(surface > 0)
    # A sort of all points would take longer than the rest of a small image.
    surfaces = np.flatnonzero(np.bincount(surface[seen]))  # a few numbers
    number_of = np.zeros(direct.surface.size, np.int64)
    number_of[edges.pixels] = np.arange(len(edges.pixels))
    key = number_of[edges.pixel[seen]] * len(surfaces) + np.searchsorted(surfaces, surface[seen])
    is_group = np.bincount(key) > 0
    groups, group = np.flatnonzero(is_group), (np.cumsum(is_group) - 1)[key]
    place = (edges.points[seen] * direct.surface.shape[::-1] % 1 * 2**_CURVE_BITS).astype(int)
    bits = [(bit, axis) for bit in range(_CURVE_BITS) for axis in (0, 1)]
    along = sum(((place[:, axis] >> bit) & 1) << (2 * bit + axis) for bit, axis in bits)
    order = np.lexsort((along, group))
    reached = np.concatenate([[0.0], np.cumsum(edges.weights[seen[order]])])
    ends = np.searchsorted(group[order], np.arange(len(groups) + 1))
    total = reached[ends[1:]] - reached[ends[:-1]]
    steps = (np.arange(_EDGE_POINTS) + 0.5) / _EDGE_POINTS
    chosen = np.searchsorted(reached, reached[ends[:-1], None] + steps * total[:, None], side="right") - 1
    kept = seen[order[chosen.ravel()]]
    number = np.repeat(np.arange(len(groups)), _EDGE_POINTS)
    weights = np.repeat(total / _EDGE_POINTS, _EDGE_POINTS)
    pixels = edges.pixels[groups // max(1, len(surfaces))]
    of_seen = (seen, edges.points[seen], edges.weights[seen], group)
    size = 1 / np.array(direct.surface.shape[::-1])
    return ChosenPoints(edges.points[kept], weights, number, pixels, *of_seen, size)
