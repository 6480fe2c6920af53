"""Picture of a capture: phases over the wall that was found, amplitude, and pixels that were left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from itof.capture.image_check import wall_distance_m
from itof.pictures.figures import finish_panels, plain
from itof.pictures.wall_figure import draw_residual
from itof.wall.finding import length
from itof.wall.unknown_wall import SeenWall

_LONGEST = 110  # characters of a line of the title
_MOST_SHOWN = 6  # frequencies
_ASPECT = (0.25, 4.0)  # height over width of a panel; longer images are drawn small in it


def check_figure(
    title: str,
    phasor: NDArray[Any],
    saturated_part: NDArray[np.float64] | None,
    seen: SeenWall | None,
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
    if seen is not None and not seen.defects:
        draw_residual(figure, panels[:count], seen.fit, seen.wall.frequencies_hz[:count])
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
    where = "" if seen is None or seen.defects else f", wall {length(wall_distance_m(seen))} away"
    part_of = "" if count == whole else f", {count} of {whole} frequencies"
    figure.suptitle(f"{plain(title)}{where}{part_of}\n{plain(_shortened(said))}", fontsize=11)
    return figure


def _shortened(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
