"""The transient vector of a pixel as a picture: light over time, its direct and its hidden part apart.

Source: Caligiuri et al. 2024, sec. 3.2 (transient vector, direct and global component).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from disk import PathLike
from itof import SPEED_OF_LIGHT, WIDEST_REACH_BINS, TransientLayout, TransientReader
from itof.pictures.png import save_png
from render.products.conversion import ExportError, exported_file, open_transient
from render.products.rendered_scene import rendered_scene
from render.products.transient_parts import first_hidden_bin, hidden_start_m
from scenegen import Dataset, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DIRECT, _HIDDEN = "#4477aa", "#ee6677"
_DOTS_PER_INCH = 110
# Interpolation blurs light over two bins (docs/science/renderer.md, Time-resolved output). Only 4e-6 of
# the hidden light of a pixel came earlier than that (docs/reference/files.md).
_BLUR_BINS = 2.0
_FAINTEST = 1e-3  # of the brightest hidden bin: the lower end of the axis
_NS_PER_M = 1e9 / SPEED_OF_LIGHT


@dataclass(frozen=True)
class PixelTransient:
    """The transient vector of a pixel, and its two parts.

    Attributes
    ----------
    column, row : the pixel, from 0 at the upper left.
    opl_m : (T + 1,) edges of the bins in optical path length, metres.
    direct, hidden : (T,) radiance per bin, W m^-2 sr^-1; a bin belongs to one of them.
    """

    column: int
    row: int
    opl_m: NDArray[np.float64]
    direct: NDArray[np.float64]
    hidden: NDArray[np.float64]

    @property
    def hidden_share(self) -> float:
        """Hidden light of the pixel relative to all its light."""
        return float(self.hidden.sum() / (self.direct.sum() + self.hidden.sum()))

    def sentence(self, scene_id: str) -> str:
        """What the pixel is, and its share of hidden light."""
        return (
            f"scene {scene_id}, pixel {self.column},{self.row}: "
            f"{self.hidden_share:.2g} of the light is hidden light"
        )


def pixel_transient(dataset: Dataset, scene_id: str, pixel: tuple[int, int] | None = None) -> PixelTransient:
    """The transient vector of a pixel of a rendered scene.

    Parameters
    ----------
    pixel : (column, row) from 0 at the upper left; None takes the pixel with the most hidden light.

    Raises
    ------
    ExportError : the scene has no transient, or its files are not those that were rendered; the image has no
        such pixel, the pixel has no light, or its direct and hidden light share bins.
    RenderFileError, ImageFileError, DatasetError, RenderError : a file is missing or damaged.
    """
    with open_transient(dataset, scene_id) as reader:
        layout, scene = reader.layout, rendered_scene(dataset, scene_id)
        first_hidden = first_hidden_bin(scene, layout)
        column, row = _brightest(reader, first_hidden) if pixel is None else _inside(pixel, layout)
        bins = reader.read_rows(row, row + 1)[0, column].astype(np.float64)  # (T,)
        _refuse_not_finite(bins, reader)
    where = f"pixel {column},{row} of scene {scene_id}"
    if not bins.sum() > 0:
        raise ExportError(f"{where} has no light: choose another pixel")
    first = int(first_hidden[row, column])
    _refuse_overlap(where, dataset, scene, layout, (column, row), first)
    is_direct = np.arange(layout.bin_count) < first
    edges_m = layout.start_opl_m + np.arange(layout.bin_count + 1) * layout.bin_width_m
    return PixelTransient(column, row, edges_m, np.where(is_direct, bins, 0), np.where(is_direct, 0, bins))


def write_transient_plot(
    dataset: Dataset, scene_id: str, out: PathLike, pixel: tuple[int, int] | None = None
) -> PixelTransient:
    """Draw the transient vector of a pixel into a PNG file; see `pixel_transient`.

    Raises
    ------
    ExportError : as `pixel_transient`, and where `out` is not a .png file or cannot be written.
    """
    if Path(out).suffix.lower() != ".png":
        raise ExportError(f"a plot is a .png file: cannot write {out}")
    found = pixel_transient(dataset, scene_id, pixel)
    figure = transient_figure(found, scene_id)
    with exported_file(out) as partial:
        save_png(figure, partial, _DOTS_PER_INCH)
    return found


def transient_figure(found: PixelTransient, scene_id: str) -> Figure:
    """Light per bin over time in ns and optical path length in m, on a logarithmic scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    low, high = _visible_range(found)
    for values, colour, name, share in (
        (found.direct, _DIRECT, "direct", 1 - found.hidden_share),
        (found.hidden, _HIDDEN, "hidden", found.hidden_share),
    ):
        shown = np.maximum(values, low)  # the axis has no zero
        label = f"{name}: {100 * share:.3g} % of the light"
        edges_ns = _nanoseconds(found.opl_m)
        panel.stairs(shown, edges_ns, baseline=low, fill=True, color=colour, alpha=0.35)
        panel.stairs(shown, edges_ns, baseline=low, color=colour, linewidth=1, label=label)
    lit = np.flatnonzero(found.direct + found.hidden > low)
    start_m, end_m = found.opl_m[lit[0]], found.opl_m[lit[-1] + 1]
    margin_m = 0.05 * (end_m - start_m)
    panel.set(
        yscale="log",
        xlim=((start_m - margin_m) * _NS_PER_M, (end_m + margin_m) * _NS_PER_M),
        ylim=(low, high),
        xlabel="time, ns",
        ylabel="radiance per bin, W m$^{-2}$ sr$^{-1}$",
        title=f"scene {scene_id}, pixel {found.column},{found.row}",
    )
    above = panel.secondary_xaxis("top", (_metres, _nanoseconds))
    above.set_xlabel("optical path length, m")
    panel.spines["right"].set_visible(False)
    panel.legend(frameon=False)
    return figure


