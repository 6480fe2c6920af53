"""Mean and spread of the hidden object's depth in the training scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.data.class_balance import BalanceError
from model.data.order import rows_by_piece
from model.data.shards import Shards


def object_depth_m(shards: Shards, rows: Sequence[int]) -> tuple[float, float]:
    """Mean and standard deviation of the radial depth of all object pixels of some scenes, metres.

    Reads one piece of the shards at a time.

    Parameters
    ----------
    rows : rows of the training scenes.

    Raises
    ------
    BalanceError : the scenes have no object pixel, or all of them have the same depth.
    """
    count, total, squares = 0, 0.0, 0.0
    for piece in rows_by_piece(rows, shards.manifest.scenes_per_piece):
        block = shards.read(piece)
        depth_m = block.radial_depth_m[block.mask > 0].astype(np.float64)
        count += depth_m.size
        total += float(depth_m.sum())
        squares += float((depth_m**2).sum())
    mean_m = total / max(count, 1)
    variance = squares / max(count, 1) - mean_m**2
    if not variance > 0:
        raise BalanceError(
            f"the ground truth of the {len(rows)} training scenes shows no object, or one at a single depth: "
            "train with --target components, or render scenes that show more"
        )
    return mean_m, variance**0.5
