"""Chebyshev nodes, and polynomials between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def chebyshev(count: int) -> tuple[Floats, Floats]:
    """(count,) Chebyshev nodes in [-1, 1], ascending, and their (count,) barycentric weights."""
    nodes = np.cos((np.arange(count) + 0.5) * np.pi / count)[::-1]
    weights = np.array([1 / np.prod(node - np.delete(nodes, place)) for place, node in enumerate(nodes)])
    return nodes, weights / np.abs(weights).max()


def interpolation(count: int, at: Floats) -> Floats:
    """(..., count) shares of Chebyshev nodes at places (...,) of [-1, 1] (Berrut and Trefethen 2004).

    A place beyond is taken for the nearer end: polynomials grow without bound there.
    """
    nodes, weights = chebyshev(count)
    gap = np.clip(at, -1, 1)[..., None] - nodes
    matrix = weights / np.where(np.abs(gap) < 1e-14, 1e-14, gap)
    shares: Floats = matrix / matrix.sum(-1, keepdims=True)
    return shares
