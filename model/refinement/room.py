"""The corner of one measurement: that of a room's preset, or a relay wall with nothing before it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from disk import NightError
from itof.wall.expected_wall import ExpectedWall
from model.refinement.light.corner_light import CornerLight, Floats, vector, with_wall_at
from scenegen import Preset, sample_scene
from scenegen.pose import camera_axes, wall_normal
from scenegen.scene import Camera, Scene

_ELSEWHERE_M = 100.0  # behind the camera: a middle wall that hides nothing
_FARTHEST_M = 100.0  # along a ray, of what is seen of a wall
_OTHER_DEG, _OTHER_TIMES = 30.0, 1.5  # of the wall in the room and in the measurement


class RoomError(NightError):
    """The room cannot be that of the measurement."""


def corner_of(room: Preset | None, wall: ExpectedWall, horizontal_fov_deg: float) -> Scene:
    """The corner of measurements of a relay wall, whose camera and hidden objects do not matter.

    Parameters
    ----------
    room : None: no middle wall; the world's axes are then x to the right, y forward and z up, from the
        camera.
    wall : where the camera sees its relay wall.

    Raises
    ------
    RoomError : the relay wall of the room is behind its camera, or far from where the measurement shows it.
    """
    height, width = wall.rays.shape[:2]
    scene = sample_scene(room or Preset(), 0)
    here = {"width": width, "height": height, "horizontal_fov_deg": horizontal_fov_deg}
    plane = np.asarray(wall.plane_per_m)
    if room is not None:
        _refuse_other_wall(scene, plane)
        return replace(scene, camera=replace(scene.camera, **here))
    camera = Camera(**here, location_m=(0, 0, 0), rotation_deg=(90, 0, 0))
    nowhere = replace(scene.middle_wall, size_m=(1e-3, 1e-3), location_m=(0, -_ELSEWHERE_M, 0))
    middle_m, radius_m = _seen(wall, camera_axes(camera))
    relay = replace(scene.relay_wall, location_m=vector(middle_m), size_m=(2 * radius_m,) * 2)
    return with_wall_at(replace(scene, camera=camera, relay_wall=relay, middle_wall=nowhere), plane)


def _seen(wall: ExpectedWall, axes: Floats) -> tuple[Floats, float]:
    """(3,) middle of what the camera at 0 sees of a wall, in world axes, and how far it reaches, metres."""
    rays = wall.rays.reshape(-1, 3)
    along = rays @ wall.plane_per_m
    near = along > 1 / _FARTHEST_M
    points_m = (rays[near] / along[near, None]) @ axes
    middle_m: Floats = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    return middle_m, 1.1 * float(np.linalg.norm(points_m - middle_m, axis=1).max())


def refuse_unseen_wall(corner: Scene, rays: Floats, light: CornerLight) -> None:
    """Refuse a corner (with its camera in place) whose relay wall is seen along none of (P, 3) rays."""
    if not light.sees_wall([corner], rays).any():
        raise RoomError(
            "the camera of the room sees nothing of its relay wall, or the middle wall hides all of it: "
            "check the places and sizes in its [camera], [relay_wall] and [middle_wall]"
        )


def _refuse_other_wall(scene: Scene, plane_per_m: Floats) -> None:
    """Refuse a room whose relay wall is not where the measurement shows one."""
    wall, camera = scene.relay_wall, scene.camera
    normal = wall_normal(wall)
    gap_m = float((np.asarray(camera.location_m) - wall.location_m) @ normal)
    towards = -camera_axes(camera) @ (normal * math.copysign(1, gap_m))
    if towards[2] <= 0:
        raise RoomError(
            "the relay wall of the room is behind its camera: check rotation_deg in [camera] and [relay_wall]"
        )
    shown_m = 1 / float(np.linalg.norm(plane_per_m))
    turned_deg = math.degrees(math.acos(float(np.clip(towards @ plane_per_m * shown_m, -1, 1))))
    times = max(abs(gap_m) / shown_m, shown_m / max(abs(gap_m), 1e-9))
    if turned_deg > _OTHER_DEG or times > _OTHER_TIMES:
        raise RoomError(
            f"the room has its relay wall {abs(gap_m):.2f} m from the camera, the measurement shows it at "
            f"{shown_m:.2f} m and turned by {turned_deg:.0f} degrees against that: is it another room?"
        )
