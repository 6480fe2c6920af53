"""Numbers of object and background pixels of the training scenes."""

from __future__ import annotations

from collections.abc import Sequence

from model.data.feed import rows_by_piece
from model.data.object_depth import BalanceError
from model.data.shards import Shards


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
