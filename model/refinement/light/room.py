"""Camera, relay wall and occluders, in camera axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from itof import pixel_rays
from itof.wall.wall_view import WallView
from model.data.corner import wall_view
from model.refinement.light.solids import Solid
from scenegen import Dataset
from scenegen.pose import rotation_matrix
from scenegen.scene import Wall


@dataclass(frozen=True)
class Rectangle:
    """A black rectangle that hides light: a corner and two edges, (3,) metres each."""

    corner_m: NDArray[np.float64]
    edges_m: tuple[NDArray[np.float64], NDArray[np.float64]]

    def hides(self, start_m: Tensor, end_m: Tensor) -> Tensor:
        """(...,) whether straight lines from (..., 3) to (..., 3) meet it."""
        corner, one, two = (
            torch.as_tensor(each, dtype=start_m.dtype) for each in (self.corner_m, *self.edges_m)
        )
        normal = torch.linalg.cross(one, two)
        before, behind = (start_m - corner) @ normal, (end_m - corner) @ normal
        share = before / torch.where(before == behind, 1.0, before - behind)
        where = start_m + share[..., None] * (end_m - start_m) - corner
        u, v = (where @ edge / edge.square().sum() for edge in (one, two))
        return (before * behind < 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)


@dataclass(frozen=True)
class Room:
    """What is known of a corner without its hidden object.

    Attributes
    ----------
    horizontal_fov_deg : of camera and projector, which are at the origin.
    plane_per_m : (3,) plane m of the relay wall: its points p have m · p = 1.
    reflectance : of the relay wall.
    is_rough : whether the relay wall has a roughness, which is not known; else it is Lambertian.
    occluders : black rectangles that hide the object from the camera and from parts of the wall.
    mirrors_occluders : whether their mirror images hide that of the object, too, as in a real mirror.
    """

    horizontal_fov_deg: float
    plane_per_m: NDArray[np.float64]
    reflectance: float
    is_rough: bool
    occluders: tuple[Rectangle, ...]
    mirrors_occluders: bool = False

    def with_plane(self, plane_per_m: ArrayLike) -> Room:
        """The room with its relay wall elsewhere."""
        return replace(self, plane_per_m=np.asarray(plane_per_m, dtype=np.float64))

    @property
    def wall_normal(self) -> NDArray[np.float64]:
        """(3,) unit normal of the relay wall, towards the camera."""
        return -self.plane_per_m / np.linalg.norm(self.plane_per_m)

    @property
    def mirrored_camera_m(self) -> NDArray[np.float64]:
        """(3,) mirror image of the camera in the relay wall."""
        mirrored: NDArray[np.float64] = 2 * self.plane_per_m / (self.plane_per_m @ self.plane_per_m)
        return mirrored

    def reflected(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) directions after a mirror at the place of the relay wall."""
        normal = self.wall_normal
        turned: NDArray[np.float64] = directions - 2 * (directions @ normal)[..., None] * normal
        return turned

    def mirrored_depth_m(self, solids: Sequence[Solid], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(...,) radial depth of the mirror image of solids along (..., 3) unit rays; 0 beside it."""
        flat = torch.as_tensor(self.reflected(rays).reshape(-1, 3))
        origin = torch.as_tensor(self.mirrored_camera_m)
        depth_m = torch.stack([solid.first_hit(origin, flat) for solid in solids]).amin(0)
        seen = depth_m.isfinite() & torch.as_tensor(rays.reshape(-1, 3) @ self.plane_per_m > 0)
        points_m = origin + torch.where(seen, depth_m, 0)[:, None] * flat
        for occluder in self.occluders if self.mirrors_occluders else ():
            seen &= ~occluder.hides(origin.expand_as(points_m), points_m)
        return torch.where(seen, depth_m, 0).numpy().reshape(rays.shape[:-1])

    def points_m(self, radial_depth_m: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 3) points of an object whose mirror image has the depth (...,) along rays (..., 3)."""
        return self.mirrored_camera_m + radial_depth_m[..., None] * self.reflected(rays)


def room_of(dataset: Dataset) -> Room:
    """The room of a dataset with one corner; its occluder is the middle wall of the first scene."""
    view, scene = wall_view(dataset), dataset.scene(dataset.ids()[0])
    rays = pixel_rays(1, 1, view.horizontal_fov_deg)
    wall = view.expected_wall(np.zeros((*rays.shape[:2], 1), complex), dataset.preset.itof.frequencies_hz[:1])
    return Room(
        horizontal_fov_deg=view.horizontal_fov_deg,
        plane_per_m=np.asarray(wall.plane_per_m),
        reflectance=scene.relay_wall.reflectance,
        is_rough=scene.relay_wall.material == "rough",
        occluders=(_rectangle(scene.middle_wall, view),),
        mirrors_occluders=scene.mirror_occluders,
    )


def in_camera_axes(points_m: ArrayLike, view: WallView) -> NDArray[np.float64]:
    """(..., 3) points in the axes of a camera, of points in world axes."""
    moved = np.asarray(points_m, dtype=np.float64) - np.asarray(view.camera_location_m)
    turned: NDArray[np.float64] = moved @ np.asarray(view.camera_axes).T
    return turned


def _rectangle(wall: Wall, view: WallView) -> Rectangle:
    axes = rotation_matrix(wall.rotation_deg)
    edges = [axes[:, axis] * wall.size_m[axis] for axis in (0, 1)]
    corner = np.asarray(wall.location_m) - (edges[0] + edges[1]) / 2
    one, two = (edge @ np.asarray(view.camera_axes).T for edge in edges)
    return Rectangle(in_camera_axes(corner, view), (one, two))
