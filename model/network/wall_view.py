"""Camera and relay wall of a dataset: the data from which the wall's direct return is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from itof import direct_phasors
from itof.wall.expected_wall import ExpectedWall
from model.network.channels import ChannelError, InputSpec
from scenegen import Dataset, camera_axes, wall_normal
from scenegen.contract import STRICT, FieldOfView, Vector
from scenegen.preset import CameraSettings
from scenegen.scene import RelayWall


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

    @classmethod
    def of(cls, camera: CameraSettings, wall: RelayWall) -> WallView:
        """The view of a scene's camera and relay wall."""
        right, down, forward = (_vector(axis) for axis in camera_axes(camera))
        return cls(
            horizontal_fov_deg=camera.horizontal_fov_deg,
            camera_axes=(right, down, forward),
            camera_location_m=camera.location_m,
            wall_point_m=wall.location_m,
            wall_normal=_vector(wall_normal(wall)),
        )

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
            self.camera_axes,
            self.camera_location_m,
            self.wall_point_m,
            self.wall_normal,
        )

    def expected_wall(
        self, direct: NDArray[np.complexfloating[Any, Any]], frequencies_hz: Sequence[float]
    ) -> ExpectedWall:
        """The wall with its direct return (H, W, F), computed or captured.

        Raises
        ------
        ChannelError : the camera is in the plane of the wall.
        """
        pose = (self.camera_axes, self.camera_location_m, self.wall_point_m, self.wall_normal)
        try:
            return ExpectedWall.of_camera(direct, frequencies_hz, self.horizontal_fov_deg, *pose)
        except ValueError as error:
            raise ChannelError(f"the relay wall cannot be where it is: {error}") from None


def wall_view(dataset: Dataset) -> WallView:
    """Camera and relay wall of a dataset, read from its first scene; they are the same in every scene.

    Where each scene has its camera elsewhere, the camera is that of the preset, in the middle of them.
    """
    scene, preset = dataset.scene(dataset.ids()[0]), dataset.preset
    return WallView.of(scene.camera if preset.is_one_corner else preset.camera, scene.relay_wall)


def many_corners_problem(dataset: Dataset, inputs: InputSpec) -> str | None:
    """Why a network with these inputs has no wall to compare the scenes of a dataset with; None if it has.

    Where each scene has its camera elsewhere, only a fit finds the wall of a scene.
    """
    if dataset.preset.is_one_corner or not inputs.uses_residual or inputs.self_calibrates:
        return None
    return (
        f"each scene of {dataset.root} has its camera elsewhere (camera_spread), and the reference "
        f"{inputs.reference} needs one place for all: train with --reference self"
    )


def _vector(values: NDArray[np.float64]) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)
