"""Batches of fresh scenes, in the order of the stream, for any number of workers and after a resume."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import torch

from model.data.rows import RowBlock
from model.training.fresh.workers import FreshWorkers
from model.training.processes import Processes

_PIXELS_AT_ONCE: Final = 2**20  # of the images that a worker renders at once
_SCENES_AT_ONCE: Final = 1024


def scenes_at_once(pixels: int, batch_size: int) -> int:
    """How many scenes with images of so many pixels a worker renders at once; whole batches."""
    return batch_size * max(1, min(_PIXELS_AT_ONCE // pixels, _SCENES_AT_ONCE) // batch_size)


@dataclass(frozen=True)
class FreshBatch:
    """A batch of which this process has its own rows only.

    Attributes
    ----------
    rows : numbers of all scenes of the batch in the stream.
    own : rows of this process.
    """

    rows: Sequence[int]
    own: RowBlock

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: Sequence[int]) -> RowBlock:
        """Some of this process's rows."""
        return self.own.take(rows)


class FreshFeed:
    """Delivers a stream of scenes in batches; an epoch is a number of scenes, none of which comes again.

    It has the part of `model.data.feed.Feed` that a training needs.

    Attributes
    ----------
    rows : as many as an epoch has scenes.
    """

    window_rows = 0

    def __init__(
        self,
        workers: FreshWorkers,
        epoch_scenes: int,
        epochs: int,
        pixels: int,
        prepare: Callable[[RowBlock], RowBlock],
        processes: Processes,
    ) -> None:
        self.rows = range(epoch_scenes)
        self._waited_s = self._used_s = 0.0
        self.distinct_rows: Sequence[int] = ()
        self._workers, self._epochs, self._pixels = workers, epochs, pixels
        self._prepare, self._processes = prepare, processes
        self._batches: Iterator[FreshBatch] | None = None

    @property
    def waiting_share(self) -> float:
        """Share of the training's time in which it waited for scenes; near 0, the workers wait for it."""
        return self._waited_s / max(self._waited_s + self._used_s, 1e-9)

    def hold(self) -> None:
        """Nothing is held."""

    def close(self) -> None:
        """End the workers."""
        self._workers.close()
        self._batches = None

    def epoch(
        self, number: int, generator: torch.Generator, batch_size: int, skip: int
    ) -> tuple[Sequence[int], Iterator[FreshBatch]]:
        """Scenes of epoch `number`, the first of which is 1, and its batches without the first `skip`.

        Epochs must be taken in order, each to its end. `generator` is not used.
        """
        count = len(self.rows)
        order = range((number - 1) * count, number * count)
        self._batches = self._batches or self._from(number, skip, batch_size)
        return order, self._of_epoch(self._batches, -(-count // batch_size) - skip)

    def _of_epoch(self, batches: Iterator[FreshBatch], count: int) -> Iterator[FreshBatch]:
        for _ in range(count):
            began = time.monotonic()
            batch = next(batches)
            got = time.monotonic()
            yield batch
            self._waited_s += got - began
            self._used_s += time.monotonic() - got

    def _from(self, epoch: int, skip: int, batch_size: int) -> Iterator[FreshBatch]:
        """All batches from a place in the stream, each from scenes that a worker renders at once."""
        batches = list(self._all_batches(epoch, skip, batch_size))
        own = len(self._processes.share(batches[0]))
        at_once = scenes_at_once(self._pixels, own) // own
        groups = [batches[start : start + at_once] for start in range(0, len(batches), at_once)]
        work = ([row for batch in group for row in self._processes.share(batch)] for group in groups)
        for group, block in zip(groups, self._workers.results(work), strict=True):
            rows = self._prepare(block)
            for batch in group:
                yield FreshBatch(batch, rows)

    def _all_batches(self, epoch: int, skip: int, batch_size: int) -> Iterator[range]:
        count = len(self.rows)
        for number in range(epoch - 1, self._epochs):
            begin, end = number * count, (number + 1) * count
            for start in range(begin + (skip * batch_size if number == epoch - 1 else 0), end, batch_size):
                yield range(start, min(start + batch_size, end))
