"""Check of every batch's loss; a bad loss is reported with the scenes of its batch."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from disk import NightError

# Upper limit of a sound loss. Initial weights give well below 100, and a depth error of one unambiguous range
# gives 56 m^2 with the squared error.
EXPLODED = 1e4


class LossError(NightError):
    """A loss is not finite or too large."""


class LossWatch:
    """Losses of an epoch's batches, checked several at a time, because each check waits for the GPU.

    Parameters
    ----------
    epoch : number of the epoch, for the error message.
    ids : function from rows to scene ids.
    every : batches between two checks.
    """

    def __init__(self, epoch: int, ids: Callable[[Sequence[int]], list[str]], every: int) -> None:
        self.epoch, self.ids, self.every = epoch, ids, every
        self._losses: list[Tensor] = []
        self._rows: list[tuple[int, ...]] = []

    def add(self, loss: Tensor, rows: Sequence[int]) -> None:
        """Note the loss of a batch; after every `every` batches, `look`."""
        self._losses.append(loss)
        self._rows.append(tuple(rows))
        if len(self._losses) >= self.every:
            self.look()

    def look(self) -> None:
        """Check all losses since the last check; `LossError` if one is bad."""
        losses = torch.stack(self._losses).tolist() if self._losses else []
        for value, rows in zip(losses, self._rows, strict=True):
            if not (math.isfinite(value) and value < EXPLODED):
                scenes = ", ".join(dict.fromkeys(self.ids(rows)))
                raise LossError(f"the loss became {value:.4g} in epoch {self.epoch}, on scenes {scenes}")
        self._losses, self._rows = [], []
