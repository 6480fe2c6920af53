"""The contact sheet of a dataset: which scenes it shows, and the figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from render.products.tiles import PICTURE_SIZE, Tile, is_rendered
from scenegen import Dataset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

_TILES_ACROSS = 2
_CELL_INCHES = (1.6, 1.2)
_BLANK = "0.92"  # grey of background pixels and of empty cells


def choose_scenes(dataset: Dataset, count: int) -> list[str]:
    """Ids of `count` scenes in ascending order, or of all scenes if there are fewer.

    Classes get equal numbers of scenes. In a class, rendered scenes come first, then scenes of the split that
    has the fewest so far. Equal datasets give equal choices. Frames of a sequence are taken at equal steps.
    """
    if dataset.preset.is_sequence:
        ids = dataset.ids()
        return ids[:: -(-len(ids) // count)]
    left = {
        entry.id: (entry.object_class, entry.split, not is_rendered(dataset, entry.id))
        for entry in dataset.index.scenes
    }
    taken: Counter[str] = Counter()

    def order(scene_id: str) -> tuple[int, bool, int, str]:
        object_class, split, is_missing = left[scene_id]
        return taken[object_class], is_missing, taken[split], scene_id

    chosen: list[str] = []
    while left and len(chosen) < count:
        chosen.append(min(left, key=order))
        object_class, split, _ = left.pop(chosen[-1])
        taken.update((object_class, split))
    return sorted(chosen)


def contact_sheet(tiles: Sequence[Tile]) -> Figure:
    """The figure: two scenes per row, four pictures per scene.

    Depth has one colour scale for all scenes. Each camera image and each hidden signal has its own scale, up
    to its maximum.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = -(-len(tiles) // _TILES_ACROSS)
    across = min(_TILES_ACROSS, len(tiles))
    width, height = _CELL_INCHES
    figure = Figure(figsize=((4 * across + 0.35 * (across - 1) + 0.3) * width, rows * (height + 0.26) + 1.0))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows,
        5 * across - 1,
        width_ratios=([1, 1, 1, 1, 0.35] * across)[:-1],
        left=0.01,
        right=0.99,
        top=1 - 0.48 / figure.get_figheight(),
        bottom=0.56 / figure.get_figheight(),
        wspace=0.04,
        hspace=0.26 / height,
    )
    range_m = _depth_range_m(tiles)
    depth = None
    for index, tile in enumerate(tiles):
        row, column = divmod(index, _TILES_ACROSS)
        axes = [figure.add_subplot(grid[row, 5 * column + cell]) for cell in range(4)]
        drawn = _draw(axes, tile, range_m)
        depth = drawn or depth
        if row == 0:
            _head(axes, tiles)
    if depth is not None:
        place = figure.add_axes((0.36, 0.36 / figure.get_figheight(), 0.28, 0.09 / figure.get_figheight()))
        figure.colorbar(depth, cax=place, orientation="horizontal").set_label("radial depth, m", fontsize=8)
        place.tick_params(labelsize=7)
    return figure


def _draw(axes: Sequence[Axes], tile: Tile, range_m: tuple[float, float]) -> AxesImage | None:
    """Draw a tile; return the picture of the depth, which the colour bar needs."""
    axes[0].set_title(tile.title, loc="left", fontsize=8, pad=3)
    axes[0].imshow(tile.view)
    depth = None
    for panel, values, colours in (
        (axes[1], tile.measured, "gray"),
        (axes[2], tile.hidden, "magma"),
        (axes[3], tile.radial_depth_m, "viridis"),
    ):
        panel.set_facecolor(_BLANK)
        if values is None:
            panel.set_box_aspect(PICTURE_SIZE[1] / PICTURE_SIZE[0])
            panel.text(0.5, 0.5, "not rendered", ha="center", va="center", fontsize=8, color="0.4")
        elif panel is axes[3]:
            depth = panel.imshow(values, cmap=colours, vmin=range_m[0], vmax=range_m[1])
        else:
            panel.imshow(values, cmap=colours, vmin=0, vmax=max(float(values.max()), 1e-30))
    for panel in axes:
        panel.set(xticks=[], yticks=[])
        panel.spines[:].set_visible(False)
    return depth


def _head(axes: Sequence[Axes], tiles: Sequence[Tile]) -> None:
    """Write the titles of the columns above the first row."""
    residual = "residual of the wall" if any(tile.hidden_is_residual for tile in tiles) else "hidden signal"
    names = ("scene, walls cut away", "camera image", residual, "ground-truth depth")
    for panel, name in zip(axes, names, strict=True):
        panel.annotate(
            name,
            (0.5, 1.0),
            xytext=(0, 17),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="center",
            fontsize=9,
            fontweight="bold",
        )


def _depth_range_m(tiles: Sequence[Tile]) -> tuple[float, float]:
    depths = [tile.radial_depth_m for tile in tiles if tile.radial_depth_m is not None]
    seen = [depth_m[np.isfinite(depth_m)] for depth_m in depths]
    found_m = np.concatenate(seen) if seen else np.empty(0)
    return (float(found_m.min()), float(found_m.max())) if len(found_m) else (0.0, 1.0)
