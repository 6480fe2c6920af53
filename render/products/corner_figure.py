"""The corner of a preset as a picture: from above and from the side, with its distances."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from disk import PathLike
from itof.pictures.png import save_png
from render.products.conversion import exported_file
from render.products.corner_facts import CornerFacts
from render.products.corner_shapes import CAMERA, LIT, CornerShapes, Solid
from scenegen import Preset
from scenegen.corner_geometry import Points
from scenegen.pose import wall_normal
from scenegen.sampling import walls_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DOTS_PER_INCH = 150


def write_corner_figure(preset: Preset, facts: CornerFacts, said: Sequence[str], file: PathLike) -> None:
    """Draw the corner of a preset from above and from the side, with what is `said` of it, into a PNG file.

    Raises
    ------
    ExportError : `file` cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    FigureCanvasAgg(figure)
    plan, side = figure.subplots(1, 2)
    across = wall_normal(walls_of(preset)[0])[:2]
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-6 else np.array([1.0, 0.0])
    shapes = CornerShapes.of(preset, facts)
    _view(plan, shapes, np.eye(3)[:2], "from above", ("x, m", "y, m"))
    onto = np.array([[*across, 0.0], [0.0, 0.0, 1.0]])
    _view(side, shapes, onto, "from the side", ("into the room, m", "z, m"))
    handles, names = plan.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle("\n".join(said), fontsize=10)
    with exported_file(file) as partial:
        save_png(figure, partial, _DOTS_PER_INCH)


def _view(
    axes: Axes, shapes: CornerShapes, onto: NDArray[np.float64], title: str, labels: tuple[str, str]
) -> None:
    """Draw everything in a projection (2, 3)."""
    for solid in shapes.solids:
        _outline(axes, solid, solid.points @ onto.T)
    axes.plot(*onto @ shapes.lit.T, ".", color=LIT, markersize=3, label="seen and lit", zorder=3)
    axes.plot(*(onto @ shapes.eye), "o", color=CAMERA, markersize=8, label="camera", zorder=5)
    for (ends, words), above in zip(shapes.distances, ("bottom", "bottom", "top"), strict=True):
        line = ends @ onto.T
        axes.plot(*line.T, "--", color="0.4", linewidth=0.9, zorder=4)
        axes.annotate(words, line.mean(axis=0), ha="center", va=above, fontsize=8, zorder=6)
    axes.set(title=title, xlabel=labels[0], ylabel=labels[1], aspect="equal")
    axes.grid(color="0.92", zorder=0)


def _outline(axes: Axes, solid: Solid, points: Points) -> None:
    """The convex outline of points (N, 2), which is a line if they are on one."""
    try:
        points = points[ConvexHull(points).vertices]
    except QhullError:
        far = np.linalg.norm(points - points.mean(axis=0), axis=1).argmax()
        other = np.linalg.norm(points - points[far], axis=1).argmax()
        points = points[[far, other]]
    if solid.filled and len(points) > 2:
        axes.fill(*points.T, color=solid.colour, alpha=0.15, linewidth=0, zorder=1)
    around = np.vstack([points, points[:1]]).T
    style = ":" if solid.dotted else "-"
    axes.plot(*around, style, color=solid.colour, linewidth=solid.width, label=solid.name, zorder=2)
