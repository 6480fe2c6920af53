"""Least squares with weights that are not negative, from the normal equations.

The active-set method of Lawson and Hanson 1974 (chapter 23), on the normal equations as by Bro and de Jong
1997: it is fast for many more rows than columns. It ends after a number of steps; the weights are then
feasible, if not the best.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from itof.arrays import Floats

_STEPS: Final = 3  # times the number of columns, at most
_AGREES: Final = 1e-10  # slope that counts as 0, over the largest one at the start
_RIDGE: Final = 1e-12  # of columns with length 1 that are alike


def nonnegative_weights(columns: Floats, values: Floats) -> Floats:
    """(P,) weights w >= 0 with the least |columns w - values|²; columns (n, P) of length 1, values (n,)."""
    normal, along = columns.T @ columns + _RIDGE * np.eye(columns.shape[1]), columns.T @ values
    weights = np.zeros(len(along))
    chosen = np.zeros(len(along), bool)
    least = _AGREES * np.abs(along).max(initial=0.0)
    for _ in range(_STEPS * len(along)):
        slope = np.where(chosen, -np.inf, along - normal @ weights)
        if slope.max() <= least:
            break
        chosen[slope.argmax()] = True
        while chosen.any():
            places = np.flatnonzero(chosen)
            best = np.linalg.solve(normal[np.ix_(places, places)], along[places])
            below = best <= 0
            now = weights[places]
            if not below.any():
                weights[places] = best
                break
            # as far as no weight gets negative; those that get 0 are left out
            share = np.where(below, now / np.where(below, now - best, 1.0), np.inf)
            ends = share <= share.min()
            weights[places] = np.where(ends, 0.0, np.maximum(now + share.min() * (best - now), 0.0))
            chosen[places[ends]] = False
    return weights
