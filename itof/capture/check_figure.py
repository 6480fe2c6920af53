"""Picture of a capture: phases over the wall that was found, amplitude, and pixels that were left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from disk.frequency_text import megahertz
from itof.arrays import Floats, Phasors
from itof.capture.image_check import wall_distance_m
from itof.pictures.figures import BACKGROUND, finish_panels, plain
from itof.wall.finding import length
from itof.wall.wall_fit import RobustFit

_LONGEST = 110  # characters of a line of the title
_MOST_SHOWN = 6  # frequencies
_SHOWN_SHARE = 98.0  # percent of the pixels that the colours of phases span
_ASPECT = (0.25, 4.0)  # height over width of a panel; longer images are drawn small in it


def check_figure(
    title: str,
    phasor: Phasors,
    saturated_part: Floats | None,
    fit: RobustFit | None,
    said: str,
) -> Figure:
    """Phases over the fitted wall (without a wall: phases) at six frequencies, amplitude, pixels left out.

    Parameters
    ----------
    phasor : (H, W, F) complex.
    saturated_part : (H, W) part of the sensor pixels of a pixel that are saturated; None if unknown.
    said : the findings.
    """
    height, width, whole = phasor.shape
    count = min(whole, _MOST_SHOWN)
    size = (1.0 + 3.0 * (count + 2), 2.0 + 3.0 * float(np.clip(height / width, *_ASPECT)))
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, count + 2)
    lit = (phasor != 0).all(axis=-1)
    if fit is not None:
        _draw_residual(figure, panels[:count], fit)
    else:
        for place in range(count):
            shown = np.where(lit, np.angle(phasor[..., place]), np.nan)
            image = panels[place].imshow(
                shown, vmin=-np.pi, vmax=np.pi, cmap="twilight", interpolation="nearest"
            )
        bar = figure.colorbar(image, ax=list(panels[:count]), location="bottom", aspect=40, pad=0.03)
        bar.set_label("phase, rad")
    strength = np.where(lit, np.abs(phasor[..., 0]), np.nan)
    image = panels[count].imshow(strength, cmap="gray", interpolation="nearest")
    figure.colorbar(
        image, ax=[panels[count]], location="bottom", aspect=20, pad=0.03, label="unit of the camera"
    )
    part = (~lit).astype(np.float64) if saturated_part is None else np.maximum(saturated_part, ~lit)
    image = panels[count + 1].imshow(part, vmin=0, vmax=1, cmap="inferno", interpolation="nearest")
    figure.colorbar(image, ax=[panels[count + 1]], location="bottom", aspect=20, pad=0.03)
    finish_panels(panels)
    panels[count].set_title("amplitude", fontsize=11)
    panels[count + 1].set_title("part saturated or empty", fontsize=11)
    where = "" if fit is None else f", wall {length(wall_distance_m(fit))} away"
    part_of = "" if count == whole else f", {count} of {whole} frequencies"
    figure.suptitle(f"{plain(title)}{where}{part_of}\n{plain(_shortened(said))}", fontsize=11)
    return figure


def _draw_residual(figure: Figure, panels: Sequence[Axes], fit: RobustFit) -> None:
    """Draw the phases that a fit leaves at the first frequencies, a panel each, and a bar of colours."""
    lit = fit.weight > 0
    left_mrad = 1e3 * fit.residual_rad
    limit = max(float(np.percentile(np.abs(left_mrad[lit]), _SHOWN_SHARE)), 1e-3)
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


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
