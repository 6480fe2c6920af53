"""Positions on the film: quadrature rules for a pixel, and the pixels of an image in blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

LANES = 2**20  # most rays of one kernel launch


@dataclass(frozen=True)
class PixelRule:
    """A quadrature rule for the average over a pixel, with the same one-dimensional nodes in x and y.

    Attributes
    ----------
    nodes : (n,) positions in (0, 1).
    weights : (n,) their sum is 1.
    """

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of nodes in a pixel."""
        return len(self.nodes) ** 2

    @property
    def pixel_nodes(self) -> NDArray[np.float64]:
        """(n², 2) x and y of the nodes of a pixel; y varies slowest."""
        y, x = np.meshgrid(self.nodes, self.nodes, indexing="ij")
        return np.stack([x.ravel(), y.ravel()], axis=-1)

    @property
    def pixel_weights(self) -> NDArray[np.float64]:
        """(n²,) weights of the nodes of a pixel, in the order of `pixel_nodes`."""
        return np.outer(self.weights, self.weights).ravel()


@cache
def gauss_rule(order: int) -> PixelRule:
    """Gauss-Legendre rule for smooth integrands: exact for polynomials of degree 2 order - 1."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return PixelRule((nodes + 1) / 2, weights / 2)  # from [-1, 1] to [0, 1]


def midpoint_rule(count: int) -> PixelRule:
    """Midpoints of equal cells, for integrands with edges and for histograms."""
    return PixelRule((np.arange(count) + 0.5) / count, np.full(count, 1 / count))


@dataclass(frozen=True)
class Grid:
    """The pixels of an image of width x height."""

    width: int
    height: int

    def blocks(self, rule: PixelRule, limit: int = LANES) -> Iterator[tuple[int, int]]:
        """Ranges of rows (first row, row after the last) with at most `limit` pixel samples."""
        step = max(1, limit // (self.width * rule.count))
        for start in range(0, self.height, step):
            yield start, min(start + step, self.height)

    def points(self, pixels: NDArray[np.int64], nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, n, 2) film positions, from 0 to 1, of nodes (n, 2) in pixels (N,) of row-major index."""
        corner = np.stack([pixels % self.width, pixels // self.width], axis=-1)
        return (corner[:, None] + nodes) / (self.width, self.height)


def group_sums(
    values: NDArray[np.complex128], group: NDArray[np.int64], count: int
) -> NDArray[np.complex128]:
    """(count, F) sums of the values (N, F) of each group, added in their order.

    Parameters
    ----------
    group : (N,) number of the group of each value, below `count`.
    """
    columns = [
        np.bincount(group, part, count) + 1j * np.bincount(group, imaginary, count)
        for part, imaginary in zip(values.real.T, values.imag.T, strict=True)
    ]
    return np.stack(columns, axis=-1)
