"""Corners whose camera, walls and wall materials differ from the paper's."""

from dataclasses import dataclass

import numpy as np
from many_light_scenes import CAMERA_LOCATION_M, HORIZONTAL_FOV_DEG, LAYOUT, Corner, middle_wall, relay_wall

PROJECTOR_MARGIN_DEG = 0.001  # as night-gen makes it


@dataclass(frozen=True)
class OddCorner(Corner):
    """A corner with any camera and walls; see `Corner`.

    Attributes
    ----------
    fov_deg : horizontal field of view of the camera; the projector's is 0.001 degrees wider.
    size : film width and height, pixels; they give the aspect ratio of camera and projector.
    wall_half_m, middle_half_m : half the side of the relay wall, half the height of the middle wall.
    scaled : factor of all lengths, about the origin.
    """

    fov_deg: float = HORIZONTAL_FOV_DEG
    size: tuple[int, int] = (LAYOUT.width, LAYOUT.height)
    wall_half_m: float = 20.0
    middle_half_m: float = 20.0
    scaled: float = 1.0

    def _shape(self, folder, name, mesh, bsdf):
        if name == "relay_wall":
            mesh = relay_wall(self.wall_half_m)
        elif name == "middle_wall":
            mesh = middle_wall(self.middle_half_m)
        return super()._shape(folder, name, mesh.copy().apply_scale(self.scaled), bsdf)

    def _pose(self, turned_rad):
        import mitsuba as mi

        pose = np.array(super()._pose(turned_rad).matrix)
        pose[:3, 3] += (self.scaled - 1) * self.moved[:3, :3] @ CAMERA_LOCATION_M
        return mi.ScalarTransform4f(pose)

    def _sensor(self):
        width, height = self.size
        sensor = super()._sensor() | {"fov": self.fov_deg}
        return sensor | {"film": sensor["film"] | {"width": width, "height": height}}

    def _emitter(self):
        import mitsuba as mi

        emitter = super()._emitter()
        if self.other_emitter is not None:
            return emitter
        pixels = np.ones((self.size[1], self.size[0], 1), np.float32)
        image = emitter["irradiance"] | {"bitmap": mi.Bitmap(pixels)}
        return emitter | {"fov": self.fov_deg + PROJECTOR_MARGIN_DEG, "irradiance": image}
