"""The enlarged training set of the paper: every scene without a change, and changed copies, drawn once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from model.data.augmentation import Draws
from model.paper.augmentation import KINDS, UNCHANGED, PaperAugmentation


@dataclass(frozen=True)
class EnlargedSet:
    """S samples: the N training scenes themselves, then `copies` copies of scenes for each kind of change.

    A sample is the same in every epoch, because its random numbers are drawn once; so are its noise of the
    phasors, brightness, reflectance and camera, if these are switched on.

    Attributes
    ----------
    rows : (S,) row of the shards that each sample is made of.
    draws : random numbers of the samples, which have one kind of change each, or none.

    Source: Caligiuri et al. 2024, sec. 4.2 (2833 samples after augmentation); 403 copies of each kind from
    their released code. Which scenes are copied is our choice: all of them before any one a second time.
    """

    rows: tuple[int, ...]
    draws: Draws

    @classmethod
    def of(
        cls, rows: Sequence[int], augmentation: PaperAugmentation, copies: int, generator: torch.Generator
    ) -> EnlargedSet:
        """Samples of `rows`: all of them, and `copies`, at least 1, for each change of `augmentation`."""
        scenes = torch.tensor(rows)
        samples, kinds = [scenes], [torch.full((len(rows),), UNCHANGED)]
        for kind in augmentation.kinds:
            samples.append(scenes[_spread(len(rows), copies, generator)])
            kinds.append(torch.full((copies,), KINDS.index(kind)))
        chosen = torch.cat(samples).tolist()
        draws = replace(Draws.of(len(chosen), generator), kind=torch.cat(kinds))
        return cls(tuple(chosen), draws)

    def draws_in_order(self, order: Sequence[int], generator: torch.Generator) -> Draws:
        """Draws of all samples of an epoch, whose rows come in this order.

        Samples of the same row come in random order.
        """
        waiting: dict[int, list[int]] = defaultdict(list)
        for sample in torch.randperm(len(self.rows), generator=generator).tolist():
            waiting[self.rows[sample]].append(sample)
        return self.draws[[waiting[row].pop() for row in order]]


def _spread(scenes: int, copies: int, generator: torch.Generator) -> Tensor:
    """(copies,) places of scenes in random order, each as often as any other or once more."""
    rounds = [torch.randperm(scenes, generator=generator) for _ in range(-(-copies // scenes))]
    return torch.cat(rounds)[:copies]
