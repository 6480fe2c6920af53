"""How round a mask is: whether a network draws every object as a sphere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

SAMPLES = 16  # points along each side of a pixel, for the part of it that a disc covers


def disc_iou(mask: ArrayLike) -> float | None:
    """Intersection over union of a mask with the disc of equal area at its centroid; None if it is empty.

    1 for a disc, 0.834 for a square, less for all that is long, bent, hollow or in several parts. A sphere is
    seen as a disc, nearly. It needs no perimeter: along the edges of pixels, the perimeter of a disc is that
    of its square, and 4π A / P² would call the square the rounder of the two.

    Parameters
    ----------
    mask : (H, W); pixels are squares of side 1, and the part of the disc outside the image counts.

    Source: Caligiuri et al. 2024, sec. 6.1 (without IoU in the loss, shapes tend to spheres; no number); the
    measure is ours.
    """
    shows = np.asarray(mask).astype(bool)
    rows, columns = np.nonzero(shows)
    area = len(rows)
    if not area:
        return None
    towards = rows - rows.mean(), columns - columns.mean()  # (n,) each, pixel centres from the centroid
    inside = float(_covered(*towards, np.sqrt(area / np.pi)).sum())
    return inside / (2 * area - inside)  # mask and disc have the same area


def _covered(rows: NDArray[np.float64], columns: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """(n,) parts of pixels, with centres at (n,) rows and columns, that a disc at the origin covers."""
    away = np.hypot(rows, columns)
    covered = (away < radius).astype(np.float64)
    cut = np.abs(away - radius) < np.sqrt(0.5)  # the others are inside or outside with all corners
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    y = rows[cut][:, None, None] + steps[:, None]  # (cut, SAMPLES, SAMPLES) with x
    x = columns[cut][:, None, None] + steps
    covered[cut] = (y**2 + x**2 < radius**2).mean(axis=(1, 2))
    return covered
