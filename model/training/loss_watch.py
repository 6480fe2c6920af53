"""Watching the loss of every batch: one that is no number, or explodes, names its scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from scenegen import NightError

# Predicting nothing costs 1 at most, a depth of one turn too much 56 squared metres; He's initial weights
# are well below 100.
EXPLODED = 1e4


class LossError(NightError):
    """A loss that is no number or exploded."""


class LossWatch:
    """Losses of an epoch's batches, looked at a few at a time: each look waits for the GPU.

    Parameters
    ----------
    epoch : for the error.
    ids : scene ids of rows.
    every : batches between two looks.
    """

    def __init__(self, epoch: int, ids: Callable[[Sequence[int]], list[str]], every: int) -> None:
        self.epoch, self.ids, self.every = epoch, ids, every
        self._losses: list[Tensor] = []
        self._rows: list[tuple[int, ...]] = []

    def add(self, loss: Tensor, rows: Sequence[int]) -> None:
        """Note a batch's loss; `LossError` when it is time to look and one of those noted is bad."""
        self._losses.append(loss)
        self._rows.append(tuple(rows))
        if len(self._losses) >= self.every:
            self.look()

    def look(self) -> None:
        """Look at all losses that were noted since the last look."""
        losses = torch.stack(self._losses).tolist() if self._losses else []
        for value, rows in zip(losses, self._rows, strict=True):
            if not (math.isfinite(value) and value < EXPLODED):
                scenes = ", ".join(self.ids(rows))
                raise LossError(f"the loss became {value:.4g} in epoch {self.epoch}, on scenes {scenes}")
        self._losses, self._rows = [], []
