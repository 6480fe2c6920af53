"""Picture of the hidden light of an image: measured, explained by a solid, and left over."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof.pictures.figures import finish_panels, plain
from model.refinement.hidden_light import HiddenLight

_ROWS = ("measured", "explained", "left over")
_SHOWN_SHARE = 99.0  # percent of the measured values that the colours span


def light_figure(
    title: str, observed: HiddenLight, misfit: NDArray[np.float64], hz: tuple[float, ...]
) -> Figure:
    """Phases of the hidden light at each frequency, mrad, without what the fit of the wall takes.

    Parameters
    ----------
    misfit : (M,) values of the solid less those of the measurement.
    hz : F modulation frequencies.
    """
    rows, columns = observed.where.shape
    images = np.full((len(_ROWS), len(hz), rows, columns), np.nan)
    measured = observed.values
    for image, values in zip(images, (measured, measured + misfit, -misfit), strict=True):
        phases = values[: len(hz) * len(observed.weight)].reshape(len(hz), -1) / observed.weight
        image[:, observed.where] = 1e3 * phases
    limit = max(float(np.nanpercentile(np.abs(images[0]), _SHOWN_SHARE)), 1e-3)
    left = max(float(np.nanpercentile(np.abs(images[2]), _SHOWN_SHARE)), 1e-3 * limit)
    times = max(10 ** math.floor(math.log10(limit / left)), 1)  # so that its pattern is seen
    images[2] *= times
    names = (*_ROWS[:2], _ROWS[2] if times == 1 else f"{_ROWS[2]}, {times} times")
    size = (1.0 + 2.6 * len(hz), 1.6 + 2.6 * len(_ROWS) * rows / columns)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(_ROWS), len(hz), squeeze=False)
    for panels, name, row in zip(grid, names, images, strict=True):
        for axes, image in zip(panels, row, strict=True):
            drawn = axes.imshow(image, vmin=-limit, vmax=limit, cmap="RdBu_r", interpolation="nearest")
        panels[0].set_ylabel(name, fontsize=11)
    for panels in grid:
        finish_panels(panels.tolist())
    finish_panels(grid[0].tolist(), titles=[megahertz(each) for each in hz])
    bar = figure.colorbar(
        drawn, ax=grid.ravel().tolist(), location="bottom", aspect=40, pad=0.03, extend="both"
    )
    bar.set_label("phase of the hidden light, mrad")
    figure.suptitle(plain(title), fontsize=11)
    return figure
