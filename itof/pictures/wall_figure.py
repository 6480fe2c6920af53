"""Picture of the relay wall that a measurement shows: what the fit of its plane leaves of the phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from itof.pictures.figures import BACKGROUND, plain
from itof.wall.finding import megahertz
from itof.wall.plausibility import describe_shift
from itof.wall.wall_fit import WallFit

SHOWN_SHARE = 98.0  # percent of the pixels that the colours span; the rest is drawn in the last colour


def wall_figure(title: str, fit: WallFit, frequencies_hz: tuple[float, ...]) -> Figure:
    """Residual phase of every frequency in mrad; it is hidden light and noise if the wall was found.

    Pixels that hold no light are grey.
    """
    height, width = fit.weight.shape
    size = (1.0 + 3.2 * len(frequencies_hz), 1.6 + 3.0 * height / width)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(frequencies_hz), squeeze=False)[0]
    draw_residual(figure, panels, fit, frequencies_hz)
    offsets = ", ".join(f"{1e3 * offset:+.1f}" for offset in fit.offsets_rad)
    figure.suptitle(f"{plain(title)}\nwall {describe_shift(fit)}; phase offsets {offsets} mrad", fontsize=11)
    return figure


def draw_residual(
    figure: Figure, panels: Sequence[Axes], fit: WallFit, frequencies_hz: tuple[float, ...]
) -> None:
    """Draw the phases that a fit leaves, one frequency a panel, with a bar of colours below."""
    lit = fit.weight > 0
    left_mrad = 1e3 * fit.residual_rad
    limit = max(float(np.percentile(np.abs(left_mrad[lit]), SHOWN_SHARE)), 1e-3)
    for place, (axes, frequency_hz) in enumerate(zip(panels, frequencies_hz, strict=True)):
        shown = np.where(lit, left_mrad[..., place], np.nan)
        image = axes.imshow(shown, vmin=-limit, vmax=limit, cmap="RdBu_r", interpolation="nearest")
        rms_mrad = 1e3 * fit.residual_rms_rad[place]
        axes.set_title(f"{megahertz([frequency_hz])}, rms {rms_mrad:.2g} mrad", fontsize=11)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
    bar = figure.colorbar(image, ax=list(panels), location="bottom", aspect=40, pad=0.03, extend="both")
    bar.set_label("residual phase, mrad")
