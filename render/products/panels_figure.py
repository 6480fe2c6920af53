"""Pictures of one camera side by side, from radiance to grey values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WHITE = 99.5  # percentile of the lit pixels that becomes white
_GAMMA = 2.2
_PANEL_INCHES = 3.2


def panels_figure(pictures: Mapping[str, NDArray[np.float64]]) -> Figure:
    """The figure of pictures (H, W) of radiance, by their titles, each with its own exposure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = next(iter(pictures.values())).shape
    size = (_PANEL_INCHES * len(pictures), _PANEL_INCHES * height / width + 0.35)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    for panel, (title, radiance) in zip(figure.subplots(1, len(pictures)), pictures.items(), strict=True):
        panel.imshow(grey_values(radiance), cmap="gray", vmin=0, vmax=1)
        panel.set_title(title, fontsize=10)
        panel.set(xticks=[], yticks=[])
    return figure


def grey_values(radiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey values from 0 to 1: radiance over that of the brightest pixels, then a gamma of 2.2."""
    lit = radiance[radiance > 0]
    white = float(np.percentile(lit, _WHITE)) if len(lit) else 1.0
    grey: NDArray[np.float64] = np.clip(radiance / white, 0, 1) ** (1 / _GAMMA)
    return grey
