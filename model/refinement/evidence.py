"""How well a measurement tells solids apart: what speaks for a fit, and how wrong it may be.

The evidence against a fit with the misfit m of the values v is

    |m|² / (noise² + (ε |v|)²) + (d / D)² + a,

with the noise of a value, the usual error ε of a model's light, the mean difference d of its mirror image to
the depth map of the network, the error D that the network expects of that, and a number a for a second solid.
Model errors are smooth over the wall, so that all of them count like one value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from model.refinement.least_squares import Fit, beside, derivatives, misfits
from model.refinement.sketch import Sketch
from model.refinement.unknowns import FARTHEST, Fitted, Unknown, changed, within_reach

Floats = NDArray[np.float64]
USUAL_MISFIT: Final = 0.002  # ε, of the right solids
_WITH_FEW_NODES: Final = 0.006  # the same, of light with few nodes
USUAL_M: Final = 0.02  # D of a network that expects none
_LEAST_M: Final = 0.005  # of D
# Independent values in the errors of a model. Chosen so that stated errors are the actual ones.
INDEPENDENT: Final = 14
# As many of them is the usual misfit worth: logarithms of those of the right solids scatter by 0.37.
_USUAL_IS_WORTH: Final = 6
_OF_A_POSE: Final = 7  # unknowns of a solid, and the roughness of the wall
# One of seven scenes has two solids, and each of six unknowns lowers a chi-squared by one, by chance.
_OF_ANOTHER: Final = 2 * math.log(6) + 6
_DRAWS: Final = 8


@dataclass(frozen=True)
class Prior:
    """What the network expects: its depth map, and the error of it, metres."""

    sketch: Sketch
    expected_m: float

    @classmethod
    def of(cls, sketch: Sketch, expected_m: float | None) -> Prior:
        """`expected_m` is None for a network that expects no error."""
        return cls(sketch, USUAL_M if expected_m is None else max(expected_m, _LEAST_M))

    def against(self, fits: Sequence[Fit]) -> Floats:
        """(N,) evidence against fits."""
        if not fits:
            return np.zeros(0)
        apart_m = self.sketch.differences_m([fit.candidate for fit in fits])
        light = np.array([fit.misfit**2 * _in_errors(fit) for fit in fits])
        more = np.array([len(fit.candidate.hidden_objects) - 1 for fit in fits])
        against: Floats = light + (apart_m / self.expected_m) ** 2 + _OF_ANOTHER * more
        return against


def against_nothing(fit: Fit) -> float:
    """Evidence against there being no light at all, less that against the light of a fit."""
    return (1 - fit.misfit**2) * _in_errors(fit)


def _in_errors(fit: Fit) -> float:
    """|v|² in units of the errors."""
    observed = fit.comparison.observed
    power = max(float(observed.values @ observed.values), float(np.finfo(float).tiny))
    is_exact = fit.comparison.fine or fit.comparison.lacking is not None
    usual = USUAL_MISFIT if is_exact else _WITH_FEW_NODES
    return power / (observed.noise**2 + usual**2 * power)


def variance_of_model(unexplained: float, unknowns: int) -> float:
    """Variance of one independent value of a model's error, over the power of the light.

    Each unknown takes one of the values, so what a fit leaves unexplained is less than the model's error. It
    is known from what is left and from the usual error, as a variance with an inverse gamma distribution.
    """
    left = max(_USUAL_IS_WORTH + INDEPENDENT - unknowns, 1)
    power = (_USUAL_IS_WORTH * USUAL_MISFIT**2 + INDEPENDENT * unexplained**2) / left
    return power / INDEPENDENT


def power_of_jumps(sides: Floats, middle: Floats) -> float:
    """Mean power by which light jumps between candidates, since shadows move from node to node.

    A fit ends where the jump suits it. So, unlike the model's smooth error, it may count in one value.

    Parameters
    ----------
    sides : (U, 2, M) values at even steps to both sides of `middle` (M,). Without jumps, they lie on a line.
    """
    bent = sides.sum(axis=1) - 2 * middle  # the sum of one, one and four times the power
    return float((bent**2).sum(axis=1).mean() / 6)


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the unknowns of a fit, and the error of its mirror image that follows.

    Attributes
    ----------
    unknowns, deviation : (U,) the numbers, and how wrong each may be, in its unit.
    is_dim : whether the reflectance is one more unknown.
    expected_mae_m : mean absolute error over all pixels.
    """

    unknowns: Sequence[Unknown]
    deviation: Floats
    is_dim: bool
    expected_mae_m: float

    @classmethod
    def of_fits(cls, fits: Sequence[Fit], prior: Prior, fine: Sketch, fitted: Fitted, seed: int) -> Spread:
        """Of the first of some fits; the others are what the object may be instead.

        `fine` has the pixels of the image.
        """
        fit = fits[0]
        is_dim = fit.comparison.reflectance is None
        ((unknowns, sides),) = beside([fit], fitted)
        jacobian = derivatives(unknowns, sides)
        observed = fit.comparison.observed
        power = float(observed.values @ observed.values)
        model = power * variance_of_model(fit.unexplained, len(unknowns) + is_dim)
        # Roughness moves no shadow, and its steps may be uneven.
        moves = [unknown.kind != "roughness" for unknown in unknowns]
        rough = power_of_jumps(sides[moves], misfits([(fit.comparison, fit.candidate)])[0])
        # What the light does not tell of a solid is not far all the same.
        reach = np.array([FARTHEST[unknown.kind] for unknown in unknowns])
        information = jacobian.T @ jacobian / (observed.noise**2 + model + rough) + np.diag(reach**-2)
        covariance = np.linalg.inv(information)
        draws = np.random.default_rng(seed).multivariate_normal(
            np.zeros(len(covariance)), covariance, _DRAWS, method="eigh"
        )
        near = [
            changed(fit.candidate, unknowns, within_reach(fit.candidate, unknowns, draw)) for draw in draws
        ]
        shown = fine.depths_m([*(each.candidate for each in fits), *near])
        apart_m = np.abs(shown - shown[0]).mean(axis=1)
        against = prior.against(fits)
        share = np.exp((against.min() - against) / 2)
        other_m = float(share @ apart_m[: len(fits)] / share.sum())
        own_m = float(apart_m[len(fits) :].mean())
        return cls(unknowns, np.sqrt(np.diag(covariance)), is_dim, own_m + other_m)

    @property
    def freedom(self) -> float:
        """Misfit that these unknowns leave of errors of the model, over that which those of a pose leave."""
        count = sum(unknown.kind != "room" for unknown in self.unknowns) + self.is_dim
        return math.sqrt(max(INDEPENDENT - count, 1) / (INDEPENDENT - _OF_A_POSE))

    def of(self, kind: str, part: int) -> Floats:
        """(n,) standard deviations of one kind of unknowns of one of the solids."""
        pairs = zip(self.unknowns, self.deviation, strict=True)
        return np.array([value for each, value in pairs if (each.kind, each.part) == (kind, part)])
