"""A film of depth maps side by side, in the 256 colours of a GIF: none changes from frame to frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from disk import PathLike, whole_file
from itof import DepthMap
from itof.pictures.figures import BACKGROUND
from itof.pictures.film import encode_film

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

MOST_FRAMES: Final = 300  # of a film that is of use in a page
_COLOURS, _GREYS = 224, 32  # of the 256 of a GIF: of the depth, and of all else
_LEAST_WIDTH: Final = 320  # pixels of a depth map; smaller ones are enlarged by a whole number
_MARGIN, _LINE, _BAR = 8, 20, 10  # pixels: around all, of a line of text, of the colour bar
_TOP = _MARGIN + 2 * _LINE  # of the depth maps
Levels = NDArray[np.uint8]  # (H, W) places in the palette


@dataclass(frozen=True)
class FilmFrame:
    """A moment of a film: a line of text, and (H, W) depth maps by the names that stand above them."""

    caption: str
    views: Mapping[str, DepthMap]


def write_depth_film(
    file: PathLike, frames: Iterable[FilmFrame], frames_per_second: float, range_m: tuple[float, float]
) -> None:
    """Write a film whole or not at all, as `film.encode_film` does.

    Radial depth is coloured inside the mask, and what lies beyond the ends of the colours has those.

    Parameters
    ----------
    frames : at least one; all have views of the same names and sizes.
    range_m : radial depths at the ends of the colours, metres, of all frames; see `figures.depth_range`.
    """
    with whole_file(file) as partial:
        encode_film(partial, _pictures(frames, range_m), frames_per_second)


def _pictures(frames: Iterable[FilmFrame], range_m: tuple[float, float]) -> Iterator[Picture]:
    """The frames, as places in one palette: each is the page with depth maps and a caption."""
    from PIL import Image

    page = None
    for frame in frames:
        views = [_enlarged(depth_levels(view, range_m)) for view in frame.views.values()]
        height, width = views[0].shape
        if page is None:
            page = _page([*frame.views], height, width, range_m)
        drawn = page.copy()
        for place, view in enumerate(views):
            left = _MARGIN + place * (width + _MARGIN)
            drawn[_TOP : _TOP + height, left : left + width] = view
        _write(drawn, (_MARGIN, _MARGIN), frame.caption)
        picture = Image.fromarray(drawn).convert("P")
        picture.putpalette(depth_palette())
        yield picture


def _page(names: list[str], height: int, width: int, range_m: tuple[float, float]) -> Levels:
    """A white page with the names of the depth maps and the colour bar."""
    foot = _TOP + height + _MARGIN
    right = _MARGIN + len(names) * (width + _MARGIN)
    page = np.full((foot + _BAR + _LINE + _MARGIN, right), _COLOURS + _GREYS - 1, np.uint8)
    for place, name in enumerate(names):
        _write(page, (_MARGIN + place * (width + _MARGIN), _MARGIN + _LINE), name)
    wide = right - 2 * _MARGIN
    page[foot : foot + _BAR, _MARGIN:-_MARGIN] = np.linspace(0, _COLOURS - 1, wide).round()
    near_m, far_m = range_m
    for share, anchor in ((0, "la"), (0.5, "ma"), (1, "ra")):
        place_xy = (_MARGIN + share * wide, foot + _BAR + 2)
        _write(page, place_xy, f"{near_m + share * (far_m - near_m):.2f} m", anchor)
    return page


def _write(page: Levels, place_xy: tuple[float, float], words: str, anchor: str = "la") -> None:
    """Write black words on a white part of a page."""
    from PIL import Image, ImageDraw, ImageFont

    ink = Image.new("L", (page.shape[1], page.shape[0]))
    ImageDraw.Draw(ink).text(place_xy, words, font=ImageFont.load_default(13), fill=255, anchor=anchor)
    grey = (255 - np.asarray(ink, np.float64)) / 255
    page[grey < 1] = (_COLOURS + grey[grey < 1] * (_GREYS - 1)).round()


def depth_palette() -> bytes:
    """256 colours: of the depth from near to far, then from black to white."""
    from matplotlib import colormaps

    depth = colormaps["viridis"](np.linspace(0, 1, _COLOURS))[:, :3]
    grey = np.repeat(np.linspace(0, 1, _GREYS)[:, None], 3, axis=1)
    return (255 * np.concatenate([depth, grey])).round().astype(np.uint8).tobytes()


def depth_levels(view: DepthMap, range_m: tuple[float, float]) -> Levels:
    """(H, W) colours of a depth map."""
    near_m, far_m = range_m
    share = np.clip((view.radial_depth_m - near_m) / (far_m - near_m), 0, 1)
    level = np.where(view.mask, share * (_COLOURS - 1), _COLOURS + float(BACKGROUND) * (_GREYS - 1))
    return level.round().astype(np.uint8)


def _enlarged(pixels: Levels) -> Levels:
    """(H, W) pixels as squares of several, in images narrower than `_LEAST_WIDTH`."""
    times = max(1, -(-_LEAST_WIDTH // pixels.shape[1]))
    return pixels.repeat(times, axis=0).repeat(times, axis=1)
