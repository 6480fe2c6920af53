"""A small patch behind the corner, whose hidden phasors are known by quadrature."""

import functools

import numpy as np
from many_light_scenes import (
    CAMERA_LOCATION_M,
    DOWN,
    FORWARD,
    FREQUENCIES_HZ,
    HORIZONTAL_FOV_DEG,
    OBJECT_LOCATION_M,
    PROJECTOR_FOV_DEG,
    RIGHT,
    Corner,
    square,
)
from three_bounce_quadrature import hidden_phasors

AXES = np.stack([RIGHT, DOWN, FORWARD])
_NORMAL = (-1, 0.1, 0.2)
PATCH = square(OBJECT_LOCATION_M, _NORMAL, 0.1)
CORNER = Corner((PATCH,), has_middle_wall=False)


@functools.cache
def patch_phasors(layout, order=40):
    """(H, W, F) hidden phasors of `CORNER`; `order` Gauss nodes along each axis of the lit wall."""
    return hidden_phasors(
        layout.width,
        layout.height,
        FREQUENCIES_HZ,
        PATCH.vertices,
        _NORMAL,
        camera=CAMERA_LOCATION_M,
        axes=AXES,
        camera_fov_deg=HORIZONTAL_FOV_DEG,
        projector_fov_deg=PROJECTOR_FOV_DEG,
        order=order,
    )
