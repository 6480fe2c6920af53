"""Lines through pixels: where the Gauss nodes lie of the part of a pixel that shows the relay wall.

A pixel without an edge has two lines. Through one with edges, the free part of a line changes smoothly with y
except where an edge crosses a side of the pixel, so each stretch between these places has lines of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.batch.corners import Corners

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_FEW: Final = 2  # lines of a pixel without edges: with as many nodes on each, exact for cubic polynomials
_MANY: Final = 4  # of a stretch between two edges
_SHORTEST: Final = 1e-9  # stretch, of a pixel


@dataclass(frozen=True)
class PixelLines:
    """The lines of all pixels of N images.

    Attributes
    ----------
    first, last : (N H W,) of each pixel; none where the relay wall is not seen.
    lines : (L, 8) y and weight of a line and two spare numbers, then first and last x of both parts of it
        that show the wall. The weights of a pixel's lines sum to 1.
    """

    first: Ints
    last: Ints
    lines: Floats

    @classmethod
    def of(cls, corners: Corners, width: int, height: int) -> PixelLines:
        """The lines of images with square pixels."""
        node, weight = np.polynomial.legendre.leggauss(_FEW)
        edge = corners.half / corners.aspect
        y = ((np.arange(height)[:, None] + 0.5 + node / 2) / height * 2 - 1) * edge[:, None, None]
        whole = np.zeros((*y.shape, 8))  # (N, H, _FEW, 8)
        whole[..., 0], whole[..., 1] = y, weight / 2
        side = corners.half[:, None, None]
        whole[..., 4], whole[..., 5], whole[..., 6], whole[..., 7] = -side, side, side, side
        count = len(corners.half)
        first = np.broadcast_to(_FEW * np.arange(count * height)[:, None], (count * height, width))
        first = first.reshape(count, height, width).copy()
        last = first + _FEW
        cut = np.flatnonzero(corners.shows_edges())
        lines = [whole.reshape(-1, 8)]
        if len(cut):
            is_whole, is_dark = _seen(corners.some(cut), width, height)
            last[cut] = np.where(is_dark, first[cut], last[cut])
            scene, row, column = np.nonzero(~is_whole & ~is_dark)
            scene = cut[scene]
            own, number = _own_lines(corners.some(scene), row, column, width, height)
            begin = len(lines[0]) + np.searchsorted(number, np.arange(len(scene)))
            end = len(lines[0]) + np.searchsorted(number, np.arange(len(scene)), side="right")
            first[scene, row, column], last[scene, row, column] = begin, end
            lines.append(own)
        return cls(first.ravel(), last.ravel(), np.concatenate(lines))


def _seen(corners: Corners, width: int, height: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(N, H, W) which pixels show the wall alone, and which show none of it, on three lines of each row."""
    y = (np.arange(2 * height + 1) / height - 1) * (corners.half / corners.aspect)[:, None]
    first, last = (end[..., None, :] for end in np.moveaxis(corners.visible(y), -1, 0))  # (N, R, 1, 2)
    sides = (np.arange(width + 1) * 2 / width - 1) * corners.half[:, None, None]
    left, right = sides[..., :-1, None], sides[..., 1:, None]  # (N, 1, W, 1)
    rounded = 1e-9 * corners.half[:, None, None, None]
    covers = ((first <= left + rounded) & (last >= right - rounded)).any(-1)  # (N, R, W)
    touches = ((last > left) & (first < right) & (last > first)).any(-1)
    whole, some = (np.stack([each[:, :-1:2], each[:, 1::2], each[:, 2::2]]) for each in (covers, touches))
    return whole.all(0), ~some.any(0)


def _own_lines(corners: Corners, row: Ints, column: Ints, width: int, height: int) -> tuple[Floats, Ints]:
    """(L, 8) lines of M pixels, each in front of its own of M corners, and the number (L,) of the pixel."""
    size = 2 * corners.half / width
    left, top = (column - width / 2) * size, (row - height / 2) * size
    edges = corners.edges()  # (M, K, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = [-(edges[..., 0] * x[:, None] + edges[..., 2]) / edges[..., 1] for x in (left, left + size)]
    places = np.concatenate([*crossed, np.stack([top, top + size], axis=1)], axis=1)
    places = np.where(np.isfinite(places), places, top[:, None])
    places = np.sort(np.clip(places, top[:, None], (top + size)[:, None]), axis=1)
    number, stretch = np.nonzero(np.diff(places, axis=1) > _SHORTEST * size[:, None])
    begin, end = places[number, stretch], places[number, stretch + 1]
    node, weight = np.polynomial.legendre.leggauss(_MANY)
    y = (begin + end)[:, None] / 2 + (end - begin)[:, None] / 2 * node  # (S, _MANY)
    lines = np.zeros((*y.shape, 8))
    lines[..., 0], lines[..., 1] = y, (end - begin)[:, None] / 2 * weight / size[number, None]
    lines[..., 4:] = corners.some(number).visible(y).reshape(*y.shape, 4)
    return lines.reshape(-1, 8), np.repeat(number, _MANY)
