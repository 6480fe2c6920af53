"""Presets with cameras elsewhere, where a camera sees its wall, and settings of networks that are told."""

import numpy as np
from training_runs import FLIP

from itof import pixel_rays
from scenegen import camera_axes, preset_from_dict, wall_normal

SHOWN = FLIP | {"channels": "residual+wall", "reference": "self", "width": 4, "batch_size": 4, "block": 2}
SHOWN |= {"target": "mask+depth", "noise_sigma": 0.0}


def preset(**tables):
    return preset_from_dict({"dataset": {"seed": 5}, **tables}, "test")


def preset_text(**tables):
    """Tables of a preset as TOML."""
    lines = (
        f"[{table}]\n" + "\n".join(f"{k} = {v}" for k, v in keys.items()) for table, keys in tables.items()
    )
    return "\n".join(lines)


def inverse_distance_per_m(scene, height, width):
    """(H, W) inverse of the wall's distance along the rays of a scene's camera."""
    rays = pixel_rays(width, height, scene.camera.horizontal_fov_deg) @ camera_axes(scene.camera)
    normal = wall_normal(scene.relay_wall)
    gap_m = (np.array(scene.relay_wall.location_m) - scene.camera.location_m) @ normal
    return rays @ normal / gap_m