def _metres(time_ns: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(time_ns, np.float64) / _NS_PER_M


def _nanoseconds(opl_m: ArrayLike) -> NDArray[np.float64]:
    return np.asarray(opl_m, np.float64) * _NS_PER_M


def _visible_range(found: PixelTransient) -> tuple[float, float]:
    """Lower and upper end of the axis of light."""
    brightest = max(found.direct.max(), found.hidden.max())
    faint = found.hidden.max() if found.hidden.max() > 0 else brightest
    return float(faint * _FAINTEST), float(brightest * 3)


def _brightest(reader: TransientReader, first_hidden: NDArray[np.int64]) -> tuple[int, int]:
    """(column, row) of the pixel with the most hidden light; the file is read once, in blocks of rows."""
    numbers = np.arange(reader.layout.bin_count)
    hidden: list[NDArray[np.float64]] = []
    for rows in reader.row_blocks():
        _refuse_not_finite(rows, reader)
        for image_row in rows:
            later = numbers >= first_hidden[len(hidden)][:, None]  # (W, T)
            hidden.append(np.sum(image_row, axis=-1, where=later, dtype=np.float64))
    row, column = np.unravel_index(np.argmax(hidden), first_hidden.shape)
    return int(column), int(row)


def _inside(pixel: tuple[int, int], layout: TransientLayout) -> tuple[int, int]:
    column, row = pixel
    if not (0 <= column < layout.width and 0 <= row < layout.height):
        raise ExportError(
            f"the image has no pixel {column},{row}: its pixels are 0,0 to {layout.width - 1},"
            f"{layout.height - 1}"
        )
    return column, row


def _refuse_not_finite(values: NDArray[np.floating], reader: TransientReader) -> None:
    if not np.isfinite(values).all():
        raise ExportError(f"{reader.path} holds NaN or infinity: render it again")


def _refuse_overlap(
    where: str,
    dataset: Dataset,
    scene: Scene,
    layout: TransientLayout,
    pixel: tuple[int, int],
    first_hidden: int,
) -> None:
    """Refuse a pixel whose hidden light may begin before its direct return has ended."""
    column, row = pixel
    start_m = hidden_start_m(dataset, scene, layout, row, column)
    begins = (start_m - layout.start_opl_m) / layout.bin_width_m - WIDEST_REACH_BINS - _BLUR_BINS
    if begins < first_hidden - 0.5:
        raise ExportError(
            f"{where} may have direct and hidden light in the same bins, so bins do not tell them apart: "
            "choose another pixel, or render smaller pixels or finer bins"
        )
