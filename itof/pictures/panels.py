"""Drawn with Pillow, in milliseconds: images of numbers with a bar of colours, and text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from itof.arrays import Bools, Reals

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

WHITE, INK, PALE, BACKGROUND = (255, 255, 255), (30, 30, 30), (225, 225, 225), (224, 224, 224)
TEXT: Final = 14  # height of letters, pixels
BESIDE_TEXT: Final = 5
_BAR: Final = 12
_WIDTH: Final = 330  # of a panel, pixels, about
_LARGEST: Final = 660
_ASPECT: Final = (0.4, 1.6)  # height over width of a panel; longer images are squeezed
HEAD, FOOT = TEXT + BESIDE_TEXT, _BAR + TEXT + 3 * BESIDE_TEXT  # around an image: its title; its colours


@dataclass(frozen=True)
class Colours:
    """Name of a colour map of matplotlib, and the values at its ends."""

    name: str
    low: float
    high: float

    def of(self, values: Reals) -> NDArray[np.uint8]:
        """(..., 3) RGB of values (...); NaN has the colour of the background."""
        span = max(self.high - self.low, 1e-12)
        known = np.isfinite(values)
        level = 255 * np.clip((np.where(known, values, self.low) - self.low) / span, 0, 1)
        colours: NDArray[np.uint8] = _table(self.name)[level.astype(np.uint8)]
        colours[~known] = BACKGROUND
        return colours


@lru_cache
def _table(name: str) -> NDArray[np.uint8]:
    """(256, 3) RGB of a colour map of matplotlib."""
    colours: NDArray[np.uint8] = mpl.colormaps[name](np.arange(256), bytes=True)[:, :3]
    return colours


@lru_cache
def font(height: int = TEXT) -> Any:
    """A font with Latin, Greek and Cyrillic letters; it draws a box for others."""
    return ImageFont.truetype(f"{mpl.get_data_path()}/fonts/ttf/DejaVuSans.ttf", height)


def wrapped(text: str, width: int) -> list[str]:
    """Lines of a text that are at most `width` pixels wide, if no word is wider."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and font().getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def draw_panel(
    page: Picture,
    corner: tuple[int, int],
    size: tuple[int, int],
    title: str,
    values: Reals | None,
    colours: Colours,
    outline: Bools | None = None,
) -> None:
    """Draw an image (H, W) of numbers, its title above and a bar of its colours below.

    Parameters
    ----------
    corner, size : the upper left corner of the title; width and height of the image, pixels.
    values : NaN where nothing is drawn; None if nothing is known.
    outline : (H, W) pixels around which a line is drawn.
    """
    (x, y), (width, height), pen = corner, size, ImageDraw.Draw(page)
    pen.text((x, y), title, INK, font())
    y += HEAD
    if values is None:
        pen.rectangle((x, y, x + width - 1, y + height - 1), BACKGROUND)
        pen.text((x + width / 2, y + height / 2), "unknown", INK, font(), anchor="mm")
        return
    picture = Image.fromarray(colours.of(values)).resize(size, Image.Resampling.NEAREST)
    if outline is not None:
        line = Image.fromarray(edges(np.asarray(Image.fromarray(outline).resize(size))))
        picture.paste(Image.new("RGB", size, (255, 60, 60)), mask=line)
    page.paste(picture, (x, y))
    y += height + BESIDE_TEXT
    ramp = np.linspace(colours.low, colours.high, width)[None].repeat(_BAR, axis=0)
    page.paste(Image.fromarray(colours.of(ramp)), (x, y))
    y += _BAR + BESIDE_TEXT
    digits = max(0, min(3, 1 - int(np.floor(np.log10(max(colours.high - colours.low, 1e-3))))))
    middle = (colours.low + colours.high) / 2
    for place, value, anchor in ((0, colours.low, "la"), (0.5, middle, "ma"), (1, colours.high, "ra")):
        pen.text((x + place * width, y), f"{value:.{digits}f}", INK, font(), anchor=anchor)


def panel_size(rows: int, columns: int) -> tuple[int, int]:
    """Width and height of the panel of an image, pixels: a whole number for each column if it is small."""
    width = min(columns * max(1, round(_WIDTH / columns)), _LARGEST)
    return width, round(width * float(np.clip(rows / columns, *_ASPECT)))


def panel_png(title: str, values: Reals, colour_map: str) -> bytes:
    """One panel as a PNG file: (H, W) numbers, NaN where there are none."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    size = panel_size(*values.shape)
    page = Image.new("RGB", (size[0] + 2 * BESIDE_TEXT, HEAD + size[1] + FOOT), WHITE)
    draw_panel(page, (BESIDE_TEXT, 0), size, title, values, Colours(colour_map, low, high))
    content = BytesIO()
    page.save(content, "PNG")
    return content.getvalue()


def edges(mask: Bools) -> Bools:
    """(H, W) pixels of a mask that have a neighbour beside it."""
    padded = np.pad(mask, 1)
    inside = padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    found: Bools = mask & ~inside
    return found
