"""Error and overlap against the number of exposures, beside the bound of the hidden light's noise."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from itof.metrics import Statistics
from itof.pictures.figures import write_figure
from model.judging.exposures.results import ExposureReport

_BLUE, _ORANGE, _GREY = "#0b6fb8", "#d9730d", "#5f6770"


def write_exposure_figure(file: Path, report: ExposureReport) -> None:
    """Write a PNG with three charts: MAE, mIoU, and hidden light over noise (Cramer-Rao bound)."""
    rows = report.rows
    light_ms = [1e3 * row.light_s for row in rows]
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    error, overlap, noise = figure.subplots(1, 3)
    for axes, values, deviation, perfect, nothing, title in (
        (
            error,
            [100 * row.metrics.depth_mae_m.mean for row in rows],
            [100 * _bar(row.metrics.depth_mae_m) for row in rows],
            *(100 * each.depth_mae_m.mean for each in (report.perfect, report.no_object)),
            "MAE, cm",
        ),
        (
            overlap,
            [row.metrics.miou.mean for row in rows],
            [_bar(row.metrics.miou) for row in rows],
            *(each.miou.mean for each in (report.perfect, report.no_object)),
            "mIoU",
        ),
    ):
        axes.errorbar(light_ms, values, deviation, color=_BLUE, marker="o", markersize=4, label="camera")
        axes.axhline(perfect, color=_ORANGE, linestyle="--", linewidth=1.2, label="phasors as rendered")
        axes.axhline(nothing, color=_GREY, linestyle=":", linewidth=1.2, label="no object")
        axes.set_ylabel(title)
        axes.legend(fontsize=8, frameon=False)
    error.set_ylim(bottom=0)
    bounds = [row.snr_pixel for row in rows]
    if all(bound is not None for bound in bounds):
        noise.plot(light_ms, bounds, color=_BLUE, marker="o", markersize=4)
        noise.set_yscale("log")
    noise.axhline(1, color=_GREY, linestyle=":", linewidth=1.2)
    noise.set_ylabel("hidden light / noise of a pixel")
    for axes in (error, overlap, noise):
        axes.set_xscale("log")
        axes.set_xlabel("light of all raw frames, ms")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#dde1e6", linewidth=0.6)
    write_figure(file, figure)


def _bar(found: Statistics) -> float:
    """Length of an error bar; NaN, which is not drawn, if one scene does not tell it."""
    return math.nan if found.standard_error is None else found.standard_error
