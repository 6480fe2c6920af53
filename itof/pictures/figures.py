"""Picture of a predicted depth map, and the parts that it shares with other pictures of depth maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from disk import whole_file
from itof import DepthMap
from itof.pictures.png import save_png

PANELS = ("Re", "Im", "radial depth")
ERROR_PANEL = "expected error of the depth"
BACKGROUND = "0.88"  # grey of the pixels without object
LEAST_DEPTH_SPAN_M = 0.4  # with a smaller colour range, the noise of a flat object would look like relief
DOTS_PER_INCH = 150


def prediction_figure(title: str, one: DepthMap, light: str = "") -> Figure:
    """Re, Im, radial depth and, where it is known, its expected error, of one (H, W) prediction.

    `light` says how much of the hidden light it explains. The outline of the mask is drawn over Re and Im;
    depth and error are drawn inside the mask only.
    """
    height, width = one.mask.shape
    names = PANELS if one.depth_error_m is None else (*PANELS, ERROR_PANEL)
    figure = Figure(
        figsize=(3.5 * len(names), 1.6 + 0.2 * bool(light) + 3.0 * height / width), layout="constrained"
    )
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(names))
    components = []
    for axes, part in zip(panels[:2], (one.phasor.real, one.phasor.imag), strict=True):
        components.append(axes.imshow(part, vmin=-1, vmax=1, cmap="RdBu_r", interpolation="nearest"))
        _outline(axes, one.mask)
    near_m, far_m = depth_range(one)
    depth_m = np.where(one.mask, one.radial_depth_m, np.nan)  # NaN is drawn as background
    depth = panels[2].imshow(depth_m, vmin=near_m, vmax=far_m, cmap="viridis", interpolation="nearest")
    if one.depth_error_m is not None:
        error_cm = np.where(one.mask, 100 * one.depth_error_m, np.nan)
        most_cm = float(np.nanmax(error_cm, initial=0.1))
        error = panels[3].imshow(error_cm, vmin=0, vmax=most_cm, cmap="magma", interpolation="nearest")
        figure.colorbar(error, ax=[panels[3]], location="bottom", aspect=20, pad=0.03, label="cm")
    finish_panels(panels, titles=names)
    figure.colorbar(components[1], ax=list(panels[:2]), location="bottom", aspect=40, pad=0.03)
    bar = figure.colorbar(depth, ax=[panels[2]], location="bottom", aspect=20, pad=0.03, label="m")
    bar.locator = MaxNLocator(4)
    shown = int(np.count_nonzero(one.mask))
    said = f"{shown} of {width * height} pixels show an object" if shown else "no pixel shows an object"
    said += f"\n{light}" if light else ""
    figure.suptitle(f"{plain(title)}\n{said}", fontsize=11)
    return figure


def write_figure(path: Path, figure: Figure) -> None:
    """Write a PNG file, whole or not at all."""
    with whole_file(path) as partial:
        save_png(figure, partial, DOTS_PER_INCH)


def depth_range(*views: DepthMap) -> tuple[float, float]:
    """Range of the depth colours, metres: that of the object in the first view that has one."""
    for view in views:
        if view.mask.any():
            depths_m = view.radial_depth_m[view.mask]
            near_m, far_m = float(depths_m.min()), float(depths_m.max())
            margin_m = max(0.1 * (far_m - near_m), (LEAST_DEPTH_SPAN_M - (far_m - near_m)) / 2)
            return near_m - margin_m, far_m + margin_m
    return 0.0, 1.0


def finish_panels(row: Sequence[Axes], *, titles: Sequence[str] = ()) -> None:
    """Remove the ticks of the panels of a row, colour their background, add their titles if there are any."""
    for axes in row:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
    for axes, name in zip(row, titles, strict=False):
        axes.set_title(name, fontsize=11)


def plain(text: str) -> str:
    """Text for a picture; matplotlib would read a ``$`` in it as the start of a formula."""
    return text.replace("$", r"\$")


def _outline(axes: Axes, mask: NDArray[np.bool_]) -> None:
    """Draw the edges between the pixels inside and outside a (H, W) mask."""
    padded = np.pad(mask, 1)  # gives an object at the border of the image an outline there
    rows, columns = np.nonzero(padded[1:, :] != padded[:-1, :])  # edges below padded row `rows`
    axes.hlines(rows - 0.5, columns - 1.5, columns - 0.5, colors="black", linewidth=0.8)
    rows, columns = np.nonzero(padded[:, 1:] != padded[:, :-1])
    axes.vlines(columns - 0.5, rows - 1.5, rows - 0.5, colors="black", linewidth=0.8)
    height, width = mask.shape
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
