"""The paper's picture of a scene: ground truth against prediction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from itof import DepthMap
from model.network.metrics import ImageMetrics
from scenegen import whole_file

BACKGROUND = "0.88"  # grey of pixels without object in a depth map
LEAST_DEPTH_SPAN_M = 0.4  # of the colours, else a flat object's noise would look like relief
DOTS_PER_INCH = 150


def comparison_figure(title: str, truth: DepthMap, prediction: DepthMap, metrics: ImageMetrics) -> Figure:
    """Ground truth above prediction, in three columns: Re, Im and radial depth.

    Both rows share their colours: Re and Im in [-1, 1]; depth over the range of the true object, a
    prediction beyond it is drawn in the colour of the nearest end. MAE and mIoU stand above.
    """
    height, width = truth.mask.shape
    figure = Figure(figsize=(10.5, 1.2 + 2 * 3.0 * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    near_m, far_m = depth_range(truth, prediction)
    for row, (name, view) in enumerate((("ground truth", truth), ("prediction", prediction))):
        components = [
            axes[row, column].imshow(part, vmin=-1, vmax=1, cmap="RdBu_r", interpolation="nearest")
            for column, part in enumerate((view.phasor.real, view.phasor.imag))
        ]
        depth_m = np.where(view.mask, view.radial_depth_m, np.nan)  # NaN is drawn as background
        depth = axes[row, 2].imshow(depth_m, vmin=near_m, vmax=far_m, cmap="viridis", interpolation="nearest")
        axes[row, 0].set_ylabel(name, fontsize=11)
        _finish_row(axes[row], top=row == 0)
    _colour_bars(figure, axes, components[1], depth)
    figure.suptitle(f"{title}\n{describe(metrics)}", fontsize=11)
    return figure


def describe(metrics: ImageMetrics) -> str:
    """MAE and mIoU in words, as they stand in a figure."""
    on_object = "no overlap" if metrics.object_mae_m is None else f"{100 * metrics.object_mae_m:.2f} cm"
    return (
        f"MAE {100 * metrics.depth_mae_m:.2f} cm over all pixels, {on_object} on the object, "
        f"mIoU {metrics.miou:.3f}"
    )


def write_figure(path: Path, figure: Figure) -> None:
    """Write a PNG, whole or not at all."""
    with whole_file(path) as partial:
        figure.savefig(partial, format="png", dpi=DOTS_PER_INCH)


def depth_range(*views: DepthMap) -> tuple[float, float]:
    """Colour range of depth, metres: of the object in the first view that shows one."""
    for view in views:
        if view.mask.any():
            depths_m = view.radial_depth_m[view.mask]
            near_m, far_m = float(depths_m.min()), float(depths_m.max())
            margin_m = max(0.1 * (far_m - near_m), (LEAST_DEPTH_SPAN_M - (far_m - near_m)) / 2)  # at each end
            return near_m - margin_m, far_m + margin_m
    return 0.0, 1.0


def _finish_row(row: Sequence[Axes], *, top: bool) -> None:
    for axes, name in zip(row, ("Re", "Im", "radial depth"), strict=True):
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_facecolor(BACKGROUND)
        if top:
            axes.set_title(name, fontsize=11)


def _colour_bars(figure: Figure, axes: NDArray[np.object_], component: AxesImage, depth: AxesImage) -> None:
    """One bar for Re and Im together, one for depth, under the columns."""
    figure.colorbar(component, ax=list(axes[:, :2].ravel()), location="bottom", aspect=40, pad=0.03)
    bar = figure.colorbar(
        depth, ax=list(axes[:, 2]), location="bottom", aspect=20, pad=0.03, extend="both", label="m"
    )
    bar.locator = MaxNLocator(4)
