"""What the truth of the training scenes shows: how far away objects are, and how many pixels show one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from disk import NightError
from disk.quantities import FARTHEST_M
from model.data.feed import rows_by_piece
from model.data.shards import Shards

LEAST_SPREAD_M: Final = 0.01  # for scenes whose objects are all equally far


class BalanceError(NightError):
    """Training scenes without object, or without background."""


def object_depth_m(shards: Shards, rows: Sequence[int]) -> tuple[float, float]:
    """Mean and standard deviation, at least `LEAST_SPREAD_M`, of the object's radial depth in scenes, metres.

    Reads one piece of the shards at a time.

    Parameters
    ----------
    rows : rows of the training scenes.

    Raises
    ------
    BalanceError : the scenes have no object pixel, or their objects are too far away.
    """
    count, total, squares = 0, 0.0, 0.0
    for piece in rows_by_piece(rows, shards.manifest.scenes_per_piece):
        block = shards.read(piece)
        depth_m = block.radial_depth_m[block.mask > 0].astype(np.float64)
        count += depth_m.size
        total += float(depth_m.sum())
        squares += float((depth_m**2).sum())
    if not count:
        raise BalanceError(
            f"the ground truth of the {len(rows)} training scenes shows no object: train with "
            "--preset known-wall, or render scenes that show one"
        )
    mean_m = total / count
    if not mean_m <= FARTHEST_M:
        raise BalanceError(
            f"the object of the training scenes is {mean_m:.3g} m away on average, and {FARTHEST_M} m is the "
            "most: is the ground truth in millimetres?"
        )
    return mean_m, max(squares / count - mean_m**2, LEAST_SPREAD_M**2) ** 0.5


def background_per_object(shards: Shards, rows: Sequence[int]) -> float:
    """Background pixels per object pixel of some scenes; reads one piece of the shards at a time.

    Parameters
    ----------
    rows : rows of the training scenes.

    Raises
    ------
    BalanceError : the scenes have no object pixel or no background pixel.

    Source: 30.2 in the training log of the paper's released code.
    """
    object_pixels = pixels = 0
    for piece in rows_by_piece(rows, shards.manifest.scenes_per_piece):
        mask = shards.read(piece).mask  # (n, H, W) uint8, 0 or 1
        object_pixels += int(mask.sum(dtype="int64"))
        pixels += mask.size
    if not 0 < object_pixels < pixels:
        seen = "no background" if object_pixels else "no object"
        raise BalanceError(
            f"the ground truth of the {len(rows)} training scenes shows {seen}: train with "
            "target.balance image, or render scenes that show both"
        )
    return (pixels - object_pixels) / object_pixels
