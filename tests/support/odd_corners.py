"""Corners whose camera, walls and wall materials differ from the paper's."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from many_light_scenes import CAMERA_LOCATION_M, HORIZONTAL_FOV_DEG, LAYOUT, Corner, middle_wall, relay_wall

from render.options import ManyLightOptions
from render.transport.many_light import ManyLight
from render.transport.scene_loading import scene_from_data
from scenegen import preset_from_dict
from scenegen.geometry_check import refusal
from scenegen.mitsuba_description import seen_description
from scenegen.possible_scenes import SamplingError, sample_valid_scene
from scenegen.shapes import PRIMITIVES

LEAST_GAP_M = 0.03  # between the relay wall and the middle wall, of random corners
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


def random_corner(seed, **camera):
    """A scene of a random corner that a preset may have: objects, camera, roll, walls, gap and material.

    `camera` are keys of the preset's table that are not drawn.
    """
    rng = np.random.default_rng([seed, 7])
    u = rng.uniform
    shapes = np.random.default_rng([seed, 8]).permutation(PRIMITIVES)[:2].tolist()
    while True:
        roll_deg = float(rng.choice([0, 90, -90, u(-110, 110)]))
        diffuse = {"material": "diffuse", "reflectance": 0.9, "least_reflectance": 0.3}
        drawn = {
            "dataset": {"count": 1, "seed": int(rng.integers(1e6))},
            "hidden_object": {"shapes": shapes, "composite_fraction": float(seed % 4 == 3)},
            "camera": {
                "horizontal_fov_deg": u(40, 110),
                "location_m": [1 + u(-0.3, 0.3), -1 + u(-0.3, 0.3), 1.65 + u(-0.3, 0.3)],
                "rotation_deg": [90 + u(-15, 15), roll_deg, 50 + u(-15, 15)],
                **camera,
            },
            "middle_wall": {
                "size_m": [u(2, 3.5), u(1.8, 4)],
                "location_m": [u(1.2, 2.6), u(-0.1, 0.1), u(1, 2)],
                "rotation_deg": [90 + u(-10, 10), u(-10, 10), u(-10, 10)],
            },
            "relay_wall": {
                "size_m": [u(2.5, 5), u(4, 8)],
                "rotation_deg": [u(-5, 5), 90 + u(-5, 5), u(-5, 5)],
                **(diffuse if rng.random() < 0.4 else {}),
            },
        }
        wall = drawn["middle_wall"]
        if wall["location_m"][0] - wall["size_m"][0] / 2 < LEAST_GAP_M:
            continue
        try:
            return sample_valid_scene(preset_from_dict(drawn, "test"), 0, refusal)
        except SamplingError:  # nothing fits behind this middle wall
            continue


def corner_of(width, height, **tables):
    """A scene of the paper's corner with one object, and with these tables of the preset."""
    tables = {"dataset": {"count": 1, "seed": 1}, "hidden_object": {"composite_fraction": 0.0}, **tables}
    tables["camera"] = {"width": width, "height": height, **tables["camera"]}
    return sample_valid_scene(preset_from_dict(tables, "test"), 0, refusal)


def behind_a_gap(width, height, gap_m):
    """The paper's corner, seen with 74.5 degrees behind a gap between its walls."""
    middle = {"size_m": [3.3, 4.0], "location_m": [gap_m + 3.3 / 2, 0.0, 2.0]}
    return corner_of(width, height, camera={"horizontal_fov_deg": 74.5}, middle_wall=middle)


def loaded_corner(maker, scene, variant):
    """A scene in Mitsuba, with the wall's material that `ManyLight` takes."""
    wall = ManyLight(ManyLightOptions(), variant).rough_wall
    return scene_from_data(seen_description(scene), maker.files(scene), Path(), wall)
