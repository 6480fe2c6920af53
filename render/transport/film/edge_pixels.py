"""Division of pixels that see several surfaces into cells that see one.

The direct return is 200 to 5000 times the hidden signal, so the area of a pixel on each side of an edge must
be known to 1e-5. Cells with an edge are divided into four, again and again. Nothing here knows Mitsuba.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.transport.film.pixels import Grid, gauss_rule, midpoint_rule

# Cells of a pixel: 4 x 4 first, and after seven divisions 512 x 512 along an edge. A straight edge then has
# 800 smallest cells, of which each area is known to about a tenth: 800^(1/2) x 0.1 / 512² = 1e-5 of the
# pixel. Each of these cells has its 3 x 3 nodes elsewhere. An edge along the cells would otherwise have the
# same error in all of them. Where the direct return is the whole signal, 64 x 64 cells suffice: 100^(1/2) x
# 0.1 / 64² = 2e-4 of a pixel.
_FIRST_CELLS = 4
_GAUSS_SIZE = 1 / 8  # of a pixel: cells from this size on take 2 x 2 nodes, smaller ones their middle
_NINE = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(9, 2)  # x, y
_TURNS = np.sqrt([[2.0, 3.0], [5.0, 7.0]])  # multiples modulo 1 are spread evenly along every line of cells
_QUARTERS = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]])


@dataclass(frozen=True)
class EdgePixels:
    """E pixels that see several surfaces, and the N points at which they are evaluated.

    Attributes
    ----------
    pixels : (E,) row-major indices.
    points : (N, 2) film positions, x and y from 0 to 1.
    weights : (N,) share of the pixel; those of a pixel sum to 1.
    pixel : (N,) row-major index of the pixel of each point.
    uniform : row-major indices of the candidates that turned out to see one surface only.
    """

    pixels: NDArray[np.int64]
    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    pixel: NDArray[np.int64]
    uniform: NDArray[np.int64]


def divide_pixels(
    grid: Grid,
    candidates: NDArray[np.int64],
    surfaces: Callable[[NDArray[np.float64]], NDArray[np.uint32]],
    divisions: int,
    first_cells: int = _FIRST_CELLS,
) -> EdgePixels:
    """Divide those of the candidate pixels that see several surfaces.

    Parameters
    ----------
    candidates : row-major indices.
    surfaces : (N, 2) film positions -> (N,) number of the surface that is seen there.
    divisions : how often cells with an edge are divided into four.
    first_cells : of a pixel, along x and y, before any division.
    """
    size = (grid.width, grid.height)
    corner = np.stack([candidates % grid.width, candidates // grid.width], axis=-1).astype(float)
    offsets = np.stack(np.meshgrid(*[np.arange(first_cells) / first_cells] * 2), axis=-1).reshape(-1, 2)
    cells = (corner[:, None] + offsets).reshape(-1, 2)  # corners of the cells, in pixels
    owner = np.repeat(candidates, len(offsets))
    length, found, crossed = 1 / first_cells, [], []
    for division in range(divisions + 1):
        if not len(cells):
            break
        nine = (cells[:, None] + length * _NINE) / size
        seen = surfaces(nine.reshape(-1, 2)).reshape(-1, 9)
        cut = (seen != seen[:, :1]).any(axis=1)
        if division == 0:
            crossed = owner[cut]
        found.append(_middle(cells[~cut], owner[~cut], length))
        if division == divisions:
            found.append(_shifted(cells[cut], owner[cut], length))
        cells = (cells[cut][:, None] + length * _QUARTERS).reshape(-1, 2)
        owner, length = np.repeat(owner[cut], 4), length / 2
    pixels = np.unique(crossed).astype(np.int64)
    points, pixel, weights = (
        (np.concatenate(column) for column in zip(*found, strict=True))
        if found
        else (np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0))
    )
    kept = np.isin(pixel, pixels)
    return EdgePixels(
        pixels, points[kept] / size, weights[kept], pixel[kept], np.setdiff1d(candidates, pixels)
    )


def _middle(
    cells: NDArray[np.float64], owner: NDArray[np.int64], length: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Points (in pixels), pixels and weights for cells that see one surface."""
    rule = gauss_rule(2 if length >= _GAUSS_SIZE else 1)
    points = (cells[:, None] + length * rule.pixel_nodes).reshape(-1, 2)
    weights = np.tile(rule.pixel_weights, len(cells)) * length**2
    return points, np.repeat(owner, rule.count), weights


def _shifted(
    cells: NDArray[np.float64], owner: NDArray[np.int64], length: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Points (in pixels), pixels and weights for cells with an edge: 3 x 3 nodes, shifted cyclically."""
    rule = midpoint_rule(3)
    shift = np.round(cells / length) @ _TURNS
    places = (rule.pixel_nodes + shift[:, None]) % 1  # of a cell
    points = (cells[:, None] + length * places).reshape(-1, 2)
    weights = np.tile(rule.pixel_weights, len(cells)) * length**2
    return points, np.repeat(owner, rule.count), weights
