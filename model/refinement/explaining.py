"""What a refinement found, as its results keep it."""

from __future__ import annotations

import math

import numpy as np

from itof import DepthMap
from model.prediction.explanation import Explanation, FoundSolid
from model.refinement.light.corner_light import vector
from model.refinement.refining import Refined
from model.refinement.unknowns import stretches


def explained(
    found: Refined, prediction: DepthMap, expected_m: float | None, largest_misfit: float
) -> Explanation:
    """The solids with their uncertainty, and whether they are accepted (`Refined.is_right`)."""
    return Explanation(
        tuple(_solid(found, part) for part in range(len(found.solids))),
        found.is_right(expected_m, largest_misfit=largest_misfit),
        found.misfit,
        found.noise,
        found.difference_m(prediction),
        found.spread.expected_mae_m,
        found.reflectance,
        found.roughness,
    )


def _solid(found: Refined, part: int) -> FoundSolid:
    solid = found.solids[part]
    place, turn, size = (found.spread.of(kind, part) for kind in ("place", "turn", "size"))
    turn = turn if len(turn) else np.zeros(3)
    size = size @ stretches(solid.shape) if len(size) else np.zeros(3)
    return FoundSolid(
        *(solid.shape, solid.size_m, solid.location_m, solid.rotation_deg),
        *(vector(place), vector(turn * math.degrees(1)), vector(size * np.asarray(solid.size_m))),
    )
