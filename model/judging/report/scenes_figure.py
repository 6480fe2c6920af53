"""Truth and prediction of scenes, one scene in each row, as in Fig. 5 (paper)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from itof import DepthMap
from itof.metrics import ImageMetrics
from itof.pictures.figures import depth_range, finish_panels, plain
from itof.pictures.panels import Colours
from model.judging.showcase import ShownScene, short_name
from model.prediction.expected_error import probabilities

# Inches: width of a panel; margins left (names of scenes), right, top (titles), bottom (bars of colours).
PANEL, LEFT, RIGHT, TOP, BOTTOM = 1.9, 1.25, 0.15, 0.5, 0.65
BETWEEN, BESIDE, APART = 0.08, 0.06, 0.32  # rows; panels of one quantity; quantities
LEAST_ERROR_CM = 0.1  # smallest end of the colours


@dataclass(frozen=True)
class Quantity:
    """What some panels show, with one scale of colours.

    Attributes
    ----------
    unit : as text; "" without one.
    values : gives the (H, W) numbers of a depth map, NaN where nothing is drawn.
    views : of whose depth maps there are panels.
    is_clipped : whether numbers beyond the ends have the colours of the ends.
    outlines : whether the outline of the true object is drawn, too.
    """

    name: str
    unit: str
    colours: Colours
    values: Callable[[DepthMap], NDArray[np.floating[Any]]]
    views: tuple[str, ...] = ("truth", "prediction")
    is_clipped: bool = False
    outlines: bool = False

    @property
    def width(self) -> float:
        """Of its panels, inches."""
        return len(self.views) * (PANEL + BESIDE) - BESIDE


def scenes_figure(shown: Sequence[ShownScene], target: str) -> Figure:
    """What the network predicts of each scene, beside its truth; a quantity has the same colours in all rows.

    For the target components these are Re, Im and radial depth, for the others the depth, with mask+depth
    also the probability of the object (with the outline of the true object) and the expected error of the
    depth. The colours of the depth span the true objects; other depths have the colour of the nearer end.

    Parameters
    ----------
    shown : scenes (H, W) of one size, at least one.
    target : kind of the target of the network (`model.settings.target`).

    Source: Caligiuri et al. 2024, Fig. 5 (layout for components); the colours are ours.
    """
    quantities = list(_quantities(shown, target))
    rows, columns = shown[0].truth.mask.shape
    panel_height = PANEL * rows / columns
    width = LEFT + sum(each.width + APART for each in quantities) - APART + RIGHT
    height = TOP + len(shown) * (panel_height + BETWEEN) - BETWEEN + BOTTOM
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)

    def axes_at(x: float, y: float, wide: float, high: float) -> Axes:
        return figure.add_axes((x / width, y / height, wide / width, high / height))

    left = LEFT
    for quantity in quantities:
        for place, whose in enumerate(quantity.views):
            x = left + place * (PANEL + BESIDE)
            panels = [
                axes_at(x, height - TOP - panel_height - row * (panel_height + BETWEEN), PANEL, panel_height)
                for row in range(len(shown))
            ]
            images = [_draw(*each, quantity, whose) for each in zip(panels, shown, strict=True)]
            finish_panels(panels)
            name = quantity.name if len(quantity.views) == 1 else f"{quantity.name}\n{whose}"
            panels[0].set_title(name, fontsize=9)
            if x == LEFT:
                _label(panels, shown)
        _colour_bar(figure, images[0], axes_at(left, BOTTOM - 0.25, quantity.width, 0.13), quantity)
        left += quantity.width + APART
    return figure


def describe(metrics: ImageMetrics) -> str:
    """MAE and mIoU of an image as text."""
    on_object = "no overlap" if metrics.object_mae_m is None else f"{100 * metrics.object_mae_m:.2f} cm"
    return (
        f"MAE {100 * metrics.depth_mae_m:.2f} cm over all pixels, {on_object} on the object, "
        f"mIoU {metrics.miou:.3f}"
    )


def _quantities(shown: Sequence[ShownScene], target: str) -> Iterator[Quantity]:
    """What is drawn of a network with this target, from left to right."""
    if target == "components":
        colours = Colours("RdBu_r", -1, 1)
        yield Quantity("Re", "", colours, lambda view: view.phasor.real)
        yield Quantity("Im", "", colours, lambda view: view.phasor.imag)
    ranges_m = [depth_range(one.truth, one.prediction) for one in shown if _shows_object(one)] or [(0.0, 1.0)]
    nears_m, fars_m = zip(*ranges_m, strict=True)
    colours = Colours("viridis", min(nears_m), max(fars_m))
    yield Quantity("radial depth", "m", colours, _depth_m, is_clipped=True)
    if target != "mask+depth":
        return
    colours, predicted = Colours("gray", 0, 1), ("prediction",)
    name = "probability\n(outline: truth)"
    yield Quantity(name, "", colours, lambda view: probabilities(view.phasor), predicted, outlines=True)
    if shown[0].prediction.depth_error_m is not None:
        most_cm = max([LEAST_ERROR_CM, *(np.nanmax(_error_cm(one.prediction), initial=0) for one in shown)])
        colours = Colours("magma", 0, most_cm)
        yield Quantity("expected error\nof the depth", "cm", colours, _error_cm, predicted)


def _shows_object(scene: ShownScene) -> bool:
    return bool(scene.truth.mask.any() or scene.prediction.mask.any())


def _depth_m(view: DepthMap) -> NDArray[np.floating[Any]]:
    """(H, W) radial depth, NaN beside the object."""
    return np.where(view.mask, view.radial_depth_m, np.nan)


def _error_cm(view: DepthMap) -> NDArray[np.floating[Any]]:
    """(H, W) expected error of the depth, NaN beside the object."""
    return np.where(view.mask, 100 * np.asarray(view.depth_error_m), np.nan)


def _draw(axes: Axes, scene: ShownScene, quantity: Quantity, whose: str) -> AxesImage:
    """Draw one panel."""
    values = quantity.values(scene.truth if whose == "truth" else scene.prediction)
    colours, truth = quantity.colours, scene.truth.mask
    if quantity.outlines and truth.any() and not truth.all():
        axes.contour(truth, levels=[0.5], colors="red", linewidths=0.8)
    return axes.imshow(
        values, cmap=colours.name, vmin=colours.low, vmax=colours.high, interpolation="nearest"
    )


def _label(panels: Sequence[Axes], shown: Sequence[ShownScene]) -> None:
    """Write name and numbers of each scene left of its row."""
    for axes, scene in zip(panels, shown, strict=True):
        result, metrics = scene.result, scene.result.prediction
        words = f"{result.scene}\n{short_name(result.object_class)}\n{scene.rank}\n"
        words += f"MAE {100 * metrics.depth_mae_m:.2f} cm\nmIoU {metrics.miou:.3f}"
        axes.set_ylabel(plain(words), fontsize=8, rotation=0, ha="right", va="center", labelpad=6)


def _colour_bar(figure: Figure, image: AxesImage, axes: Axes, quantity: Quantity) -> None:
    """A lying bar of colours in axes of its own, with open ends where numbers are clipped."""
    extend = "both" if quantity.is_clipped else "neither"
    bar = figure.colorbar(image, cax=axes, orientation="horizontal", extend=extend)
    bar.set_label(quantity.unit, fontsize=8)
    bar.ax.tick_params(labelsize=8)
    bar.locator = MaxNLocator(5)
