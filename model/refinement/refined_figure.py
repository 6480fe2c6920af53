"""Depth maps of several scenes in a row each: truth, network and refined."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from itof import DepthMap
from itof.metrics import image_metrics
from itof.pictures.figures import depth_range, finish_panels, plain, write_figure

MOST_SCENES = 12
_COLUMNS, _SIDE_IN = 2, 1.75  # scenes in a row; size of a depth map, inches
_VIEWS = ("truth", "network", "refined")


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
