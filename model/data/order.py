"""In what order an epoch goes over the rows, so that a network disk reads pieces whole and in one go.

A window is what is in memory at once: whole pieces of the shards, as many as fit, at least one. Rows are
shuffled within their window and the pieces before they are dealt to windows. When one window takes all
rows, that is a uniform shuffle. The order depends on the generator and on these arguments alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

import torch

_Item = TypeVar("_Item")


def rows_by_piece(rows: Iterable[int], rows_per_piece: int) -> list[list[int]]:
    """Rows of each piece that has any, in ascending order of pieces and rows."""
    pieces: dict[int, list[int]] = {}
    for row in sorted(rows):
        pieces.setdefault(row // rows_per_piece, []).append(row)
    return list(pieces.values())


def windows_in_order(rows: Iterable[int], rows_per_piece: int, window_rows: int) -> list[list[int]]:
    """All rows in ascending order, cut into windows of at most `window_rows` rows or of one piece."""
    return _dealt(rows_by_piece(rows, rows_per_piece), window_rows)


def shuffled_windows(
    rows: Sequence[int], rows_per_piece: int, window_rows: int, generator: torch.Generator
) -> list[list[int]]:
    """All rows in random order, cut into windows of at most `window_rows` rows or of one piece."""
    if len(rows) <= window_rows:
        return [_shuffled(rows, generator)]
    pieces = _shuffled(rows_by_piece(rows, rows_per_piece), generator)
    return [_shuffled(window, generator) for window in _dealt(pieces, window_rows)]


def without_first(windows: Iterable[list[int]], count: int) -> list[list[int]]:
    """Windows without their first `count` rows; what is left keeps its order."""
    left: list[list[int]] = []
    for window in windows:
        kept = window[count:]
        count = max(0, count - len(window))
        if kept:
            left.append(kept)
    return left


def _dealt(pieces: Iterable[list[int]], window_rows: int) -> list[list[int]]:
    windows: list[list[int]] = []
    for piece in pieces:
        if windows and len(windows[-1]) + len(piece) <= window_rows:
            windows[-1] += piece
        else:
            windows.append(list(piece))
    return windows


def _shuffled(items: Sequence[_Item], generator: torch.Generator) -> list[_Item]:
    return [items[i] for i in torch.randperm(len(items), generator=generator).tolist()]
