"""What of a surface is outside the other solids of its scene.

A solid is where none of a few functions g is above 0: |x_i| - s_i / 2 for the sides of its box, and its
quadric. Over the part of another surface that a point stands for, g is taken to be linear. With the
gradient ∇g along the surface, a part of the width w is free by 1/2 + g / (w |∇g|), between 0 and 1. The
largest share of the functions counts, and the smallest of all solids.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from render.batch.quadrics import NO_QUADRIC, is_convex, quadric_of
from render.batch.tables import PlacedObject, rotated

Floats = NDArray[np.float64]
_TINY = 1e-9  # for gradients that are normal to the surface


def free_parts(
    at: Floats, normal: Floats, area: Floats, others: Sequence[Sequence[PlacedObject]]
) -> tuple[Floats, Floats]:
    """Free share (n, S) of the parts of n surfaces, and the middles (n, S, 3) of what is free.

    Parameters
    ----------
    at, normal, area : (n, S, 3), (n, S, 3) and (n, S) of the parts, in camera axes, metres.
    others : the other objects of each surface's scene; nothing is inside a sheet or a user's mesh.
    """
    share, middle = np.ones(area.shape), at.copy()
    solids = [[each for each in some if is_convex(each.shape)] for some in others]
    for place in range(max(map(len, solids), default=0)):
        rows = np.array([row for row, some in enumerate(solids) if len(some) > place])
        width = np.sqrt(area[rows])
        free, outwards = _outside([solids[row][place] for row in rows], at[rows], normal[rows], width)
        least = free < share[rows]
        share[rows] = np.where(least, free, share[rows])
        middles = at[rows] + ((1 - free) * width / 2)[..., None] * outwards
        middle[rows] = np.where(least[..., None], middles, middle[rows])
    return share, middle


def _outside(
    solids: Sequence[PlacedObject], at: Floats, normal: Floats, width: Floats
) -> tuple[Floats, Floats]:
    """Share (m, S) of parts outside one solid each, and the way out along the surface (m, S, 3)."""
    share, outwards = np.zeros(width.shape), np.zeros(at.shape)
    for value, gradient in _functions(solids, at):
        along = gradient - (gradient * normal).sum(-1, keepdims=True) * normal
        slope = np.linalg.norm(along, axis=-1)
        free = np.clip(0.5 + value / (slope * width + _TINY), 0, 1)
        more = free > share
        share = np.where(more, free, share)
        outwards = np.where(more[..., None], along / (slope[..., None] + _TINY), outwards)
    return share, outwards


def _functions(solids: Sequence[PlacedObject], at: Floats) -> Iterator[tuple[Floats, Floats]]:
    """The functions g (m, S) of m solids at points (m, S, 3), and their gradients, which may be (m, S, 3)."""
    axes = np.stack([each.axes for each in solids])  # (m, 3, 3)
    size = np.stack([each.size for each in solids])[:, None]
    from_centre = at - np.stack([each.centre for each in solids])[:, None]
    own = rotated(np.swapaxes(axes, 1, 2), from_centre) / size
    for axis in range(3):
        side = np.sign(own[..., axis])[..., None]
        yield (np.abs(own[..., axis]) - 0.5) * size[..., axis], side * axes[:, None, :, axis]
    quadrics = np.array([quadric_of(each.shape)[0] for each in solids])
    if (quadrics == NO_QUADRIC).all():
        return
    square, linear = quadrics[:, None, :3], quadrics[:, None, [3, 3, 4]] * [1, 0, 1]
    value = ((square * own + linear) * own).sum(-1) + quadrics[:, None, 5]
    gradient = rotated(axes, (2 * square * own + linear) / size)
    is_box = (quadrics == NO_QUADRIC).all(1)[:, None]
    yield np.where(is_box, -np.inf, value), gradient
