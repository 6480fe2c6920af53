"""What the hidden object may be, from a preset; and which limits of the misfit there are."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from disk.quantities import Extent
from model.judging.refusals import EvaluationError
from model.refinement.settings import Unknown
from scenegen import Preset
from scenegen.shapes import PRIMITIVES, Shape


@dataclass(frozen=True)
class Family:
    """What the hidden object may be.

    Attributes
    ----------
    sizes : extents of each shape that may be there, metres; to start with, if `fits_sizes`.
    fits_sizes : whether the extents are unknowns.
    reflectance : of the object; None: it is not known.
    apart_m : how far the centres of two solids may be apart along an axis, metres; None: there is one solid.
    """

    sizes: Mapping[Shape, Extent]
    fits_sizes: bool = False
    reflectance: float | None = 1.0
    apart_m: float | None = None


def family_of(preset: Preset, unknown: Collection[Unknown]) -> Family:
    """The shapes of a preset that can be fitted; `unknown` is not taken from it.

    Raises
    ------
    EvaluationError : none of its shapes can be fitted.
    """
    hidden = preset.hidden_object
    listed = [thing for each in preset.object for thing in each.things if thing.shape]
    extents_m = {(thing.name, thing.extent_m(hidden.size_m)) for thing in listed}
    known = dict(sorted(extents_m))
    has_one_size = hidden.has_one_size and len(known) == len(extents_m)
    known |= {shape: hidden.size_m.of(shape) for shape in preset.shapes if shape in {*PRIMITIVES} - {*known}}
    if not known:
        raise EvaluationError(
            f"the preset of the objects has none of the shapes that can be fitted: {', '.join(PRIMITIVES)}"
        )
    are_alike = all(thing.reflectance == 1 for thing in listed)
    is_known = "reflectance" not in unknown and hidden.least_reflectance is None and are_alike
    largest = hidden.size_factor[1]
    apart_m = largest * max(map(abs, hidden.composite_offset_m)) if hidden.pair_fraction > 0 else None
    if preset.object:
        usual = hidden.location_m
        offsets = [listed.offsets_m(each, usual) for listed in preset.object for each in listed.beside]
        apart_m = max((abs(end) for o in offsets for side in (o.x, o.y, o.z) for end in side), default=None)
    fits_sizes = "sizes" in unknown or not has_one_size
    return Family(known, fits_sizes, hidden.reflectance if is_known else None, apart_m)


def refuse_misfit(largest_misfit: float) -> None:
    """Refuse a share of the light that is none (`EvaluationError`)."""
    if not (math.isfinite(largest_misfit) and largest_misfit > 0):
        raise EvaluationError(f"the largest misfit is a number above 0, got {largest_misfit:g}")
