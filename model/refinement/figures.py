"""Pictures of refined scenes: their depth maps beside truth and network, and the hidden light of an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof import DepthMap
from itof.metrics import image_metrics
from itof.pictures.figures import depth_range, finish_panels, plain, write_figure
from model.refinement.hidden_light import HiddenLight

MOST_SCENES = 12
_COLUMNS, _SIDE_IN = 2, 1.75  # scenes in a row; size of a depth map, inches
_VIEWS = ("truth", "network", "refined")
_ROWS = ("measured", "explained", "left over")
_SHOWN_SHARE = 99.0  # percent of the measured values that the colours span


def write_refined_figure(file: Path, scenes: Sequence[tuple[str, DepthMap, DepthMap, DepthMap]]) -> None:
    """Write a PNG of scenes: name, and the depth maps (H, W) of truth, network and refinement."""
    rows, count = -(-len(scenes) // _COLUMNS), len(_VIEWS)
    height, width = scenes[0][1].mask.shape
    size = (count * _COLUMNS * _SIDE_IN, rows * (_SIDE_IN * height / width + 0.25) + 0.3)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, count * _COLUMNS, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for place, (name, truth, *found) in enumerate(scenes):
        row, column = divmod(place, _COLUMNS)
        panels = grid[row, count * column : count * (column + 1)]
        near_m, far_m = depth_range(truth, *found)
        titles = [plain(name)]
        for each in found:
            metrics = image_metrics(each.radial_depth_m, each.mask, truth.radial_depth_m, truth.mask)
            titles.append(f"{100 * metrics.depth_mae_m:.1f} cm, {metrics.miou:.2f}")
        for axes, view, title in zip(panels, (truth, *found), titles, strict=True):
            axes.set_axis_on()
            depth_m = np.where(view.mask, view.radial_depth_m, np.nan)
            axes.imshow(depth_m, vmin=near_m, vmax=far_m, interpolation="nearest")
            axes.set_title(title, fontsize=7, loc="left")
        finish_panels(panels.tolist())
    figure.suptitle(f"for each scene: {', '.join(_VIEWS)}; MAE and mIoU", fontsize=9)
    write_figure(file, figure)


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
