"""How many Gauss nodes the direct return of a pixel needs: from its phases and from its brightness.

Within a pixel, a plane wall's path t and radiance L are smooth, and L exp(jkt) is about exp(a x) with
|a| = D, the change of k t plus that of ln L. The error of n nodes is at most
D^2n (n!)^4 / ((2n + 1) (2n)!^3).

Towards the horizon of the wall the path grows like the inverse of the distance to it, so the phase changes
faster at one end than on average: by the ratio of the paths at both ends, of which the light that comes from
there loses the third power. The square root of the ratio covers both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from itof import phase_per_metre
from render.transport.film.pixels import gauss_rule

Floats = NDArray[np.float64]
RULE_ERROR: Final = 1e-8  # of the direct return, which is 200 to 5000 times the hidden signal
MOST_NODES: Final = 48  # in x and in y
_ORDERS: Final = np.arange(2, MOST_NODES + 1)


def _log_share(order: NDArray[np.int64]) -> Floats:
    """Logarithm of the error of some nodes over D^2n."""
    share: Floats = 4 * gammaln(order + 1) - np.log(2 * order + 1) - 3 * gammaln(2 * order + 1)
    return share


_LARGEST: Final = np.exp((np.log(RULE_ERROR) - _log_share(_ORDERS)) / (2 * _ORDERS))  # D of each order


def needed_order(change: Floats) -> NDArray[np.int64]:
    """The least number of nodes for changes D; MOST_NODES + 1 where that is not enough."""
    order: NDArray[np.int64] = 2 + np.searchsorted(_LARGEST, change)
    return order


def rule_error(change: Floats) -> Floats:
    """Error of MOST_NODES nodes for changes D, relative to the light; at most 1."""
    error: Floats = np.exp(np.minimum(2 * MOST_NODES * np.log(change) + _log_share(_ORDERS[-1:]), 0))
    return error


@dataclass(frozen=True)
class PixelRange:
    """Least and greatest of the direct return at the lit nodes of pixels; all four (P,), radiance above 0."""

    near_m: Floats
    far_m: Floats
    dim: Floats
    bright: Floats

    def change(self, frequencies_hz: tuple[float, ...], order: int) -> Floats:
        """(P,) D from side to side of pixels, of which the nodes between reach over a part."""
        reach = 2 * float(gauss_rule(order).nodes[-1]) - 1  # the outermost node
        near_m, far_m = (np.maximum(each, 1e-30) for each in (self.near_m, self.far_m))
        inverse = (1 / near_m - 1 / far_m) * (1 / reach - 1) / 2  # to the sides
        far_m, near_m = 1 / np.maximum(1 / far_m - inverse, 1e-3 / far_m), 1 / (1 / near_m + inverse)
        phase = max(phase_per_metre(frequencies_hz)) * (far_m - near_m) * np.sqrt(far_m / near_m)
        change: Floats = phase + np.log(self.bright / self.dim) / reach
        return change
