"""Charts as figures, for documents."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from model.judging.report.charts import Bars, Chart, Curve, Upright

TEXT, GRID, BASELINE = "#3a4047", "#dde1e6", "#9aa1a9"
COLOURS = {"text": TEXT, "baseline": BASELINE, "prediction": "#0b6fb8", "truth": "#d9730d"}
STYLES: dict[str, dict[str, Any]] = {
    "line": {},
    "dots": {"marker": "o"},
    "points": {"marker": "o", "markersize": 3.5, "linestyle": "none", "alpha": 0.6},
    "rings": {"marker": "o", "fillstyle": "none", "markersize": 8, "linestyle": "none"},
}
DASHES = {"dash": "--", "dot": ":"}
SIZE_INCHES = (4.4, 3.0)
MOST_LETTERS = 40  # of all names in one row of the legend


def chart_figure(chart: Chart) -> Figure:
    """A chart on a white page."""
    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    _label(axes, chart)
    for part in chart.parts:
        _draw(axes, part)
    for axis, whole in ((axes.xaxis, chart.whole_x), (axes.yaxis, chart.whole_y)):
        if whole:
            axis.set_major_locator(MaxNLocator(integer=True))
    _legend(axes)
    return figure


def _draw(axes: Axes, part: Bars | Curve | Upright) -> None:
    colour = COLOURS[part.colour]
    name = part.name or None  # matplotlib has no line for None in the legend
    if isinstance(part, Bars):
        axes.hist(part.edges[:-1], bins=part.edges, weights=part.counts, color=colour, alpha=0.75, label=name)
    elif isinstance(part, Curve):
        axes.plot(
            part.x,
            part.y,  # type: ignore[arg-type]  # None is a gap
            color=colour,
            linewidth=part.width_pt,
            label=name,
            **STYLES[part.style],
        )
    else:
        axes.axvline(part.x, color=colour, linestyle=DASHES[part.dash], linewidth=1.2, label=name)


def _label(axes: Axes, chart: Chart) -> None:
    """Axes in the report's colours."""
    axes.set_xlabel(chart.x_label, color=TEXT)
    axes.set_ylabel(chart.y_label, color=TEXT)
    axes.tick_params(colors=TEXT, length=3, labelsize=9)
    axes.grid(axis="y", color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(BASELINE)


def _legend(axes: Axes) -> None:
    """The names of the parts, above the axes."""
    handles, names = axes.get_legend_handles_labels()
    if not names:
        return
    axes.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=min(len(names), 3) if sum(map(len, names)) <= MOST_LETTERS else 1,
        frameon=False,
        fontsize=9,
        labelcolor=TEXT,
        handlelength=1.4,
    )
