"""Figures of measurements and depth maps, for a Python shell or a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from disk.frequency_text import megahertz
from itof.arrays import Phasors, Reals
from itof.light import amplitude, phase
from itof.pictures.figures import BACKGROUND, finish_panels

_PANEL_INCHES = (3.2, 2.6)
_MOST_ROWS = 16


@dataclass(frozen=True)
class Panel:
    """An image (H, W), its name with its unit, and the name of its colours in matplotlib."""

    title: str
    values: Reals
    colours: str = "viridis"


def plot_panels(rows: Sequence[Sequence[Panel]]) -> Figure:
    """The panels of the first 16 rows, with bars of their colours; ``plt.show()`` shows them in a script."""
    shown = rows[:_MOST_ROWS]
    wide, high = _PANEL_INCHES
    columns = max(map(len, shown))
    figure, axes = plt.subplots(
        len(shown),
        columns,
        figsize=(wide * columns, high * len(shown)),
        squeeze=False,
        layout="constrained",
    )
    for row, places in zip(shown, axes, strict=True):
        finish_panels(places, titles=[panel.title for panel in row])
        for panel, place in zip(row, places, strict=False):
            place.set_facecolor(BACKGROUND)
            figure.colorbar(place.imshow(panel.values, cmap=panel.colours), ax=place, shrink=0.8)
        for place in places[len(row) :]:
            place.remove()
    return figure


def phasor_panels(phasor: Phasors, frequencies_hz: Sequence[float], name: str = "") -> list[list[Panel]]:
    """A row of amplitudes and one of phases of phasors (H, W, F); pixels without light are empty."""
    z = np.moveaxis(np.asarray(phasor), -1, 0)  # (F, H, W)
    titles = [f"{name} {megahertz(frequency_hz)}".strip() for frequency_hz in frequencies_hz]
    kinds = (("amplitude", amplitude(z), "inferno"), ("phase, rad", phase(z), "twilight"))
    return [
        [
            Panel(f"{title}: {kind}", np.where(seen == 0, np.nan, image), colours)
            for title, image, seen in zip(titles, values, z, strict=True)
        ]
        for kind, values, colours in kinds
    ]
