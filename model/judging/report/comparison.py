"""Picture of a scene: Re, Im and depth; ground truth above prediction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from itof import DepthMap
from itof.metrics import ImageMetrics
from itof.pictures.figures import PANELS, depth_range, finish_panels, plain


def comparison_figure(title: str, truth: DepthMap, prediction: DepthMap, metrics: ImageMetrics) -> Figure:
    """Re, Im and radial depth of one scene (H, W): ground truth above prediction, MAE and mIoU in the title.

    Both rows have the same colour scales: [-1, 1] for Re and Im, the range of the true object for depth.
    Depths of the prediction outside this range have the colour of the nearer end.
    """
    height, width = truth.mask.shape
    figure = Figure(figsize=(10.5, 1.2 + 2 * 3.0 * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    range_m = depth_range(truth, prediction)
    for row, (name, view) in enumerate((("ground truth", truth), ("prediction", prediction))):
        component, depth = draw_view(axes[row], view, range_m)
        axes[row, 0].set_ylabel(name, fontsize=11)
        finish_panels(axes[row], titles=PANELS if row == 0 else ())
    _colour_bars(figure, axes, component, depth)
    figure.suptitle(f"{plain(title)}\n{describe(metrics)}", fontsize=11)
    return figure


def draw_view(
    panels: Sequence[Axes], view: DepthMap, range_m: tuple[float, float]
) -> tuple[AxesImage, AxesImage]:
    """Draw Re, Im and radial depth of a (H, W) depth map into three panels.

    Parameters
    ----------
    range_m : radial depths at the ends of the colours, metres.

    Returns
    -------
    The images of Im and of the depth, for their colour bars.
    """
    components = [
        axes.imshow(part, vmin=-1, vmax=1, cmap="RdBu_r", interpolation="nearest")
        for axes, part in zip(panels[:2], (view.phasor.real, view.phasor.imag), strict=True)
    ]
    depth_m = np.where(view.mask, view.radial_depth_m, np.nan)  # NaN is drawn as background
    near_m, far_m = range_m
    depth = panels[2].imshow(depth_m, vmin=near_m, vmax=far_m, cmap="viridis", interpolation="nearest")
    return components[1], depth


def describe(metrics: ImageMetrics) -> str:
    """MAE and mIoU of an image as text."""
    on_object = "no overlap" if metrics.object_mae_m is None else f"{100 * metrics.object_mae_m:.2f} cm"
    return (
        f"MAE {100 * metrics.depth_mae_m:.2f} cm over all pixels, {on_object} on the object, "
        f"mIoU {metrics.miou:.3f}"
    )


def _colour_bars(figure: Figure, axes: NDArray[np.object_], component: AxesImage, depth: AxesImage) -> None:
    """Draw one colour bar for Re and Im and one for depth, below the columns."""
    figure.colorbar(component, ax=list(axes[:, :2].ravel()), location="bottom", aspect=40, pad=0.03)
    bar = figure.colorbar(
        depth, ax=list(axes[:, 2]), location="bottom", aspect=20, pad=0.03, extend="both", label="m"
    )
    bar.locator = MaxNLocator(4)
