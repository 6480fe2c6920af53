"""The report's charts: distributions, calibration and training curves, as PNG and as SVG for the page."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from model.network.metrics import ImageMetrics
from model.report.calibration import Calibration
from model.report.results import Report

# A PNG shows these as they are; in the page each is a CSS variable, which is another colour by night.
TEXT, GRID, BASELINE, PREDICTION, TRUTH = "#3a4047", "#dde1e6", "#9aa1a9", "#0b6fb8", "#d9730d"
VARIABLES = {
    TEXT: "var(--text)",
    GRID: "var(--line)",
    BASELINE: "var(--baseline)",
    PREDICTION: "var(--prediction)",
    TRUTH: "var(--truth)",
}
SIZE_INCHES = (4.4, 3.0)
History = Mapping[str, Sequence[float]]


def distributions(report: Report) -> dict[str, Figure]:
    """Histograms of MAE, mIoU and accuracy: prediction, and "no object" beside it."""
    ours, nothing = [r.prediction for r in report.scenes], [r.no_object for r in report.scenes]
    return {
        "mae_histogram": _histogram("MAE over all pixels, cm", _cm(ours), _cm(nothing)),
        "miou_histogram": _histogram("mIoU", [m.miou for m in ours], [m.miou for m in nothing]),
        "accuracy_histogram": _histogram(
            "accuracy", [m.accuracy for m in ours], [m.accuracy for m in nothing]
        ),
    }


def calibration_curves(calibration: Calibration) -> dict[str, Figure]:
    """Mean mIoU and mean MAE against the mask threshold."""
    return {
        "calibration_miou": _sweep("mean mIoU", calibration, "miou", 1.0),
        "calibration_mae": _sweep("mean MAE over all pixels, cm", calibration, "depth_mae_m", 100.0),
    }


def training_curves(history: History) -> dict[str, Figure]:
    """Losses, validation MAE and mIoU by epoch, the epoch of the kept weights marked; none without epochs.

    Parameters
    ----------
    history : columns of ``history.csv``; a chart whose columns are missing is left out.
    """
    wanted = {
        "training_loss": (
            "loss",
            {"train_loss": ("training", TRUTH), "validation_loss": ("validation", PREDICTION)},
        ),
        "training_mae": ("validation MAE, cm", {"validation_mae_cm": ("", PREDICTION)}),
        "training_miou": ("validation mIoU", {"validation_miou": ("", PREDICTION)}),
    }
    return {
        name: _epochs(label, history, lines)
        for name, (label, lines) in wanted.items()
        if history.get("epoch") and all(history.get(column) for column in lines)
    }


def inline_svg(name: str, figure: Figure) -> str:
    """A figure as an ``<svg>`` element that takes the page's width, font and colours."""
    stream = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):  # the salt keeps names apart
        figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    svg = stream.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(
        r' id="(?:figure|axes|patch|line2d|text|matplotlib\.axis|xtick|ytick|legend|[A-Z]\w*)_\d+"', "", svg
    )
    svg = re.sub(
        r'<svg [^>]*?viewBox="([^"]+)"[^>]*>',
        r'<svg class="chart" viewBox="\1" aria-hidden="true">',
        svg,
        count=1,
    )
    svg = svg.replace("xlink:href", "href")
    for colour, variable in VARIABLES.items():
        svg = svg.replace(colour, variable)
    return svg


def _histogram(label: str, ours: Sequence[float], nothing: Sequence[float]) -> Figure:
    """How many scenes have which value; the averages are dashed lines."""
    figure, axes = _empty(label, f"scenes of {len(ours)}")
    edges = np.histogram_bin_edges([*ours, *nothing], bins=24).tolist()
    for values, name, colour in ((nothing, "no object", BASELINE), (ours, "prediction", PREDICTION)):
        mean = float(np.mean(values))
        axes.hist(values, bins=edges, color=colour, alpha=0.75, label=f"{name}, mean {mean:.3g}")
        axes.axvline(mean, color=colour, linestyle="--", linewidth=1.2)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _legend(axes)
    return figure


def _sweep(label: str, calibration: Calibration, field: str, scale: float) -> Figure:
    """A line a split; dotted the threshold in use, a ring where validation is best."""
    figure, axes = _empty("mask threshold", label)
    axes.axvline(calibration.judged_threshold, color=TEXT, linestyle=":", linewidth=1.2, label="in use")
    validation = calibration.validation
    for curve, colour in ((calibration.judged, PREDICTION), (validation, TRUTH)):
        if curve is None or (colour == TRUTH and curve is calibration.judged):
            continue
        values = [scale * getattr(point, field) for point in curve.points]
        axes.plot([p.threshold for p in curve.points], values, color=colour, label=curve.split)
    if validation is not None:
        best = validation.best
        ring = {"marker": "o", "fillstyle": "none", "markersize": 8, "linestyle": "none"}
        colour = PREDICTION if validation is calibration.judged else TRUTH
        axes.plot([best.threshold], [scale * getattr(best, field)], color=colour, **ring)  # type: ignore[arg-type]
    _legend(axes)
    return figure


def _epochs(label: str, history: History, lines: Mapping[str, tuple[str, str]]) -> Figure:
    figure, axes = _empty("epoch", label)
    epochs = history["epoch"]
    marker = "o" if len(epochs) == 1 else None  # a line through one point is none
    for column, (name, colour) in lines.items():
        axes.plot(epochs, history[column], color=colour, linewidth=1.2, marker=marker, label=name)
    if history.get("validation_loss"):
        kept = epochs[int(np.argmin(history["validation_loss"]))]
        axes.axvline(kept, color=TEXT, linestyle=":", linewidth=1.2, label=f"kept: epoch {kept:g}")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend(axes)
    return figure


def _empty(x: str, y: str) -> tuple[Figure, Axes]:
    """Labelled axes in the report's colours."""
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.set_xlabel(x, color=TEXT)
    axes.set_ylabel(y, color=TEXT)
    axes.tick_params(colors=TEXT, length=3, labelsize=9)
    axes.grid(axis="y", color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(BASELINE)
    return figure, axes


def _legend(axes: Axes) -> None:
    """What the lines are, above the axes."""
    named = [(h, name) for h, name in zip(*axes.get_legend_handles_labels(), strict=True) if name]
    handles, names = zip(*named, strict=True)
    axes.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=min(len(named), 3),
        frameon=False,
        fontsize=9,
        labelcolor=TEXT,
        handlelength=1.4,
    )


def _cm(metrics: Sequence[ImageMetrics]) -> list[float]:
    return [100 * m.depth_mae_m for m in metrics]
