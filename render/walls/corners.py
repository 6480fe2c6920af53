"""Corners as arrays: where the camera sees the relay wall, and the points of film and lattice there.

The axes are those of each camera: x right, y down, z forward, metres; the camera is the origin.
The film is the plane z = 1. What it sees of the relay wall in a row is the row's part in the wall's rectangle
less its part in that of the middle wall. Both obey linear inequalities: edges are exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenegen.pose import camera_axes, rotation_matrix
from scenegen.scene import Scene, Wall

Floats = NDArray[np.float64]
_ROWS: Final = 33  # in which the visible part of an image is looked for
_HALVINGS: Final = 10  # of its ends after that
_EMPTY: Final = 1e-9


@dataclass(frozen=True)
class Rectangles:
    """N rectangles: (N, 3) a corner, and two edges, metres."""

    corner: Floats
    one: Floats
    two: Floats

    @classmethod
    def of(cls, walls: Sequence[Wall], axes: Floats, origin: Floats) -> Rectangles:
        """Walls in the axes (N, 3, 3) of cameras at (N, 3)."""
        turned = np.stack([rotation_matrix(wall.rotation_deg) for wall in walls])
        size = np.array([wall.size_m for wall in walls])
        one, two = (turned[:, :, axis] * size[:, axis, None] for axis in (0, 1))
        corner = np.array([wall.location_m for wall in walls]) - (one + two) / 2 - origin
        return cls(*(np.einsum("nij,nj->ni", axes, each) for each in (corner, one, two)))

    def some(self, chosen: NDArray[np.int64]) -> Rectangles:
        """Some of the rectangles."""
        return Rectangles(self.corner[chosen], self.one[chosen], self.two[chosen])

    @cached_property
    def across(self) -> Floats:
        """(N, 3) vectors along their normals."""
        return np.cross(self.one, self.two)

    @cached_property
    def offset(self) -> Floats:
        """(N,) the products of their points with `across`."""
        offset: Floats = (self.corner * self.across).sum(-1)
        return offset

    @cached_property
    def inequalities(self) -> Floats:
        """(N, 5, 3) vectors w: the ray r meets the rectangle where w · r >= 0 for all five."""
        side, offset = np.sign(self.offset)[:, None], self.offset[:, None]
        across = self.across
        found = [side * across]
        for edge in (self.one, self.two):
            along = (self.corner * edge).sum(-1, keepdims=True)
            squared = (edge**2).sum(-1, keepdims=True)
            found += [
                side * (offset * edge - along * across),
                side * ((squared + along) * across - offset * edge),
            ]
        return np.stack(found, axis=1)


@dataclass(frozen=True)
class Corners:
    """N corners.

    Attributes
    ----------
    axes : (N, 3, 3) rows are the cameras' axes in the world; `origin` (N, 3) their places there.
    half : (N,) tangent of half the horizontal field of view; `aspect` (N,) width over height.
    relay, middle : the walls.
    """

    axes: Floats
    origin: Floats
    half: Floats
    aspect: Floats
    relay: Rectangles
    middle: Rectangles

    @classmethod
    def of(cls, scenes: Sequence[Scene]) -> Corners:
        """The corners of scenes."""
        cameras = [scene.camera for scene in scenes]
        axes = np.stack([camera_axes(camera) for camera in cameras])
        origin = np.array([camera.location_m for camera in cameras], dtype=float)
        return cls(
            axes,
            origin,
            np.tan(np.radians([camera.horizontal_fov_deg for camera in cameras]) / 2),
            np.array([camera.width / camera.height for camera in cameras]),
            Rectangles.of([scene.relay_wall for scene in scenes], axes, origin),
            Rectangles.of([scene.middle_wall for scene in scenes], axes, origin),
        )

    def some(self, chosen: NDArray[np.int64]) -> Corners:
        """Some of the corners."""
        return Corners(
            *(self.axes[chosen], self.origin[chosen], self.half[chosen], self.aspect[chosen]),
            *(self.relay.some(chosen), self.middle.some(chosen)),
        )

    @cached_property
    def normal(self) -> Floats:
        """(N, 3) unit normals of the relay walls, towards the cameras."""
        facing = self.relay.across * -np.sign(self.relay.offset)[:, None]
        normal: Floats = facing / np.linalg.norm(facing, axis=1, keepdims=True)
        return normal

    @cached_property
    def plane(self) -> Floats:
        """(N, 3) planes m of the relay walls: their points p have m · p = 1."""
        return self.relay.across / self.relay.offset[:, None]

    def visible(self, y: Floats) -> Floats:
        """(N, R, 2, 2) the two parts of rows (N, R) that show the relay wall: first and last x of each.

        An empty part has its last x at its first.
        """
        edge = self.half[:, None] + 0 * y
        first, last = _within(self.relay.inequalities, y, -edge, edge)
        hiding = self.hiding
        begin, end = _within(hiding, y, first, last)
        hides = end > begin
        begin, end = np.where(hides, begin, last), np.where(hides, end, last)
        return np.stack([np.stack([first, begin], -1), np.stack([end, last], -1)], -2)

    @cached_property
    def hiding(self) -> Floats:
        """(N, 6, 3) vectors w: the middle wall hides the relay wall along r where w · r >= 0 for all six."""
        signs = [np.sign(wall.offset)[:, None] for wall in (self.relay, self.middle)]
        away = [np.abs(wall.offset)[:, None] for wall in (self.relay, self.middle)]
        nearer = away[0] * signs[1] * self.middle.across - away[1] * signs[0] * self.relay.across
        return np.concatenate([self.middle.inequalities, nearer[:, None]], axis=1)

    def edges(self) -> Floats:
        """(N, 11, 3) vectors w: what is seen of the relay wall ends on lines w · (x, y, 1) = 0."""
        return np.concatenate([self.relay.inequalities, self.hiding], axis=1)

    def box(self) -> Floats:
        """(N, 4) first and last x and y of what each image shows of the relay wall; the whole if nothing."""
        edge = self.half / self.aspect
        rows = np.linspace(-1, 1, _ROWS)[None] * edge[:, None] * (1 - 1e-9)
        parts = self.visible(rows)
        shown = (parts[..., 1] - parts[..., 0] > _EMPTY).any(-1)  # (N, R)
        some = shown.any(1)
        top, bottom = np.argmax(shown, 1), _ROWS - 1 - np.argmax(shown[:, ::-1], 1)
        ends = []
        for at, beside in ((top, -1), (bottom, 1)):
            inner = np.take_along_axis(rows, at[:, None], 1)[:, 0]
            outer = np.take_along_axis(rows, np.clip(at + beside, 0, _ROWS - 1)[:, None], 1)[:, 0]
            for _ in range(_HALVINGS):
                middle = (inner + outer) / 2
                parts_there = self.visible(middle[:, None])[:, 0]
                seen = (parts_there[..., 1] - parts_there[..., 0] > _EMPTY).any(-1)
                inner, outer = np.where(seen, middle, inner), np.where(seen, outer, middle)
            ends.append(inner)
        rows = np.linspace(0, 1, _ROWS)[None] * (ends[1] - ends[0])[:, None] + ends[0][:, None]
        parts = self.visible(rows)
        filled = parts[..., 1] - parts[..., 0] > _EMPTY
        left = np.where(filled, parts[..., 0], math.inf).min((1, 2))
        right = np.where(filled, parts[..., 1], -math.inf).max((1, 2))
        whole = np.stack([-self.half, self.half, -edge, edge], 1)
        found = np.stack([left, right, ends[0], ends[1]], 1)
        good = some & (right - left > _EMPTY) & (ends[1] - ends[0] > _EMPTY)
        return np.where(good[:, None], found, whole)

    def shows_edges(self) -> NDArray[np.bool_]:
        """(N,) whether an image shows something else than the relay wall."""
        edge, half = self.half / self.aspect, self.half[:, None]
        first, last = self.visible(np.linspace(-1, 1, _ROWS) * edge[:, None])[:, :, 0].transpose(2, 0, 1)
        cut: NDArray[np.bool_] = ((first != -half) | (last != half)).any(1)
        return cut

    def pixel_centres(self, width: int, height: int) -> tuple[Floats, Floats]:
        """(N, W) x and (N, H) y of the pixel centres on the film."""
        x, y = ((np.arange(count) + 0.5) / count * 2 - 1 for count in (width, height))
        return x * self.half[:, None], y * (self.half / self.aspect)[:, None]

    def film(self, box: Floats, across: int, down: int) -> tuple[Floats, Floats]:
        """(N, L, 2) Gauss nodes over what the film sees of the relay wall, and (N, L) their film areas."""
        (x, wide), (y, high) = (np.polynomial.legendre.leggauss(count) for count in (across, down))
        top, bottom = box[:, 2, None], box[:, 3, None]
        rows = (top + bottom) / 2 + (bottom - top) / 2 * y  # (N, down)
        parts = self.visible(rows)
        lengths = np.maximum(parts[..., 1] - parts[..., 0], 0)  # (N, down, 2)
        total = lengths.sum(-1)[..., None]
        along = (x + 1) / 2 * total  # (N, down, across) from the first x, without the gap
        begin = np.where(lengths[..., :1] > 0, parts[..., 0, :1], parts[..., 1, :1])
        beyond = (along > lengths[..., :1]) & (lengths[..., :1] > 0)
        columns = np.where(beyond, parts[..., 1, :1] + along - lengths[..., :1], begin + along)
        area = total / 2 * wide * ((bottom - top) / 2 * high)[..., None]
        nodes = np.stack([columns, np.broadcast_to(rows[..., None], columns.shape)], -1)
        return nodes.reshape(len(rows), -1, 2), area.reshape(len(rows), -1)


def _within(inequalities: Floats, y: Floats, first: Floats, last: Floats) -> tuple[Floats, Floats]:
    """First and last x of rows (N, R) where w · (x, y, 1) >= 0 for all w (N, K, 3); equal if none."""
    slope = inequalities[:, None, :, 0]  # (N, 1, K)
    constant = inequalities[:, None, :, 1] * y[..., None] + inequalities[:, None, :, 2]  # (N, R, K)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = -constant / slope
    low = np.where(slope > 0, root, -math.inf).max(-1)
    high = np.where(slope < 0, root, math.inf).min(-1)
    never = ((slope == 0) & (constant < 0)).any(-1)
    first, end = np.maximum(first, low), np.minimum(last, high)
    empty = never | (end <= first)
    return np.where(empty, last, first), np.where(empty, last, end)
