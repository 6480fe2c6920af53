"""Lines through pixels: where the Gauss nodes lie of the part of a pixel that shows the relay wall.

A pixel without an edge has two lines. Through one with edges, the free part of a line changes smoothly with y
except where an edge crosses a side of the pixel or another edge, so each stretch between these places has
lines of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from render.walls.corners import Corners

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_FEW: Final = 2  # lines of a pixel without edges: with as many nodes on each, exact for cubic polynomials
_MANY: Final = 4  # of a stretch
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


def crossed_pixels(corner: Corners, width: int, height: int) -> Ints:
    """Row-major indices of the pixels of one corner's image that a straight line through an edge crosses."""
    sides = [(np.arange(count + 1) * 2 / count - 1) for count in (width, height)]
    x, y = sides[0] * corner.half, sides[1] * corner.half / corner.aspect
    found = np.zeros((height, width), bool)
    for edge in corner.edges()[0] / np.linalg.norm(corner.edges()[0], axis=1, keepdims=True):
        off = edge[0] * x + (edge[1] * y + edge[2])[:, None]  # (H + 1, W + 1)
        four = np.stack([off[:-1, :-1], off[:-1, 1:], off[1:, :-1], off[1:, 1:]])
        found |= (four.min(0) < _SHORTEST) & (four.max(0) > -_SHORTEST)
    return np.flatnonzero(found)


def free_nodes(
    corner: Corners, pixels: Ints, width: int, height: int, order: int
) -> tuple[Floats, Floats, Ints]:
    """Gauss nodes of the parts of pixels that show the relay wall of one corner.

    Parameters
    ----------
    pixels : (M,) row-major indices.
    order : lines of each stretch, and nodes of each free part of a line.

    Returns
    -------
    (N, 2) film positions, x and y from 0 to 1; (N,) shares of the pixel; (N,) row-major index of the pixel.
    """
    row, column = np.divmod(pixels, width)
    lines, number = _own_lines(corner.some(0 * pixels), row, column, width, height, order)
    left = (column[number] * 2 / width - 1) * corner.half
    size = 2 * corner.half / width
    node, weight = np.polynomial.legendre.leggauss(order)
    found = []
    for part in (lines[:, 4:6], lines[:, 6:8]):
        begin, end = np.maximum(part[:, 0], left), np.minimum(part[:, 1], left + size)
        free = np.flatnonzero(end > begin)
        half = ((end - begin) / 2)[free, None]
        x = ((begin + end) / 2)[free, None] + half * node
        y = np.broadcast_to(lines[free, :1], x.shape)
        share = half / size * weight * lines[free, 1:2]
        found.append((x, y, share, np.broadcast_to(pixels[number[free], None], x.shape)))
    x, y, share, pixel = (np.concatenate(each).ravel() for each in zip(*found, strict=True))
    film = np.stack([x, y * corner.aspect], axis=-1) / corner.half
    return (film + 1) / 2, share, pixel


def _own_lines(
    corners: Corners, row: Ints, column: Ints, width: int, height: int, count: int = _MANY
) -> tuple[Floats, Ints]:
    """(L, 8) lines of M pixels, each in front of its own of M corners, and the number (L,) of the pixel.

    `count` are those of a stretch.
    """
    size = 2 * corners.half / width
    left, top = (column - width / 2) * size, (row - height / 2) * size
    edges = corners.edges()  # (M, K, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = [-(edges[..., 0] * x[:, None] + edges[..., 2]) / edges[..., 1] for x in (left, left + size)]
    one, two = np.triu_indices(edges.shape[1], 1)
    corner = np.cross(edges[:, one], edges[:, two])
    with np.errstate(divide="ignore", invalid="ignore"):
        x, meeting = np.moveaxis(corner[..., :2] / corner[..., 2:], -1, 0)
    inside = (x > left[:, None]) & (x < (left + size)[:, None])
    meeting = np.where(inside, meeting, top[:, None])
    places = np.concatenate([*crossed, meeting, np.stack([top, top + size], axis=1)], axis=1)
    places = np.where(np.isfinite(places), places, top[:, None])
    places = np.sort(np.clip(places, top[:, None], (top + size)[:, None]), axis=1)
    number, stretch = np.nonzero(np.diff(places, axis=1) > _SHORTEST * size[:, None])
    begin, end = places[number, stretch], places[number, stretch + 1]
    node, weight = np.polynomial.legendre.leggauss(count)
    y = (begin + end)[:, None] / 2 + (end - begin)[:, None] / 2 * node  # (S, count)
    lines = np.zeros((*y.shape, 8))
    lines[..., 0], lines[..., 1] = y, (end - begin)[:, None] / 2 * weight / size[number, None]
    lines[..., 4:] = corners.some(number).visible(y).reshape(*y.shape, 4)
    return lines.reshape(-1, 8), np.repeat(number, count)
