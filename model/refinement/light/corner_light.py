"""The hidden light and the mirror images of objects that may be in a corner.

A candidate is a `Scene` with these objects. The plane of its relay wall is m, in camera axes: its points p
have m · p = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from disk.quantities import Vector
from model.settings.run import DeviceName
from scenegen.pose import camera_axes, rotation_matrix, wall_normal
from scenegen.scene import Camera, Scene
from scenegen.shapes import Shape

Floats = NDArray[np.float64]


def known_corner(scene: Scene) -> Scene:
    """What is known of the corner of a scene; its hidden objects, boxes now, do not matter."""
    parts = tuple(replace(part, shape="parallelepiped") for part in scene.hidden_objects)
    return replace(scene, hidden_objects=parts, relay_wall=replace(scene.relay_wall, darkening=None))


def with_wall_at(scene: Scene, plane_per_m: Floats) -> Scene:
    """The scene with its relay wall turned and moved along its normal onto a plane."""
    wall, axes = scene.relay_wall, camera_axes(scene.camera)
    plane = plane_per_m @ axes  # in world axes, from the camera
    before, after = wall_normal(wall), -plane / np.linalg.norm(plane)
    after = after if before @ after > 0 else -after
    turned = Rotation.align_vectors(after[None], before[None])[0].as_matrix() @ rotation_matrix(
        wall.rotation_deg
    )
    centre = np.array(wall.location_m)
    centre = centre + (1 - plane @ (centre - scene.camera.location_m)) / (plane @ after) * after
    moved = replace(wall, location_m=vector(centre), rotation_deg=euler_deg(turned))
    return replace(scene, relay_wall=moved)


def with_camera_at(scene: Scene, plane_per_m: Floats) -> Scene:
    """The scene with its camera turned and moved along the relay wall's normal, so that it has this plane."""
    wall, axes = scene.relay_wall, camera_axes(scene.camera)
    towards, normal = -plane_per_m / np.linalg.norm(plane_per_m), wall_normal(wall)
    gap_m = (np.asarray(scene.camera.location_m) - wall.location_m) @ normal
    normal = normal if gap_m > 0 else -normal
    turned = Rotation.align_vectors(towards[None], (axes @ normal)[None])[0].as_matrix() @ axes
    right, down, forward = turned
    place = scene.camera.location_m + (1 / np.linalg.norm(plane_per_m) - abs(gap_m)) * normal
    camera = replace(
        scene.camera,
        location_m=vector(place),
        rotation_deg=euler_deg(np.stack([right, -down, -forward], axis=1)),
    )
    return replace(scene, camera=camera)


def euler_deg(matrix: Floats) -> Vector:
    """XYZ Euler angles of a (3, 3) rotation, degrees."""
    return vector(Rotation.from_matrix(matrix).as_euler("xyz", degrees=True, suppress_warnings=True))


def vector(values: Floats) -> Vector:
    """(3,) numbers as a place or as angles of a scene."""
    x, y, z = values.tolist()
    return x, y, z


@dataclass(frozen=True)
class Mirror:
    """The plane m (3,) of a relay wall, taken for a mirror."""

    camera: Camera
    plane_per_m: Floats

    def points_m(self, radial_depth_m: Floats, rays: Floats) -> Floats:
        """(..., 3) points in world axes whose mirror image has the depth (...,) along unit rays (..., 3)."""
        mirrored = 2 * self.plane_per_m / (self.plane_per_m @ self.plane_per_m)  # the camera
        places = mirrored + radial_depth_m[..., None] * self._reflected(rays)
        found: Floats = places @ camera_axes(self.camera) + self.camera.location_m
        return found

    def away(self, rays: Floats) -> Floats:
        """(..., 3) directions of rays (..., 3) behind the mirror, in world axes."""
        found: Floats = self._reflected(rays) @ camera_axes(self.camera)
        return found

    def _reflected(self, rays: Floats) -> Floats:
        normal = self.plane_per_m / np.linalg.norm(self.plane_per_m)
        reflected: Floats = rays - 2 * (rays @ normal)[..., None] * normal
        return reflected


class CornerLight:
    """Computes the light of candidates; it is that of `render.batch.candidates.CandidateLight`.

    Parameters
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    device : where to compute; on the CPU, with one thread.

    Raises
    ------
    BackendError : this machine cannot render on the requested device.
    """

    def __init__(self, frequencies_hz: Sequence[float], device: DeviceName = "cpu") -> None:
        from render.batch.candidates import CandidateLight

        self._engine = CandidateLight(frequencies_hz, device=device, threads=1)

    def over_direct(self, candidates: Sequence[Scene], rays: Floats, *, fine: bool) -> NDArray[np.complex128]:
        """(N, P, F) hidden over direct light along (P, 3) rays that meet the relay wall."""
        return self._engine.over_direct(candidates, rays, fine=fine)

    def direct(self, candidates: Sequence[Scene], rays: Floats) -> Floats:
        """(N, P) direct light of the relay walls along (P, 3) rays that meet them, in any unit."""
        return self._engine.direct(candidates, rays)

    def mirrored_depth_m(self, candidates: Sequence[Scene], rays: Floats) -> Floats:
        """(N, P) radial depth of the mirror images of candidates along (P, 3) rays, 0 beside them."""
        return self._engine.mirrored_depth_m(candidates, rays)

    def sees_wall(self, corners: Sequence[Scene], rays: Floats) -> NDArray[np.bool_]:
        """(N, P) whether the camera sees the relay wall along (P, 3) rays."""
        return self._engine.sees_wall(corners, rays)

    def depths_of_solids_m(
        self, corner: Scene, shape: Shape, axes: Floats, centres_m: Floats, sizes_m: Floats, rays: Floats
    ) -> Floats:
        """(N, P) as `mirrored_depth_m`, of N solids of one shape in one corner.

        `axes` (N, 3, 3) are their own axes as columns in world axes; places and extents are (N, 3).
        """
        return self._engine.depths_of_solids_m(corner, shape, axes, centres_m, sizes_m, rays)
