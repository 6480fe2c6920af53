"""Pictures of Re, Im and depth, truth and prediction: of one scene, or of several as in Fig. 5 (paper)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from itof import DepthMap
from itof.metrics import ImageMetrics
from itof.pictures.figures import depth_range, finish_panels, plain
from model.judging.showcase import ShownScene, short_name

PANELS = ("Re", "Im", "radial depth")
# Inches: width of a panel; margins left (names of scenes), right (numbers of colour bars), top, bottom.
PANEL, LEFT, RIGHT, TOP, BOTTOM = 1.9, 1.15, 0.6, 0.5, 0.65
BETWEEN, BESIDE = 0.08, 0.06  # rows; the columns and gaps of the grid
WIDTHS = (PANEL, PANEL, 0.1, PANEL, PANEL, 0.1, PANEL, PANEL, 0.02, 0.13)  # three pairs, and a colour bar
COLUMNS = (0, 1, 3, 4, 6, 7)  # of the panels: truth and prediction of Re, of Im, of the depth
DEPTH_UNIT = "m"


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


def scenes_figure(shown: Sequence[ShownScene]) -> Figure:
    """Re, Im and radial depth of each scene: truth left, prediction right, MAE and mIoU in the picture.

    The colours are those of `comparison_figure`: [-1, 1] for Re and Im of all scenes; for depth, the range of
    the true object of the row.

    Parameters
    ----------
    shown : scenes (H, W) of one size, at least one.

    Source: Caligiuri et al. 2024, Fig. 5 (layout); the colours are ours.
    """
    figure, grid = _page(len(shown), shown[0].truth.mask.shape)
    for row, scene in enumerate(shown):
        panels = [figure.add_subplot(grid[row, column]) for column in COLUMNS]
        component, depth = _draw_scene(panels, scene)
        _colour_bar(figure, depth, figure.add_subplot(grid[row, -1]), DEPTH_UNIT)
        if row == 0:
            titles = (f"{name}\n{whose}" for name in PANELS for whose in ("truth", "prediction"))
            for panel, title in zip(panels, titles, strict=True):
                panel.set_title(title, fontsize=9)
    left, right = (figure.axes[place].get_position() for place in (0, 3))  # truth of Re, prediction of Im
    height = figure.get_figheight()
    below = figure.add_axes((left.x0, (BOTTOM - 0.25) / height, right.x1 - left.x0, 0.13 / height))
    _colour_bar(figure, component, below, "Re, Im")
    return figure


def _page(rows: int, image_shape: tuple[int, ...]) -> tuple[Figure, GridSpec]:
    """An empty figure, and its grid of panels, whose shape is that of the (H, W) images."""
    panel_height = PANEL * image_shape[0] / image_shape[1]
    width = LEFT + sum(WIDTHS) + BESIDE * (len(WIDTHS) - 1) + RIGHT
    height = TOP + rows * panel_height + (rows - 1) * BETWEEN + BOTTOM
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    grid = GridSpec(
        *(rows, len(WIDTHS), figure),
        width_ratios=WIDTHS,
        left=LEFT / width,
        right=1 - RIGHT / width,
        top=1 - TOP / height,
        bottom=BOTTOM / height,
        wspace=BESIDE * len(WIDTHS) / sum(WIDTHS),  # matplotlib measures it in mean widths of the columns
        hspace=BETWEEN / panel_height,
    )
    return figure, grid


def _draw_scene(panels: Sequence[Axes], scene: ShownScene) -> tuple[AxesImage, AxesImage]:
    """Draw the six panels of a scene; the images of Im and depth, for their colour bars."""
    range_m = depth_range(scene.truth, scene.prediction)
    for first, view in ((0, scene.truth), (1, scene.prediction)):
        component, depth = draw_view(panels[first::2], view, range_m)
        finish_panels(panels[first::2])
    metrics = scene.result.prediction
    panels[-1].text(
        *(0.03, 0.95),
        f"MAE {100 * metrics.depth_mae_m:.1f} cm\nmIoU {metrics.miou:.3f}",
        transform=panels[-1].transAxes,
        va="top",
        fontsize=7.5,
        bbox={"boxstyle": "round,pad=0.3", "facecolor": "white", "linewidth": 0.6, "alpha": 0.9},
    )
    label = f"{scene.result.scene}\n{short_name(scene.result.object_class)}\n{scene.rank}"
    panels[0].set_ylabel(plain(label), fontsize=8, rotation=0, ha="right", va="center", labelpad=6)
    return component, depth


def _colour_bar(figure: Figure, image: AxesImage, axes: Axes, label: str) -> None:
    """A colour bar in axes of its own: of depth upright, with open ends; of Re and Im lying."""
    of_depth = label == DEPTH_UNIT
    bar = figure.colorbar(
        image,
        cax=axes,
        orientation="vertical" if of_depth else "horizontal",
        extend="both" if of_depth else "neither",
    )
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=8)
    bar.locator = MaxNLocator(4 if of_depth else 8)
