"""The report's charts as plain data: distributions, mask thresholds and training curves.

``chart_png.py`` draws them as PNG files and ``data/report/charts.js`` draws them in the page, so that every
number and every label is written once, here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from itof.metrics import ImageMetrics
from model.judging.calibration import Calibration, ThresholdCurve
from model.judging.reliability import BINS
from model.judging.results import Report
from model.run_folder.history import kept_epoch

Colour = Literal["text", "baseline", "prediction", "truth"]  # CSS variables of the page
History = Mapping[str, Sequence[float]]
BIN_COUNT = 24


@dataclass(frozen=True)
class Bars:
    """A histogram: `counts` (n,), numbers or percentages, in the bins between `edges` (n + 1,)."""

    name: str
    colour: Colour
    edges: tuple[float, ...]
    counts: tuple[float, ...]


@dataclass(frozen=True)
class Curve:
    """Points (x, y): joined by a line, joined and with a dot each, or alone as dots (`points`) or rings.

    Attributes
    ----------
    name : in the legend; "" for none there.
    y : None where there is no finite number.
    """

    name: str
    colour: Colour
    x: tuple[float, ...]
    y: tuple[float | None, ...]
    style: Literal["line", "dots", "points", "rings"] = "line"
    width_pt: float = 1.5


@dataclass(frozen=True)
class Upright:
    """A vertical line at `x` over the full height; without `name` it is not in the legend."""

    name: str
    colour: Colour
    x: float
    dash: Literal["dash", "dot"]


@dataclass(frozen=True)
class Chart:
    """One chart; its parts are drawn one over the other, the last on top.

    Attributes
    ----------
    name : of its PNG file, and of its box in the page.
    whole_x, whole_y : the axis counts something, so it has ticks at whole numbers only.
    """

    name: str
    x_label: str
    y_label: str
    parts: tuple[Bars | Curve | Upright, ...]
    whole_x: bool = False
    whole_y: bool = False

    @property
    def description(self) -> str:
        """The chart in words, for readers who do not see it."""
        names = "; ".join(part.name for part in self.parts if part.name)
        return f"Chart of {self.y_label} against {self.x_label}" + (f": {names}" if names else "")

    def as_data(self) -> dict[str, Any]:
        """What JSON can hold of it; each part says its kind."""
        parts = [{"kind": type(part).__name__.lower(), **asdict(part)} for part in self.parts]
        return {**asdict(self), "parts": parts}


def distributions(report: Report) -> tuple[Chart, ...]:
    """Histograms of MAE, mIoU and accuracy, and of accuracy in the bins of the paper, with its numbers.

    The first three have those of "no object" behind them.
    """
    ours, nothing = [r.prediction for r in report.scenes], [r.no_object for r in report.scenes]
    return (
        _histogram("mae_histogram", "MAE over all pixels, cm", _cm(ours), _cm(nothing)),
        _histogram("miou_histogram", "mIoU", [m.miou for m in ours], [m.miou for m in nothing]),
        _histogram(
            "accuracy_histogram", "accuracy", [m.accuracy for m in ours], [m.accuracy for m in nothing]
        ),
        _beside_paper(report),
    )


def sequence_charts(report: Report) -> tuple[Chart, ...]:
    """MAE and object IoU of the frames of a sequence against time; none for other datasets."""
    if report.frame_rate_hz is None:
        return ()
    times_s = tuple(report.seconds(scene) for scene in report.scenes)
    errors: list[tuple[str, Colour, list[float | None]]] = [
        ("no object", "baseline", [scene.no_object.depth_mae_m for scene in report.scenes]),
        ("expected by the network", "truth", [scene.expected_mae_m for scene in report.scenes]),
        ("prediction", "prediction", [scene.prediction.depth_mae_m for scene in report.scenes]),
    ]
    overlaps = tuple(scene.prediction.object_iou for scene in report.scenes)
    lines = tuple(
        Curve(name, colour, times_s, tuple(None if m is None else 100 * m for m in values))
        for name, colour, values in errors
        if any(m is not None for m in values)
    )
    return (
        Chart("mae_over_time", "time, s", "MAE over all pixels, cm", lines),
        Chart("iou_over_time", "time, s", "object IoU", (Curve("", "prediction", times_s, overlaps),)),
    )


def roundness_chart(report: Report) -> Chart:
    """Roundness of the predicted mask against that of the true one, for the scenes that have both."""
    pairs = report.roundness_pairs
    ours, truth = (tuple(pair[side] for pair in pairs) for side in (0, 1))
    least = min((*ours, *truth), default=0.0)
    equal = "as round as the truth" if pairs else "no scene in which both show an object"
    parts = [Curve(equal, "baseline", (least, 1.0), (least, 1.0), width_pt=1.2)]
    if pairs:
        parts.append(Curve(f"{len(pairs)} scenes", "prediction", truth, ours, "points"))
        parts.append(Curve("mean", "truth", (float(np.mean(truth)),), (float(np.mean(ours)),), "rings"))
    x_label, y_label = (f"roundness of the {whose} mask" for whose in ("true", "predicted"))
    return Chart("roundness", x_label, y_label, tuple(parts))


def uncertainty_charts(report: Report) -> tuple[Chart, ...]:
    """Observed against predicted probability, and the error of each scene against the one that was expected.

    None for a network without probabilities.
    """
    reliability = report.reliability
    if reliability is None:
        return ()
    pairs = [(s.expected_mae_m or 0.0, s.prediction.depth_mae_m) for s in report.scenes]
    expected, actual = (tuple(100 * pair[side] for pair in pairs) for side in (0, 1))
    probabilities = (reliability.predicted, reliability.observed)
    return (
        Chart(
            "reliability",
            "predicted probability of an object pixel",
            "part that shows the object",
            (
                Curve("as predicted", "baseline", (0.0, 1.0), (0.0, 1.0), width_pt=1.2),
                Curve(f"pixels in {BINS} bins", "prediction", *probabilities, "dots"),
            ),
        ),
        _against_expected(
            *("expected_mae", "MAE that the network expects, cm", "MAE over all pixels, cm"),
            Curve(f"{len(pairs)} scenes", "prediction", expected, actual, "points"),
            (float(np.mean(expected)), float(np.mean(actual))),
        ),
    )


def depth_error_charts(report: Report) -> tuple[Chart, ...]:
    """Actual against expected error of the depth of object pixels; none for a network that expects none."""
    found = report.depth_reliability
    if found is None:
        return ()
    expected, actual = (tuple(100 * m for m in values) for values in (found.expected_m, found.actual_m))
    mean_expected_m, mean_actual_m = found.means_m
    chart = _against_expected(
        *("depth_error", "expected error of the depth, cm", "mean error of the depth, cm"),
        Curve(f"{sum(found.pixels)} object pixels in bins", "prediction", expected, actual, "dots"),
        (100 * mean_expected_m, 100 * mean_actual_m),
    )
    return (chart,)


def calibration_curves(calibration: Calibration) -> tuple[Chart, ...]:
    """Mean mIoU and mean MAE against the mask threshold."""
    return (
        _sweep("calibration_miou", "mean mIoU", calibration, "miou", 1.0),
        _sweep("calibration_mae", "mean MAE over all pixels, cm", calibration, "depth_mae_m", 100.0),
    )


def training_curves(history: History) -> tuple[Chart, ...]:
    """Losses, validation MAE and mIoU by epoch, the epoch of the kept weights marked; none without epochs.

    Parameters
    ----------
    history : columns of ``history.csv``; a chart whose columns are missing is left out.
    """
    losses: dict[str, tuple[str, Colour]] = {
        "train_loss": ("training", "truth"),
        "validation_loss": ("validation", "prediction"),
    }
    wanted: dict[str, tuple[str, dict[str, tuple[str, Colour]]]] = {
        "training_loss": ("loss", losses),
        "training_mae": ("validation MAE, cm", {"validation_mae_cm": ("", "prediction")}),
        "training_miou": ("validation mIoU", {"validation_miou": ("", "prediction")}),
    }
    kept = None
    if history.get("epoch") and history.get("validation_loss"):
        validation = history["validation_loss"]
        uncertainty = history.get("validation_uncertainty") or [0.0] * len(validation)
        kept = history["epoch"][kept_epoch(validation, uncertainty)]
    return tuple(
        _epochs(name, label, history, lines, kept)
        for name, (label, lines) in wanted.items()
        if history.get("epoch") and all(history.get(column) for column in lines)
    )


def _against_expected(
    name: str, x_label: str, y_label: str, errors: Curve, mean: tuple[float, float]
) -> Chart:
    """Actual errors against expected ones, with the line on which both are equal and their mean."""
    most = max(0.0, *(value for value in (*errors.x, *errors.y) if value is not None))
    parts = (
        Curve("as expected", "baseline", (0.0, most), (0.0, most), width_pt=1.2),
        errors,
        Curve("mean", "truth", (mean[0],), (mean[1],), "rings"),
    )
    return Chart(name, x_label, y_label, parts)


def _histogram(name: str, label: str, ours: Sequence[float], nothing: Sequence[float]) -> Chart:
    """Number of scenes by value; the averages are dashed."""
    edges = np.histogram_bin_edges([*ours, *nothing], bins=BIN_COUNT)
    parts: list[Bars | Upright] = []
    whose: tuple[tuple[Sequence[float], str, Colour], ...] = (
        (nothing, "no object", "baseline"),
        (ours, "prediction", "prediction"),
    )
    for values, who, colour in whose:
        counts, mean = np.histogram(values, edges)[0], float(np.mean(values))
        parts.append(Bars(f"{who}, mean {mean:.3g}", colour, tuple(edges.tolist()), tuple(counts.tolist())))
        parts.append(Upright("", colour, mean, "dash"))
    return Chart(name, label, "number of scenes", tuple(parts), whole_y=True)


def _beside_paper(report: Report) -> Chart:
    """Shares of the scenes by accuracy in the paper's bins, ours and the paper's; the averages are dashed."""
    both, mean = report.accuracy_histogram, report.prediction.accuracy.mean
    outside = both.below + both.above
    ours = f"prediction, mean {mean:.3g}" + (
        f"; {outside} of {len(report.scenes)} outside" if outside else ""
    )
    parts: list[Bars | Upright] = []
    whose: tuple[tuple[str, Colour, tuple[float, ...], float], ...] = (
        (f"paper, mean {both.paper_mean:.3g}", "truth", both.paper_shares, both.paper_mean),
        (ours, "prediction", both.shares, mean),
    )
    for name, colour, shares, middle in whose:
        parts.append(Bars(name, colour, both.edges, tuple(100 * share for share in shares)))
        parts.append(Upright("", colour, middle, "dash"))
    return Chart("accuracy_paper", "accuracy", "share of the scenes, %", tuple(parts))


def _sweep(name: str, label: str, calibration: Calibration, field: str, scale: float) -> Chart:
    """One line for each split; a threshold in use is dotted, a ring marks the best of validation."""
    judged, validation = calibration.judged, calibration.validation
    parts: list[Curve | Upright] = []
    if calibration.judged_threshold is not None:
        parts.append(Upright("in use", "text", calibration.judged_threshold, "dot"))
    splits: list[tuple[Colour, ThresholdCurve]] = [("prediction", judged)]
    if validation is not None and validation is not judged:
        splits.append(("truth", validation))
    for colour, curve in splits:
        values = tuple(scale * getattr(point, field) for point in curve.points)
        parts.append(Curve(curve.split, colour, tuple(p.threshold for p in curve.points), values))
    if (best := calibration.best_on_validation) is not None:
        colour = splits[-1][0]  # the validation split's
        parts.append(Curve("", colour, (best.threshold,), (scale * getattr(best, field),), "rings"))
    return Chart(name, "mask threshold", label, tuple(parts))


def _epochs(
    name: str,
    label: str,
    history: History,
    lines: Mapping[str, tuple[str, Colour]],
    kept: float | None,
) -> Chart:
    """Columns of the history by epoch, with the one whose weights are kept."""
    epochs = tuple(history["epoch"])
    parts: list[Curve | Upright] = []
    for column, (line, colour) in lines.items():
        values = tuple(value if math.isfinite(value) else None for value in history[column])
        # One epoch makes no line: its values are dots.
        parts.append(Curve(line, colour, epochs, values, "dots" if len(epochs) == 1 else "line", 1.2))
    if kept is not None:
        parts.append(Upright(f"kept: epoch {kept:g}", "text", kept, "dot"))
    return Chart(name, "epoch", label, tuple(parts), whole_x=True)


def _cm(metrics: Sequence[ImageMetrics]) -> list[float]:
    return [100 * m.depth_mae_m for m in metrics]
