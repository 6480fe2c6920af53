"""Rays, walls and what they hide from each other, of the corner that all scenes of a preset share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from disk.quantities import Vector
from scenegen.pose import rotation_matrix
from scenegen.scene import Camera, Emitter, Wall

Points = NDArray[np.float64]
_RAYS: Final = 300  # along the longer side of an image: light that comes through a gap of 1 cm meets some


@dataclass(frozen=True)
class Frustum:
    """What a camera sees or a projector lights: its place, its field of view, and its aspect ratio."""

    location_m: Vector
    rotation_deg: Vector
    horizontal_fov_deg: float
    width: int
    height: int

    @classmethod
    def of_camera(cls, camera: Camera) -> Frustum:
        """That of a camera."""
        size = (camera.width, camera.height)
        return cls(camera.location_m, camera.rotation_deg, camera.horizontal_fov_deg, *size)

    @classmethod
    def of_projector(cls, projector: Emitter, camera: Camera) -> Frustum:
        """That of a projector, which has the aspect ratio of the camera or of its dots."""
        size = projector.dots or (camera.width, camera.height)
        return cls(projector.location_m, projector.rotation_deg, projector.horizontal_fov_deg, *size)

    @property
    def _reach(self) -> Points:
        """(2,) half the width and height of the image at the distance 1."""
        half = float(np.tan(np.radians(self.horizontal_fov_deg) / 2))
        return np.array([half, half * self.height / self.width])

    def rays(self) -> Points:
        """(N, 3) rays through an even grid of places in the image, from top to bottom, with depth 1."""
        size = (self.width, self.height)
        counts = [max(2, round(_RAYS * side / max(size))) for side in size]
        x, y = (reach * (2 * np.arange(n) + 1 - n) / n for reach, n in zip(self._reach, counts, strict=True))
        across, down = (axis.ravel() for axis in np.meshgrid(x, -y))
        own = np.stack([across, down, -np.ones_like(across)], axis=1)
        rays: Points = own @ rotation_matrix(self.rotation_deg).T
        return rays

    def corner_rays(self) -> Points:
        """(4, 3) rays through the corners of the image, around it, with depth 1."""
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self._reach
        rays: Points = np.column_stack([square, -np.ones(4)]) @ rotation_matrix(self.rotation_deg).T
        return rays

    def holds(self, points: Points) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) are in the image."""
        own = (points - np.array(self.location_m)) @ rotation_matrix(self.rotation_deg)  # it looks along -z
        reach = self._reach * -own[:, 2:] * (1 + 1e-9)
        inside: NDArray[np.bool_] = (own[:, 2] < 0) & (np.abs(own[:, :2]) <= reach).all(axis=1)
        return inside

    def hits(self, wall: Wall, rays: Points) -> Points:
        """(N,) depths at which rays (N, 3) meet a wall; infinite where they miss it."""
        origin = np.array(self.location_m)
        away, falls = local(wall, origin)[2], rays @ rotation_matrix(wall.rotation_deg)[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(falls == 0, np.inf, -away / falls)
        depth = np.where(depth > 0, depth, np.inf)
        met = local(wall, origin + rays * np.where(np.isfinite(depth), depth, 0)[:, None])
        inside = (np.abs(met[:, :2]) <= np.array(wall.size_m) / 2).all(axis=1)
        return np.where(inside, depth, np.inf)

    def points_on(self, wall: Wall) -> Points:
        """(N, 3) points of a wall on rays of the image, as if there were no other wall."""
        rays = self.rays()
        depth = self.hits(wall, rays)
        met = np.isfinite(depth)
        return np.array(self.location_m) + rays[met] * depth[met][:, None]


def lit_points(camera: Camera, projector: Emitter, relay: Wall, middle: Wall) -> Points:
    """(N, 3) points of the relay wall that the camera sees and the projector lights."""
    views = (Frustum.of_camera(camera), Frustum.of_projector(projector, camera))
    points = np.concatenate([view.points_on(relay) for view in dict.fromkeys(views)])
    for view in views:
        points = points[view.holds(points)]
        points = points[~crosses(middle, np.array(view.location_m), points)]
    return points


def local(wall: Wall, points: Points) -> Points:
    """Points (..., 3) in the frame of a wall: along its own x and y, and in front of it."""
    own: Points = (points - np.array(wall.location_m)) @ rotation_matrix(wall.rotation_deg)
    return own


def distances_m(wall: Wall, points: Points) -> Points:
    """(N,) distances of points (N, 3) from the plane of a wall, towards its front, metres."""
    return local(wall, points)[:, 2]


def corners_of(wall: Wall) -> Points:
    """(4, 3) corners of a wall, around it."""
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    placed: Points = square * [*wall.size_m, 0] @ rotation_matrix(wall.rotation_deg).T
    return placed + wall.location_m


def crosses(wall: Wall, start: Points, ends: Points, margin_m: float = 0.0) -> NDArray[np.bool_]:
    """(N,) whether segments from `start`, (3,) or (N, 3), to `ends` (N, 3) cross a wall with a margin."""
    one, other = np.broadcast_to(local(wall, start), ends.shape), local(wall, ends)
    apart = one[:, 2] - other[:, 2]
    through = one[:, 2] * other[:, 2] < 0
    share = one[:, 2] / np.where(through, apart, 1.0)
    met = one[:, :2] + share[:, None] * (other - one)[:, :2]
    inside: NDArray[np.bool_] = (np.abs(met) <= np.array(wall.size_m) / 2 + margin_m).all(axis=1)
    return through & inside
