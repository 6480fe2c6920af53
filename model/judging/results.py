"""Results of an evaluation: metrics of every scene, their statistics, and the numbers of the paper."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from disk.counted import counted
from disk.told import Told
from itof.metrics import Statistics, Summary
from model.judging.calibration import Calibration
from model.judging.groups import GroupTable
from model.judging.reliability import DepthReliability, Reliability
from model.judging.scene_result import SceneResult
from scenegen import Split

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER_RELATIVE_MAE = (0.01, 0.02)  # about; of a mean distance of about 3 m
PAPER = {
    "source": "Caligiuri et al. 2024 (arXiv 2403.19376), on their own data set",
    "depth_mae_m": {"mean": 0.0521, "std": 0.0284, "min": 0.0114, "max": 0.1870},
    "relative_mae": dict(zip(("from", "to"), PAPER_RELATIVE_MAE, strict=True)),
    "miou": {"mean": 0.77, "std": 0.12, "min": 0.48, "max": 0.95},
}
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


class Measure(NamedTuple):
    """A metric for readers: its field in `Summary`, its name, and the factor to the unit in the name."""

    field: str
    name: str
    scale: float


MEASURES = (
    Measure("depth_mae_m", "MAE over all pixels, cm", 100.0),
    Measure("object_mae_m", "MAE on the object, cm", 100.0),
    Measure("object_iou", "object IoU", 1.0),
    Measure("miou", "mIoU", 1.0),
    Measure("accuracy", "accuracy", 1.0),
)
BY_DISTANCE = Measure("relative_mae", "MAE / object distance, %", 100.0)
ROUNDNESS = Measure("roundness", "roundness of the mask", 1.0)
EXPLAINED = Measure("explained_light", "explained hidden light, %", 100.0)


@dataclass(frozen=True, repr=False)
class Report(Told):
    """Results of an evaluation.

    Attributes
    ----------
    split : the judged split.
    scenes : results of its scenes, in scene order.
    prediction, no_object : statistics over these scenes, of the network and of the baseline "no object".
    groups : averages by shape, roughness, position and size.
    calibration : averages for other mask thresholds, and the threshold of the evaluation.
    reliability : of the probabilities; None if the network predicts none.
    depth_reliability : of the expected errors of the depth; None if it expects none, or finds no object.
    unlike_training : what the scenes have that the training had not (`model.judging.other_corner`).
    frame_rate_hz : of a sequence, whose frames the scenes are; None for other datasets.
    """

    split: Split
    scenes: tuple[SceneResult, ...]
    prediction: Summary
    no_object: Summary
    groups: tuple[GroupTable, ...]
    calibration: Calibration
    reliability: Reliability | None = None
    depth_reliability: DepthReliability | None = None
    unlike_training: tuple[str, ...] = ()
    frame_rate_hz: float | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The main numbers, and the warnings."""
        ours, nothing = (
            f"{100 * each.depth_mae_m.mean:.2f} cm, mIoU {each.miou.mean:.3f}"
            for each in (self.prediction, self.no_object)
        )
        scenes = counted(len(self.scenes), "scene")
        return (f"{scenes} of the split {self.split}: MAE {ours} (no object: {nothing})", *self.warnings)

    def plot(self) -> Figure:
        """Histograms of MAE, mIoU and accuracy of the scenes, with those of "no object" behind them."""
        import matplotlib.pyplot as plt

        measures = [each for each in MEASURES if each.field in ("depth_mae_m", "miou", "accuracy")]
        figure, places = plt.subplots(1, len(measures), figsize=(11, 3), layout="constrained")
        for axes, measure in zip(places, measures, strict=True):
            kinds = {"no object": "0.7", "prediction": "C0"}
            values = [
                [measure.scale * getattr(metrics, measure.field) for metrics in side]
                for side in zip(*((each.no_object, each.prediction) for each in self.scenes), strict=True)
            ]
            edges = np.histogram_bin_edges(values, 24)
            for one, (name, colour) in zip(values, kinds.items(), strict=True):
                axes.hist(one, edges.tolist(), color=colour, alpha=0.75, label=name)
            axes.set(xlabel=measure.name, ylabel="scenes")
        places[0].legend()
        return figure

    def seconds(self, result: SceneResult) -> float:
        """Time of a frame of a sequence, from the first on; 0 where the scenes are none."""
        return int(result.scene) / self.frame_rate_hz if self.frame_rate_hz else 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know before any number, as sentences."""
        ours_m, nothing_m = self.prediction.depth_mae_m.mean, self.no_object.depth_mae_m.mean
        if ours_m < nothing_m:
            return self.unlike_training
        useless = (
            f"the network is no better than predicting no object: its MAE is {100 * ours_m:.1f} cm, that "
        )
        return (*self.unlike_training, f"{useless}of no object {100 * nothing_m:.1f} cm")

    @property
    def ranked(self) -> list[SceneResult]:
        """The scenes by accuracy, the best first."""
        return sorted(self.scenes, key=lambda result: -result.prediction.accuracy)

    @property
    def expected_mae_m(self) -> Statistics | None:
        """MAE that the network expects of the scenes, metres; None if it predicts no probabilities."""
        return _present([scene.expected_mae_m for scene in self.scenes])

    @property
    def explained_light(self) -> Statistics | None:
        """Share of the hidden light that the predictions explain; None without residual channels."""
        return _present([scene.explained_light for scene in self.scenes])

    @property
    def accuracy_histogram(self) -> AccuracyHistogram:
        """The scenes by accuracy, in the bins of the paper's plot."""
        return accuracy_histogram(self.scenes)

    @property
    def object_distance_m(self) -> Statistics | None:
        """Mean distance of the true object, metres, over the scenes that show one; None if none does."""
        return _present([scene.object_distance_m for scene in self.scenes])

    @property
    def relative_mae(self) -> dict[str, Statistics | None]:
        """`SceneResult.by_distance` of the prediction and of "no object", over these scenes."""
        return {
            "prediction": _present([scene.by_distance(scene.prediction) for scene in self.scenes]),
            "no_object": _present([scene.by_distance(scene.no_object) for scene in self.scenes]),
        }

    @property
    def roundness_pairs(self) -> list[tuple[float, float]]:
        """`disc_iou` of prediction and truth, for each scene in which both show an object."""
        return [
            (scene.roundness_pred, scene.roundness_gt)
            for scene in self.scenes
            if scene.roundness_pred is not None and scene.roundness_gt is not None
        ]

    @property
    def roundness(self) -> dict[str, Statistics | None]:
        """Statistics of `roundness_pairs`: of the prediction, of the truth, and of prediction - truth."""
        pairs = self.roundness_pairs
        return {
            "prediction": _present([ours for ours, _ in pairs]),
            "truth": _present([truth for _, truth in pairs]),
            "difference": _present([ours - truth for ours, truth in pairs]),
        }

    @property
    def table(self) -> str:
        """The summary as text, with baseline and paper."""
        head = f"{self.split} split, {counted(len(self.scenes), 'scene')}, radial depth"
        lines = [f"{head:<44}{'average':>9}{'std':>9}{'min':>9}{'max':>9}"]
        for measure, who, statistics in self.lines():
            lines.append(f"{f'{measure.name:<26}{who}':<44}" + "".join(f"{v:>9}" for v in statistics))
        if not self.calibration.is_of_run:
            lines.append(self.calibration.judged_with)
        return "\n".join(lines)

    def lines(self) -> Iterator[tuple[Measure, str, list[str]]]:
        """Lines of the summary: measure, source of the numbers, and average, std, min and max as text."""
        for measure in MEASURES:
            for who, summary in (("prediction", self.prediction), ("no object", self.no_object)):
                yield measure, who, _texts(getattr(summary, measure.field), measure.scale)
            paper = PAPER.get(measure.field)
            if isinstance(paper, dict):
                yield measure, "paper, own data", _texts(Statistics(**paper, count=0), measure.scale)
            if measure.field == "depth_mae_m":
                if self.expected_mae_m:
                    yield measure, "expected by the network", _texts(self.expected_mae_m, measure.scale)
                yield from self._by_distance()

        if self.explained_light:
            yield EXPLAINED, "prediction", _texts(self.explained_light, EXPLAINED.scale)
        whose = ("prediction", "truth", "prediction - truth")
        for who, statistics in zip(whose, self.roundness.values(), strict=True):
            yield ROUNDNESS, who, _texts(statistics, ROUNDNESS.scale)

    def _by_distance(self) -> Iterator[tuple[Measure, str, list[str]]]:
        for who, statistics in zip(("prediction", "no object"), self.relative_mae.values(), strict=True):
            yield BY_DISTANCE, who, _texts(statistics, BY_DISTANCE.scale)
        low, high = (BY_DISTANCE.scale * part for part in PAPER_RELATIVE_MAE)
        yield BY_DISTANCE, "paper, own data", [f"{low:g} to {high:g}", "-", "-", "-"]


