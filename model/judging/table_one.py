"""Numbers that the paper gives around its Table 1: the histogram of accuracy and the error by distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.judging.scene_result import SceneResult

# Caligiuri et al. 2024, Table 1: the bars of the plot beside it, from the numbers in its source.
PAPER_ACCURACY_FROM, PAPER_ACCURACY_TO = 0.670855179429054, 0.967640747316182
PAPER_ACCURACY_COUNTS = (2, 6, 2, 5, 2, 2, 8, 8, 14, 15, 20, 17, 12, 12, 9)


@dataclass(frozen=True)
class AccuracyHistogram:
    """Numbers of scenes by accuracy, in the bins of the paper's plot.

    Attributes
    ----------
    edges : (n + 1,) ends of the bins.
    counts, paper_counts : (n,) scenes in the bins, ours and the paper's.
    below, above : our scenes outside all bins.
    """

    edges: tuple[float, ...]
    counts: tuple[int, ...]
    paper_counts: tuple[int, ...]
    below: int
    above: int

    @property
    def shares(self) -> tuple[float, ...]:
        """(n,) parts of all our scenes, also of those outside the bins."""
        return tuple(count / (sum(self.counts) + self.below + self.above) for count in self.counts)

    @property
    def paper_shares(self) -> tuple[float, ...]:
        """(n,) parts of all of the paper's scenes."""
        return tuple(count / sum(self.paper_counts) for count in self.paper_counts)

    @property
    def paper_mean(self) -> float:
        """Mean accuracy of the paper's scenes, each at the middle of its bin."""
        middles = (np.array(self.edges[:-1]) + self.edges[1:]) / 2
        return float(np.average(middles, weights=self.paper_counts))


def accuracy_histogram(scenes: Sequence[SceneResult]) -> AccuracyHistogram:
    """Scenes by accuracy in the paper's 15 bins; the last bin includes its upper end."""
    values = np.array([scene.prediction.accuracy for scene in scenes])
    edges = np.linspace(PAPER_ACCURACY_FROM, PAPER_ACCURACY_TO, len(PAPER_ACCURACY_COUNTS) + 1)
    return AccuracyHistogram(
        edges=tuple(edges.tolist()),
        counts=tuple(np.histogram(values, edges)[0].tolist()),
        paper_counts=PAPER_ACCURACY_COUNTS,
        below=int(np.count_nonzero(values < edges[0])),
        above=int(np.count_nonzero(values > edges[-1])),
    )
