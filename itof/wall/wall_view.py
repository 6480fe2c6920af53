"""Camera and relay wall: the data from which the wall's direct return is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from disk import NightError
from disk.contract import STRICT
from disk.quantities import FieldOfView, Vector
from itof import direct_phasors
from itof.arrays import Floats, Phasors
from itof.wall.expected_wall import ExpectedWall, NumpyWall, plane_of


class WallPlaceError(NightError):
    """A relay wall that the camera cannot see where it is said to be."""


@dataclass(frozen=True, config=STRICT)
class WallView:
    """A camera with co-located projector in front of an infinite diffuse wall, in world axes.

    Attributes
    ----------
    horizontal_fov_deg : full horizontal field of view, degrees; the pixels are square.
    camera_axes : unit vectors to the camera's right, down and forward.
    camera_location_m : position of the camera, metres.
    wall_point_m : any point of the wall, metres.
    wall_normal : unit normal of the wall, towards the room.
    """

    horizontal_fov_deg: FieldOfView
    camera_axes: tuple[Vector, Vector, Vector]
    camera_location_m: Vector
    wall_point_m: Vector
    wall_normal: Vector

    def with_fov(self, horizontal_fov_deg: float) -> WallView:
        """The same camera and wall with another field of view, degrees."""
        return replace(self, horizontal_fov_deg=horizontal_fov_deg)

    def direct_phasors(
        self, width: int, height: int, frequencies_hz: Sequence[float]
    ) -> NDArray[np.complex128]:
        """(H, W, F) direct return of the wall without any object (`itof.direct_phasors`)."""
        return direct_phasors(
            width,
            height,
            self.horizontal_fov_deg,
            frequencies_hz,
            *self._pose,
        )

    @property
    def plane_per_m(self) -> Floats:
        """(3,) the wall's plane in camera axes, 1/m; ValueError if the camera is in it."""
        return plane_of(*self._pose)

    @property
    def _pose(self) -> tuple[tuple[Vector, Vector, Vector], Vector, Vector, Vector]:
        return self.camera_axes, self.camera_location_m, self.wall_point_m, self.wall_normal

    def expected_wall(self, direct: Phasors, frequencies_hz: Sequence[float]) -> NumpyWall:
        """The wall with its direct return (H, W, F), computed or captured.

        Raises
        ------
        WallPlaceError : the camera is in the plane of the wall.
        """
        try:
            return ExpectedWall.of_camera(direct, frequencies_hz, self.horizontal_fov_deg, *self._pose)
        except ValueError as error:
            raise WallPlaceError(f"the relay wall cannot be where it is: {error}") from None
