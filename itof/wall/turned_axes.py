"""Axes of a camera that is turned to a fixed angle to the relay wall: in them, most corners look alike.

The hidden light depends on places of the wall, not on the pixels that see them. A camera that turns at its
place sees the same light along the same rays. So rays in these axes say where a pixel looks in any corner.

Arrays may be of numpy or of any other library that supports the array API standard.
"""

from __future__ import annotations

from math import cos, radians, sin
from typing import Final

from array_api_compat import array_namespace, device

from itof.arrays import A

TURN_DEG: Final = 41.0  # from the direction straight to the wall, about that of the paper's camera


def turned_rays(plane_per_m: A, rays_by_axis: A) -> A:
    """Rays in the axes (right, down, forward) of a camera that is turned to a fixed angle to the wall.

    Forward is 41 degrees from the direction straight to the wall, along the wall to where the camera looks.
    What is vertical for the camera stays so, projected onto the wall. If the camera looks to the left along
    the wall, the turned one is also upside down, so that it looks to the right as all others do: a corner
    upside down has its light upside down.

    Parameters
    ----------
    plane_per_m : (..., 3) the wall's plane m in camera axes, 1/m: its distance along a ray r is 1 / (m · r).
    rays_by_axis : (3, H, W) or (..., 3, H, W) unit vectors through the pixel centres, in camera axes.

    Returns
    -------
    (..., 3, H, W) unit vectors.

    Source: ours.
    """
    xp = array_namespace(plane_per_m, rays_by_axis)
    normal = plane_per_m / xp.linalg.vector_norm(plane_per_m, axis=-1, keepdims=True)
    vertical = xp.asarray([0.0, 1.0, 0.0], dtype=normal.dtype, device=device(normal))
    down = vertical - normal[..., 1:2] * normal
    down = down / xp.linalg.vector_norm(down, axis=-1, keepdims=True)
    along = xp.linalg.cross(down, normal)  # to the camera's right
    side = xp.where(along[..., 2:] < 0, -1.0, 1.0)
    down, along = side * down, side * along
    angle = radians(TURN_DEG)
    forward = cos(angle) * normal + sin(angle) * along
    axes = xp.stack([xp.linalg.cross(down, forward), down, forward], axis=-2)  # (..., 3, 3)
    axes = xp.astype(axes, rays_by_axis.dtype)[..., None, None]
    return xp.sum(axes * rays_by_axis[..., None, :, :, :], axis=-3)
