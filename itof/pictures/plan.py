"""The room from above: camera, field of view, walls, and the predicted surface where it is in the room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image, ImageDraw

from itof import DepthMap, pixel_rays
from itof.arrays import Floats
from itof.pictures.panels import HEAD, INK, PALE, TEXT, WHITE, Colours, font

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

Bounds = tuple[float, float, float, float]  # least x and y, largest x and y, metres

_RELAY, MIDDLE, _SIGHT, _OBJECT = (68, 119, 170), (34, 34, 34), (34, 136, 51), (33, 145, 140)
_FINE: Final = 2  # the plan is drawn so many times larger, so that its lines are smooth
_MOST_POINTS: Final = 3000
_FARTHEST: Final = 4.0  # distances of the wall, within which the plan shows things
_LEAST_LEVEL: Final = 0.1  # horizontal part of a direction that tells where ahead is
_TICK: Final = 60  # least distance of the lines of the grid, pixels


@dataclass(frozen=True)
class Room:
    """Where the walls are, from the camera.

    Attributes
    ----------
    camera_axes : (3, 3) unit vectors to the camera's right, down and forward, in world axes with z upwards.
    plane_per_m : (3,) plane m of the relay wall in camera axes, 1/m: its points p have m · p = 1.
    middle_wall_m : (4, 3) corners of the middle wall from the camera, in world axes, metres; None if unknown.
    """

    camera_axes: Floats
    plane_per_m: Floats
    middle_wall_m: Floats | None = None


@dataclass(frozen=True)
class Plan:
    """A room from above: x to the right of the camera, y ahead of it, metres, camera at the origin.

    Attributes
    ----------
    sight : (2, 2) where the left and right edges of the image meet the relay wall.
    points : (n, 2) surface of the hidden object, as predicted.
    depth_m : (n,) radial depth of these points' mirror images.
    middle_wall : (4, 2) None if it is not known.
    """

    sight: Floats
    points: Floats
    depth_m: Floats
    middle_wall: Floats | None

    @classmethod
    def of(cls, one: DepthMap, room: Room, horizontal_fov_deg: float) -> Plan:
        """That of a prediction (H, W)."""
        height, width = one.mask.shape
        rays, plane = pixel_rays(width, height, horizontal_fov_deg), np.asarray(room.plane_per_m, np.float64)
        onto = _above(np.asarray(room.camera_axes, np.float64))
        wall_m = 1 / float(np.linalg.norm(plane))
        edge = rays[height // 2, [0, -1]]
        reach_m = 1 / np.maximum(edge @ plane, 1 / (_FARTHEST * wall_m))
        depth_m = one.radial_depth_m[one.mask].astype(np.float64)
        seen = rays[one.mask] * depth_m[:, None]  # the mirror image
        points = seen - 2 * np.outer((seen @ plane - 1) / (plane @ plane), plane)
        some = slice(None, None, 1 + len(points) // _MOST_POINTS)
        middle, world = room.middle_wall_m, np.asarray(room.camera_axes, np.float64)
        return cls(
            (edge * reach_m[:, None]) @ onto,
            (points @ onto)[some],
            depth_m[some],
            None if middle is None else middle @ world.T @ onto,
        )

    @property
    def wall(self) -> Floats:
        """(2, 2) a part of the relay wall that is longer than what is seen."""
        middle, half = self.sight.mean(axis=0), (self.sight[1] - self.sight[0]) / 2
        return middle + np.array([[-1.3], [1.3]]) * half

    @property
    def bounds(self) -> Bounds:
        """What the plan must show."""
        far_m = _FARTHEST * max(float(np.abs(self.sight).max()), 0.1)
        shown = [np.zeros((1, 2)), self.wall, self.points]
        shown += [] if self.middle_wall is None else [self.middle_wall]
        all_m = np.clip(np.concatenate(shown), -far_m, far_m)
        return (*all_m.min(axis=0).tolist(), *all_m.max(axis=0).tolist())


def _above(axes: Floats) -> Floats:
    """(3, 2) what takes camera axes to the plan."""
    ahead = next(way for way in (axes[2], -axes[1], axes[1]) if np.hypot(*way[:2]) > _LEAST_LEVEL)[:2]
    ahead = ahead / np.linalg.norm(ahead)
    onto: Floats = axes[:, :2] @ np.array([[ahead[1], ahead[0]], [-ahead[0], ahead[1]]])
    return onto


def draw_plan(
    page: Picture, corner: tuple[int, int], size: tuple[int, int], plan: Plan, bounds: Bounds, depth: Colours
) -> None:
    """Draw a plan with its title and axes, with `corner` and `size` as in `itof.pictures.panels.draw_panel`.

    `depth` are the colours of the points.
    """
    fine = (_FINE * size[0], _FINE * size[1])
    picture = Image.new("RGB", fine, WHITE)
    pen, to = ImageDraw.Draw(picture), _Map.of(bounds, fine)
    to.draw_grid(pen)
    left, right = (to(place) for place in plan.sight)
    pen.polygon((to(np.zeros(2)), left, right), fill=(236, 246, 238))
    pen.line((left, to(np.zeros(2)), right), _SIGHT, 2 * _FINE)
    pen.line([to(place) for place in plan.wall], _RELAY, 5 * _FINE)
    if plan.middle_wall is not None:
        around = [to(place) for place in (*plan.middle_wall, plan.middle_wall[0])]
        pen.line(around, MIDDLE, 4 * _FINE)
    half = 1.5 * _FINE
    for place, colour in zip(plan.points, depth.of(plan.depth_m).tolist(), strict=True):
        x, y = to(place)
        pen.rectangle((x - half, y - half, x + half, y + half), tuple(colour))
    x, y = to(np.zeros(2))
    pen.ellipse((x - 5 * _FINE, y - 5 * _FINE, x + 5 * _FINE, y + 5 * _FINE), _SIGHT)
    named = [("camera", _SIGHT), ("relay wall", _RELAY), ("object", _OBJECT)]
    named += [] if plan.middle_wall is None else [("middle wall", MIDDLE)]
    page.paste(picture.reduce(_FINE), (corner[0], corner[1] + HEAD))
    words, x = ImageDraw.Draw(page), corner[0] + size[0]
    words.text(corner, "from above, m", INK, font())
    if plan.middle_wall is None:  # else one might think that the room has none
        words.text((x - 6, corner[1] + HEAD + 3), "the middle wall is not known", INK, font(), anchor="ra")
    for name, colour in reversed(named):
        words.text((x, corner[1]), name, colour, font(), anchor="ra")
        x -= int(font().getlength(f"{name}  "))


@dataclass(frozen=True)
class _Map:
    """Metres to pixels: the plan is in the middle, beside the numbers of its axes."""

    scale: float
    least: Floats
    largest: Floats
    size: tuple[int, int]

    @classmethod
    def of(cls, bounds: Bounds, size: tuple[int, int]) -> _Map:
        low, high = np.array(bounds[:2]), np.array(bounds[2:])
        room = np.array(size) - _FINE * np.array([_MARGIN_X, _MARGIN_Y])
        scale = float((room / np.maximum(1.1 * (high - low), 1e-3)).min())
        middle, half = (low + high) / 2, room / scale / 2
        return cls(scale, middle - half, middle + half, size)

    def __call__(self, place: Floats) -> tuple[float, float]:
        x, y = self.scale * (place - self.least)
        return _FINE * _MARGIN_X + float(x), self.size[1] - _FINE * _MARGIN_Y - float(y)

    def draw_grid(self, pen: ImageDraw.ImageDraw) -> None:
        """Lines at round numbers of metres, and the numbers."""
        exact = _FINE * _TICK / self.scale
        power = 10.0 ** np.floor(np.log10(exact))
        step = next(each * power for each in (1, 2, 5, 10) if each * power >= exact)
        letters, (width, height) = font(_FINE * TEXT), self.size
        foot, side = height - _FINE * _MARGIN_Y, _FINE * _MARGIN_X
        for axis in (0, 1):
            edge = 0.3 * exact  # where no number fits
            first, last = (self.least[axis] + edge) / step, (self.largest[axis] - edge) / step
            for value in step * np.arange(np.ceil(first), np.floor(last) + 1):
                at = self(np.where(np.arange(2) == axis, value, self.least))
                text = f"{value + 0.0:.{max(0, -int(np.floor(np.log10(step))))}f}"
                if axis == 0:
                    pen.line((at[0], 0, at[0], foot), PALE, _FINE)
                    pen.text((at[0], foot + _FINE * 4), text, INK, letters, anchor="ma")
                else:
                    pen.line((side, at[1], width, at[1]), PALE, _FINE)
                    pen.text((side - _FINE * 4, at[1]), text, INK, letters, anchor="rm")
        pen.rectangle((side, 0, width - 1, foot), outline=(160, 160, 160), width=_FINE)


_MARGIN_X, _MARGIN_Y = 44, TEXT + 8  # numbers of the axes, pixels
