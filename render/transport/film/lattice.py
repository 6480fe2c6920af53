"""A lattice over the film, and interpolation from its nodes with cubic splines.

The ratio of the hidden signal to a carrier varies slowly over the relay wall, so it is computed at the nodes
of a coarse lattice only (docs/science/renderer.md, Lattice). Nothing here knows Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import binary_dilation

_DEGREE = 3  # of the splines
_MARGIN = 2  # cells around an invalid node that are not interpolated; a spline forgets 0.27 per cell


@dataclass(frozen=True)
class Lattice:
    """Nodes at equal distances in x and in y, from edge to edge of the film.

    Attributes
    ----------
    columns, rows : number of cells in x and in y, at least 3.
    """

    columns: int
    rows: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of nodes in y and in x."""
        return self.rows + 1, self.columns + 1

    @property
    def nodes(self) -> NDArray[np.float64]:
        """(N, 2) film positions of the nodes, x and y from 0 to 1, in row-major order."""
        y, x = np.meshgrid(*(np.linspace(0, 1, count) for count in self.shape), indexing="ij")
        return np.stack([x.ravel(), y.ravel()], axis=-1)

    def halved(self) -> Lattice:
        """The lattice with half the step; every second of its nodes is a node of this one."""
        return Lattice(2 * self.columns, 2 * self.rows)

    def is_old(self) -> NDArray[np.bool_]:
        """(N,) whether a node of this lattice was a node of the lattice that was halved."""
        old = np.zeros(self.shape, bool)
        old[::2, ::2] = True
        return old.ravel()

    def covers(self, points: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(P,) whether all nodes near each point are valid, so that it can be interpolated.

        Parameters
        ----------
        points : (P, 2) film positions.
        valid : (N,) nodes.
        """
        bad = ~valid.reshape(self.shape)
        touched = bad[:-1, :-1] | bad[1:, :-1] | bad[:-1, 1:] | bad[1:, 1:]  # a corner of the cell is invalid
        near = binary_dilation(touched, np.ones((3, 3), bool), iterations=_MARGIN) if bad.any() else touched
        cell = np.clip((points * (self.columns, self.rows)).astype(int), 0, (self.columns - 1, self.rows - 1))
        return ~near[cell[:, 1], cell[:, 0]]

    def interpolated(
        self, values: NDArray[np.complex128], points: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        """(P, F) values at film positions (P, 2), from values at the nodes (N, F)."""
        table = values.reshape(*self.shape, -1)
        across, down = (_spline(count, points[:, axis]) for axis, count in enumerate(self.shape[::-1]))
        return np.einsum("py,yxf,px->pf", down, table, across, optimize=True)

    def interpolated_grid(
        self, values: NDArray[np.complex128], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        """(Y, X, F) values at all pairs of film positions x (X,) and y (Y,), from values at the nodes."""
        table = values.reshape(*self.shape, -1)
        down, across = _spline(self.shape[0], y), _spline(self.shape[1], x)
        rows = np.tensordot(down, table, axes=1)  # (Y, nodes, F)
        return np.einsum("ynf,xn->yxf", rows, across, optimize=True)

    def spline_columns(self, table: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coefficients of the splines along x through curves at the nodes, both (rows, columns, S)."""
        coefficients = _unit_splines(self.shape[1]).c.astype(np.float32)
        return np.stack([coefficients @ row for row in table])

    def down(self, table: NDArray[np.float32], y: NDArray[np.float64]) -> NDArray[np.float32]:
        """(Y, columns, S) curves at film positions y (Y,), from curves at the nodes (rows, columns, S)."""
        return np.tensordot(_spline(self.shape[0], y).astype(np.float32), table, axes=1)

    def taps(self, x: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """First (X,) of the four coefficients of `spline_columns` that count at x (X,), and their weights.

        The weights are (X, 4); all other coefficients have none.
        """
        design = BSpline.design_matrix(x, _unit_splines(self.shape[1]).t, _DEGREE)
        return design.indices[:: _DEGREE + 1].astype(np.int64), design.data.reshape(-1, _DEGREE + 1)


def filled(values: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[Any]:
    """(rows, columns, F) values with invalid nodes extrapolated from valid neighbours; 0 if none is valid.

    Splines need a value at every node. What stands at an invalid node has little effect where `covers` is
    true.
    """
    values = np.where(valid[..., None], values, 0)
    known = valid.copy()
    while known.any() and not known.all():
        total, count = np.zeros_like(values), np.zeros(known.shape)
        for axis in (0, 1):
            for step in (1, -1):
                near, far = (_shifted(known, axis, step * n) for n in (1, 2))
                a, b = (_shifted(values, axis, step * n) for n in (1, 2))
                slope = np.where((near & far)[..., None], a - b, 0)  # linear where two neighbours are known
                total += np.where(near[..., None], a + slope, 0)
                count += near
        new = ~known & (count > 0)
        values[new] = total[new] / count[new, None]
        known |= new
    return values


def _shifted(values: NDArray[Any], axis: int, step: int) -> NDArray[Any]:
    """Values of the node `step` further along an axis; 0 beyond the lattice."""
    moved = np.zeros_like(values)
    size = values.shape[axis]
    kept = max(size - abs(step), 0)
    to = [slice(None)] * values.ndim
    of = [slice(None)] * values.ndim
    to[axis] = slice(0, kept) if step > 0 else slice(size - kept, size)
    of[axis] = slice(size - kept, size) if step > 0 else slice(0, kept)
    moved[tuple(to)] = values[tuple(of)]
    return moved


@cache
def _unit_splines(count: int) -> BSpline:
    """Cubic splines through each unit vector of `count` nodes on [0, 1], not-a-knot at the ends."""
    return make_interp_spline(np.linspace(0, 1, count), np.eye(count), k=_DEGREE)


def _spline(count: int, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, count) weights of the nodes in the value at positions (P,)."""
    weights: NDArray[np.float64] = _unit_splines(count)(at)
    return weights
