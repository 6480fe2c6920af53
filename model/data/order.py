"""Order in which an epoch reads the rows: whole pieces of the shards, which suits network disks.

A window is the set of rows that memory holds at once: as many whole pieces as fit, at least one. The pieces
are shuffled and distributed to windows, then the rows are shuffled within each window. If one window holds
all rows, this is a uniform shuffle. The order depends only on the generator and on the arguments.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import torch

_Item = TypeVar("_Item")


def rows_by_piece(rows: Iterable[int], rows_per_piece: int) -> list[list[int]]:
    """Rows grouped by piece, in ascending order of pieces and rows; pieces without rows are left out."""
    pieces: dict[int, list[int]] = {}
    for row in sorted(rows):
        pieces.setdefault(row // rows_per_piece, []).append(row)
    return list(pieces.values())


def windows_in_order(rows: Iterable[int], rows_per_piece: int, window_rows: int) -> list[list[int]]:
    """Windows of at most `window_rows` rows or of one piece, with all rows in ascending order."""
    return _dealt(rows_by_piece(rows, rows_per_piece), window_rows)


def shuffled_windows(
    rows: Sequence[int], rows_per_piece: int, window_rows: int, generator: torch.Generator
) -> list[list[int]]:
    """Windows of at most `window_rows` distinct rows or of one piece, with all rows in random order.

    A row may come more than once; it is in one window then, with its piece.
    """
    if len(set(rows)) <= window_rows:
        return [_shuffled(rows, generator)]
    pieces = _shuffled(rows_by_piece(rows, rows_per_piece), generator)
    return [_shuffled(window, generator) for window in _dealt(pieces, window_rows)]


def without_first(windows: Sequence[list[int]], count: int) -> tuple[Sequence[list[int]], int]:
    """The windows that are left after the first `count` rows, and how many rows of their first are used."""
    for number, window in enumerate(windows):
        if count < len(window):
            return windows[number:], count
        count -= len(window)
    return [], 0


def _dealt(pieces: Iterable[list[int]], window_rows: int) -> list[list[int]]:
    windows: list[list[int]] = []
    held = 0  # distinct rows of the last window
    for piece in pieces:
        count = len(set(piece))
        if windows and held + count <= window_rows:
            windows[-1] += piece
            held += count
        else:
            windows.append(list(piece))
            held = count
    return windows


def _shuffled(items: Sequence[_Item], generator: torch.Generator) -> list[_Item]:
    return [items[i] for i in torch.randperm(len(items), generator=generator).tolist()]
