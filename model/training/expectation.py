"""How accurate a network becomes after so many fresh scenes: the learning curves that were measured."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf, log
from typing import Final

# (samples, MAE over that of predicting no object), by whether the scenes are of one corner and whether the
# training starts from a network that comes with the program. Between two points, and beyond the last, the MAE
# is a power of the samples. At 40 x 30 pixels and 20, 50, 60 MHz with objects of the paper, on 127 scenes
# (notebook/experiments.md, Learning curves of fresh scenes); the points from 393,216 samples on are those of
# `night-40x30`, `any-corner` and an earlier `any-corner-80x60`, by their cards.
CURVES: Final = {
    (True, False): ((8_192, 0.411), (16_384, 0.335), (640_000, 0.159)),
    (True, True): ((2_048, 0.434), (8_192, 0.309), (16_384, 0.266), (640_000, 0.159)),
    (False, False): ((4_096, 1.0), (16_384, 0.572), (655_360, 0.349)),
    (False, True): ((16_384, 0.417), (701_000, 0.334)),
}


_SCENES_PER_S: Final = 100  # of 40 x 30 pixels on two cores, beside other work (notebook/experiments.md)
_SOON, _LATER = 16_384, 262_144  # scenes


def course_sentence(no_object_cm: float, *, one_corner: bool) -> str:
    """How long a training from a network that comes with the program takes, and what MAE it leaves.

    `no_object_cm` is the MAE of predicting no object, cm.
    """
    soon, later = (
        f"{samples / _SCENES_PER_S / 60:.0f} minutes an MAE of about "
        f"{expected_mae_cm(samples, no_object_cm, one_corner=one_corner, start_cm=inf):.1f} cm"
        for samples in (_SOON, _LATER)
    )
    no_object = f"no object: {no_object_cm:.1f} cm"
    return f"a network: after {soon}, after {later}, at 40x30 pixels on two cores ({no_object})"


def expected_mae_cm(
    samples: int, no_object_cm: float, *, one_corner: bool, start_cm: float | None
) -> float | None:
    """The MAE over all pixels that a network probably has after so many fresh scenes, cm.

    None for fewer than were measured.

    Parameters
    ----------
    no_object_cm : that of predicting no object.
    start_cm : of the network that the training starts from; None from new weights.
    """
    curve = CURVES[one_corner, start_cm is not None]
    if samples < curve[0][0]:
        return None
    share = _share(curve, samples)
    return min(share * no_object_cm, no_object_cm if start_cm is None else start_cm)


def _share(points: Sequence[tuple[int, float]], samples: int) -> float:
    """The curve through points, by the last segment that begins before so many samples."""
    (n, share), (later, smaller) = [each for each in pairwise(points) if each[0][0] <= samples][-1]
    exponent = log(share / smaller) / log(later / n)
    return float(share * (n / samples) ** exponent)
