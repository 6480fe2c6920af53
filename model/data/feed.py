"""Batches of a split: held in memory if all of it fits, else streamed from the disk piece by piece.

An epoch reads whole pieces of the shards, which suits network disks. A window is the set of rows that memory
holds at once: as many whole pieces as fit, at least one. The pieces are shuffled and distributed to windows,
then the rows are shuffled within each window. If one window holds all rows, this is a uniform shuffle. The
order depends only on the generator and on the arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

from disk.machine_memory import machine_bytes
from model.data.rows import RowBlock
from model.data.shards import Shards

_Item = TypeVar("_Item")
MEMORY_PART = 0.25  # of the memory of machine or GPU, for the rows of one split


def _as_read(block: RowBlock) -> RowBlock:
    return block


class Feed:
    """Delivers the rows of a split in batches.

    If `window_rows` covers all rows, they are read and prepared once and stay in memory. Otherwise a thread
    reads the next window while the current one is used. It reads each piece of the shards once per epoch and
    as a whole. A batch may contain rows of two windows.

    For a GPU, the thread also prepares the next window. On the CPU, this would be slower than to prepare it
    when its turn comes: the arithmetic of both threads would wait for the same cores.

    Attributes
    ----------
    rows : rows of the shards, one for each sample of an epoch; a row that comes more than once is held once.
    window_rows : rows that are held at once; a window holds the rows of at least one piece.

    Parameters
    ----------
    prepare : applied to every block after it is read, for example to copy it to a GPU.
    prepares_ahead : whether the thread that reads the next window also prepares it.
    """

    def __init__(
        self,
        shards: Shards,
        rows: Sequence[int],
        window_rows: int,
        prepare: Callable[[RowBlock], RowBlock] = _as_read,
        *,
        prepares_ahead: bool = False,
    ) -> None:
        self.rows, self.window_rows = list(rows), window_rows
        self.distinct_rows = sorted(set(self.rows))
        self._shards, self._per_piece = shards, shards.manifest.scenes_per_piece
        self._prepare, self._prepares_ahead = prepare, prepares_ahead
        self._held: RowBlock | None = None

    @property
    def is_resident(self) -> bool:
        """Whether all rows stay in memory."""
        return len(self.distinct_rows) <= self.window_rows

    def hold(self) -> None:
        """Read and prepare all rows, if they stay in memory and this has not been done."""
        if self.is_resident and self._held is None:
            self._held = self._prepare(self._shards.read(self.distinct_rows))

    def first(self, count: int) -> RowBlock:
        """The first `count` rows, prepared, or all if there are fewer."""
        rows = self.distinct_rows[:count]
        self.hold()
        return self._prepare(self._shards.read(rows)) if self._held is None else self._held.take(rows)

    def shuffled_windows(self, generator: torch.Generator) -> list[list[int]]:
        """All `rows` in random order, in the windows in which `in_windows` reads them."""
        return shuffled_windows(self.rows, self._per_piece, self.window_rows, generator)

    def in_windows(
        self, windows: Sequence[list[int]], batch_size: int, *, skip: int = 0
    ) -> Iterator[RowBlock]:
        """Batches of the rows of `windows`, in their order.

        The first `skip` batches are not delivered; a resumed epoch used them before. A window that is used in
        part is prepared as a whole, because the rounding of a row can depend on the rows beside it.
        """
        left, used = without_first(windows, skip * batch_size)
        return _batches(self._blocks(left), batch_size, used)

    def epoch(
        self, number: int, generator: torch.Generator, batch_size: int, skip: int
    ) -> tuple[Sequence[int], Iterator[RowBlock]]:
        """The rows of an epoch in random order, and its batches without the first `skip`."""
        windows = self.shuffled_windows(generator)
        order = [row for window in windows for row in window]
        return order, self.in_windows(windows, batch_size, skip=skip)

    def in_order(self, batch_size: int) -> Iterator[RowBlock]:
        """Batches with every row once, in ascending order."""
        windows = windows_in_order(self.distinct_rows, self._per_piece, self.window_rows)
        return self.in_windows(windows, batch_size)

    def _blocks(self, windows: Sequence[list[int]]) -> Iterator[tuple[list[int], RowBlock]]:
        """The rows of each window in order, and a block that holds them."""
        self.hold()
        if self._held is not None:
            held = self._held
            yield from ((window, held) for window in windows)
            return
        ahead, later = (self._prepare, _as_read) if self._prepares_ahead else (_as_read, self._prepare)
        yield from _read_ahead(lambda rows: ahead(self._shards.read(sorted(set(rows)))), later, windows)


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


def window_rows(
    shards: Shards,
    row_count: int,
    memory_bytes: int | None = None,
    device: torch.device = torch.device("cpu"),  # noqa: B008  (immutable)
    sharers: int = 1,
    added_bytes: int = 0,
) -> int:
    """Number of rows to hold at once.

    All `row_count` rows if they fit into memory, else as many as fit into half of it. The other half is for
    the window that is read ahead.

    Parameters
    ----------
    memory_bytes : memory for the rows; None for MEMORY_PART of the memory of machine or GPU.
    device : device that holds the rows.
    sharers : number of processes that share the machine's memory.
    added_bytes : memory that the preparation of a row adds to it.
    """
    allowed = int(MEMORY_PART * memory_of(device, sharers)) if memory_bytes is None else memory_bytes
    row_bytes = shards.manifest.layout.row_bytes + added_bytes
    windows = 2  # the current one and the next
    return row_count if row_count * row_bytes <= allowed else allowed // (windows * row_bytes)


def memory_of(device: torch.device, sharers: int = 1) -> int:
    """Memory in which rows can be held, bytes.

    A process has its share of the machine's memory. Rows on a GPU also pass through that memory, so the limit
    is the smaller of the two.
    """
    share = machine_bytes() // sharers
    if device.type == "cpu":
        return share
    return min(share, torch.cuda.get_device_properties(device).total_memory)


def _read_ahead(
    read: Callable[[list[int]], RowBlock],
    prepare: Callable[[RowBlock], RowBlock],
    windows: Sequence[list[int]],
) -> Iterator[tuple[list[int], RowBlock]]:
    """Each window and its prepared block; a thread reads the next block while one is prepared and used."""
    if not windows:
        return
    with ThreadPoolExecutor(1, "shards") as pool:
        ahead = pool.submit(read, windows[0])
        for index, window in enumerate(windows):
            block = ahead.result()
            if index + 1 < len(windows):
                ahead = pool.submit(read, windows[index + 1])
            block = prepare(block)
            yield window, block
            del block  # otherwise three windows would be in memory


def _batches(windows: Iterable[tuple[list[int], RowBlock]], size: int, used: int) -> Iterator[RowBlock]:
    """Divide windows, without the first `used` rows, into batches of `size`; the last one may have fewer."""
    begun: RowBlock | None = None
    for order, block in windows:
        start, used = used, 0
        while start < len(order):
            end = start + size - (len(begun) if begun else 0)
            part = block.take(order[start:end])
            begun = part if begun is None else begun.joined(part)
            start = end
            if len(begun) == size:
                yield begun
                begun = None
    if begun is not None:
        yield begun


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
