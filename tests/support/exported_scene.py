"""The scene whose transients the tests of exports take (fixture `transient_dataset`), and its geometry."""

import numpy as np

from itof import pixel_rays
from scenegen import camera_axes, wall_normal

WIDTH, HEIGHT = 24, 18
BIN_M, START_M, BINS = 0.05, 1.0, 160  # 1 m to 9 m of optical path: a start other than 0 shows offsets
PRESET = {
    "dataset": {"count": 2},
    "camera": {"width": WIDTH, "height": HEIGHT},
    "transient": {"bin_count": BINS, "bin_width_m": BIN_M, "start_opl_m": START_M},
    "hidden_object": {"shapes": ["sphere"], "composite_fraction": 0.0},
}


def wall_distance_m(scene, width, height):
    """(H, W) length from the camera to the relay wall's plane along each pixel's ray."""
    rays = pixel_rays(width, height, scene.camera.horizontal_fov_deg) @ camera_axes(scene.camera)
    normal = wall_normal(scene.relay_wall)
    return (np.array(scene.relay_wall.location_m) - scene.camera.location_m) @ normal / (rays @ normal)


def footprint_m(scene, fine=64):
    """(H, W) shortest and longest way out and back over each pixel's footprint on the wall."""
    length_m = 2 * wall_distance_m(scene, WIDTH * fine, HEIGHT * fine)  # out and back
    parts = length_m.reshape(HEIGHT, fine, WIDTH, fine)
    return parts.min(axis=(1, 3)), parts.max(axis=(1, 3))
