"""Distances in the corner of a preset, and what its camera sees, without any scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from scenegen import Preset
from scenegen.corner_geometry import Frustum, Points, corners_of, distances_m, lit_points, local
from scenegen.depth_range import NO_MESHES, boxes, largest_mirrored_depth_m, largest_radius_m
from scenegen.sampling import projector_of, room_of, walls_of
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

_TOUCHES_M: Final = 0.005  # nearer walls touch


@dataclass(frozen=True)
class CornerFacts:
    """Distances in a corner, and what its camera sees; of the camera in the middle, if there are many.

    Attributes
    ----------
    camera_m, gap_m : distance of camera, and of the nearest edge of the middle wall, from the relay wall.
    region_m : smallest and largest distance of hidden objects' centres from the relay wall.
    radius_m : largest distance of a point of an object from its centre.
    farthest_m : largest distance of an object's mirror image from the camera.
    relay_wall, middle_wall, room, nothing : shares of the image; `room` is floor, ceiling and back wall.
    lit_m : extents of the part of the relay wall that is seen and lit: along its own x and y; 0 if none is.
    """

    camera_m: float
    gap_m: float
    region_m: tuple[float, float]
    radius_m: float
    farthest_m: float
    relay_wall: float
    middle_wall: float
    room: float
    nothing: float
    lit_m: tuple[float, float]

    def as_data(self) -> dict[str, Any]:
        """The facts as plain data."""
        return asdict(self)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The facts as text."""
        parts = {"show the relay wall": self.relay_wall, "the middle wall": self.middle_wall}
        parts |= ({"the rest of the room": self.room} if self.room else {}) | {"nothing": self.nothing}
        shares = ", ".join(f"{100 * part:.0f} % {what}" for what, part in parts.items())
        gap = f"the gap between the walls is {self.gap_m:.2f} m wide"
        if self.gap_m < _TOUCHES_M:
            gap = f"the middle wall reaches {-self.gap_m:.2f} m behind the plane of the relay wall"
        if abs(self.gap_m) < _TOUCHES_M:
            gap = "the middle wall touches the plane of the relay wall"
        return (
            f"of the image, {shares}",
            f"the camera is {self.camera_m:z.2f} m from the relay wall",
            "{:.2f} x {:.2f} m of the relay wall are seen and lit".format(*self.lit_m),
            gap,
            "the centres of hidden objects are {:.2f} to {:.2f} m from the relay wall".format(*self.region_m),
            f"the objects reach up to {self.radius_m:.2f} m from their centres",
            f"their mirror images are at most {self.farthest_m:.2f} m from the camera",
        )


def corner_facts(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> CornerFacts:
    """Measure the corner of a preset, also one that cannot be."""
    relay, middle = walls_of(preset)
    camera = preset.camera
    view = Frustum.of_camera(camera)
    rays = view.rays()
    depths = np.stack([view.hits(wall, rays) for wall in (relay, middle, *room_of(preset))])  # (2 to 5, N)
    first, sees = depths.argmin(axis=0), np.isfinite(depths).any(axis=0)
    shares = [float((sees & (np.minimum(first, 2) == wall)).mean()) for wall in (0, 1, 2)]
    lit = lit_points(camera, projector_of(preset, camera), relay, middle)
    x_m, y_m = np.ptp(local(relay, lit)[:, :2], axis=0) if len(lit) else (0.0, 0.0)
    region = distances_m(relay, region_box(preset))
    return CornerFacts(
        camera_m=float(distances_m(relay, np.array([camera.location_m]))[0]),
        gap_m=float(distances_m(relay, corners_of(middle)).min()),
        region_m=(float(region.min()), float(region.max())),
        radius_m=largest_radius_m(preset, meshes),
        farthest_m=largest_mirrored_depth_m(preset, meshes),
        relay_wall=shares[0],
        middle_wall=shares[1],
        room=shares[2],
        nothing=float(1 - sees.mean()),
        lit_m=(float(x_m), float(y_m)),
    )


def region_box(preset: Preset, margin_m: float = 0.0) -> Points:
    """(8, 3) corners of the region of hidden objects' centres, wider by a margin."""
    found = np.stack([box for box, _ in boxes(preset)])  # (N, 3, 2), also of objects beside others
    sides = zip(found[..., 0].min(0) - margin_m, found[..., 1].max(0) + margin_m, strict=True)
    return np.array(list(product(*sides)))
