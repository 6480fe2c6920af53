"""Picture of the relay wall that a measurement shows: what the fit of its plane leaves of the phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from disk.frequency_text import megahertz
from itof.pictures.figures import BACKGROUND, plain
from itof.wall.plausibility import describe_shift
from itof.wall.wall_fit import RobustFit

SHOWN_SHARE = 98.0  # percent of the pixels that the colours span; the rest is drawn in the last colour


def wall_figure(title: str, fit: RobustFit) -> Figure:
    """Residual phase of every frequency in mrad; it is hidden light and noise if the wall was found.

    Pixels that hold no light are grey.
    """
    height, width = fit.weight.shape
    count = len(fit.wall.frequencies_hz)
    size = (1.0 + 3.2 * count, 1.6 + 3.0 * height / width)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, count, squeeze=False)[0]
    draw_residual(figure, panels, fit)
    offsets = ", ".join(f"{1e3 * offset:+.1f}" for offset in fit.offsets_rad)
    figure.suptitle(f"{plain(title)}\nwall {describe_shift(fit)}; phase offsets {offsets} mrad", fontsize=11)
    return figure


def draw_residual(figure: Figure, panels: Sequence[Axes], fit: RobustFit) -> None:
    """Draw the phases that a fit leaves at the first frequencies, a panel each, and a bar of colours."""
    lit = fit.weight > 0
    left_mrad = 1e3 * fit.residual_rad
    limit = max(float(np.percentile(np.abs(left_mrad[lit]), SHOWN_SHARE)), 1e-3)
    for place, (axes, frequency_hz) in enumerate(zip(panels, fit.wall.frequencies_hz, strict=False)):
        shown = np.where(lit, left_mrad[..., place], np.nan)
        image = axes.imshow(shown, vmin=-limit, vmax=limit, cmap="RdBu_r", interpolation="nearest")
        rms_mrad = 1e3 * fit.residual_rms_rad[place]
        axes.set_title(f"{megahertz(frequency_hz)}, rms {rms_mrad:.2g} mrad", fontsize=11)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
    bar = figure.colorbar(image, ax=list(panels), location="bottom", aspect=40, pad=0.03, extend="both")
    bar.set_label("residual phase, mrad")