def scene_numbers(result: SceneResult) -> dict[str, str | float | None]:
    """One line of ``metrics.csv``; lengths in metres."""
    return {
        "scene": result.scene,
        "object_class": result.object_class,
        "composite": int(result.is_composite),
        "roughness": result.roughness,
        **dict(zip(("x_m", "y_m", "z_m"), result.location_m or (None,) * 3, strict=True)),
        "object_pixels": result.object_pixels,
        "object_distance_m": result.object_distance_m,
        **asdict(result.prediction),
        "miou": result.prediction.miou,
        "accuracy": result.prediction.accuracy,
        "relative_mae": result.by_distance(result.prediction),
        "roundness_gt": result.roundness_gt,
        "roundness_pred": result.roundness_pred,
        "no_object_mae_m": result.no_object.depth_mae_m,
        "expected_mae_m": result.expected_mae_m,
        "explained_light": result.explained_light,
    }


def _present(values: Sequence[float | None]) -> Statistics | None:
    """Statistics of the values that are there; None if none is."""
    there = [value for value in values if value is not None]
    return Statistics.of(there) if there else None


def _texts(statistics: Statistics | None, scale: float) -> list[str]:
    if statistics is None:
        return ["-"] * 4
    values = (statistics.mean, statistics.std, statistics.min, statistics.max)
    return [f"{scale * value:.3f}" for value in values]
