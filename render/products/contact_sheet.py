"""A contact sheet: some scenes of a dataset seen from outside, as measured, and in ground truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap, Image, ImageFileError, amplitude, direct_phasors, read_image
from render.settings import RenderError
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, Scene, camera_axes, wall_normal

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

PICTURE_SIZE = (288, 216)  # of Blender's view, pixels
_TILES_ACROSS = 2
_CELL_INCHES = (1.6, 1.2)
_BLANK = "0.92"  # grey of pixels without object, and of cells without picture


@dataclass(frozen=True)
class Tile:
    """What a contact sheet shows of one scene; None where it is not rendered.

    Attributes
    ----------
    title : id, class, split and roughness.
    view : (H, W, 3) uint8, the scene from outside.
    measured : (H, W) amplitude at the reference frequency.
    hidden : (H, W) amplitude of the hidden light there; if `hidden_is_residual`, the part of the
        measurement a quarter of a period behind a bare wall's return, which hidden light alone causes.
    radial_depth_m : (H, W) ground truth along the ray, NaN on background.
    """

    title: str
    view: NDArray[np.uint8]
    measured: NDArray[np.float64] | None
    hidden: NDArray[np.float64] | None
    hidden_is_residual: bool
    radial_depth_m: NDArray[np.float64] | None


def choose_scenes(dataset: Dataset, count: int) -> list[str]:
    """Ids of `count` scenes, or of all if there are fewer, in order; the choice depends on the dataset alone.

    It is even over classes; within one, rendered scenes come first, then splits that have few so far.
    """
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


def is_rendered(dataset: Dataset, scene_id: str) -> bool:
    """Whether measurement and ground truth of a scene are there."""
    folder = dataset.render_folder(scene_id)
    return (folder / MEASUREMENT_FILE).is_file() and (folder / GROUND_TRUTH_FILE).is_file()


def read_tile(dataset: Dataset, scene_id: str, view: NDArray[np.uint8]) -> Tile:
    """A scene's tile, with Blender's `view` of it.

    Raises
    ------
    ImageFileError : a render that is truncated or no EXR.
    RenderError : a render without the channels it should have, or with NaN or infinite pixels.
    """
    scene, folder = dataset.scene(scene_id), dataset.render_folder(scene_id)
    measured = hidden = depth_m = None
    is_residual = False
    if is_rendered(dataset, scene_id):
        image = read_image(folder / MEASUREMENT_FILE)
        is_residual = not any(name.startswith("hidden.") for name in image.channels)
        measured = checked_pixels(scene_id, MEASUREMENT_FILE, lambda: amplitude(image.phasors()[0][..., 0]))
        hidden = checked_pixels(scene_id, MEASUREMENT_FILE, lambda: _hidden(scene, image, is_residual))
        truth = read_ground_truth(dataset, scene_id)
        depth_m = np.where(truth.mask, truth.radial_depth_m, np.nan)
    return Tile(_title(dataset, scene), view, measured, hidden, is_residual, depth_m)


def read_ground_truth(dataset: Dataset, scene_id: str) -> DepthMap:
    """Ground truth (H, W) of a rendered scene; `ImageFileError` when it is damaged, by file."""
    return DepthMap.read(dataset.render_folder(scene_id) / GROUND_TRUTH_FILE)


def checked_pixels(
    scene_id: str, file: str, values: Callable[[], NDArray[np.floating]]
) -> NDArray[np.float64]:
    """Values of a render's pixels; `RenderError` names scene and file if they are none or not numbers."""
    try:
        found = np.asarray(values(), np.float64)
    except ImageFileError as error:
        raise RenderError(
            f"scene {scene_id}: {file} is no render of NIGHT ({error}): delete it and render it again"
        ) from None
    if not np.isfinite(found).all():
        raise RenderError(f"scene {scene_id}: {file} holds NaN or infinity: delete it and render it again")
    return found


def contact_sheet(tiles: Sequence[Tile]) -> Figure:
    """Two scenes a row, four pictures each.

    Depth has one colour scale for all; camera images and hidden signals reach white each by its own maximum.
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
    """Fill a tile; returns the picture of the depth, for its colour bar."""
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
    """What the columns show, above the first row."""
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


def _hidden(scene: Scene, image: Image, is_residual: bool) -> NDArray[np.float64]:
    """(H, W) what of the measurement is due to hidden light; see `Tile`."""
    if not is_residual:
        return amplitude(image.phasors("hidden")[0][..., 0])
    phasor, frequencies_hz = image.phasors()
    height, width = phasor.shape[:2]
    camera, wall = scene.camera, scene.relay_wall
    direct = direct_phasors(
        width,
        height,
        camera.horizontal_fov_deg,
        frequencies_hz[:1],
        camera_axes(camera),
        camera.location_m,
        wall.location_m,
        wall_normal(wall),
    )[..., 0]
    turned: NDArray[np.float64] = (phasor[..., 0] * np.exp(-1j * np.angle(direct))).imag
    return turned


def _title(dataset: Dataset, scene: Scene) -> str:
    entry, roughness = dataset.entry(scene.id), scene.relay_wall.roughness
    wall = "diffuse wall" if roughness is None else f"roughness {roughness:.2f}"
    return f"{scene.id}   {class_name(entry.object_class)}   {entry.split}   {wall}"


def class_name(object_class: str) -> str:
    """An object class as people write it, short enough for a figure."""
    name = object_class.rsplit("/", 1)[-1].replace("_", " ")
    return name if len(name) <= 24 else name[:23] + "…"
