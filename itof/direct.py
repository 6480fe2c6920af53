"""The direct return of a diffuse wall that a co-located projector and camera look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from itof.light import phase_per_metre
from itof.pinhole import pixel_rays

_BLOCK_RAYS = 2**18  # sub-pixel rays held at a time, about 30 MB


def direct_phasors(
    width: int,
    height: int,
    horizontal_fov_deg: float,
    frequencies_hz: Sequence[float],
    camera_axes: ArrayLike,
    camera_location_m: ArrayLike,
    wall_point_m: ArrayLike,
    wall_normal: ArrayLike,
    *,
    subpixels: int = 8,
) -> NDArray[np.complex128]:
    """Phasors of the one-bounce return of an infinite diffuse wall of reflectance 1, as means over pixels.

    The projector has the place and the frustum of the camera, and its flux is uniform over its image plane
    (radiant intensity π / cos³ o at the angle o to the optical axis). A wall point at distance r, under the
    angle a to the wall's normal, therefore has the radiance cos a / (r² cos³ o), and the optical path length
    of its light is 2r.

    Parameters
    ----------
    width, height, horizontal_fov_deg : pinhole camera, pixels and degrees.
    frequencies_hz : F modulation frequencies, Hz.
    camera_axes : (3, 3) the camera's right, down and forward in world space, as rows.
    camera_location_m, wall_point_m : (3,) in world space, metres.
    wall_normal : (3,) in world space, of any length and either sign.
    subpixels : a pixel is averaged over subpixels x subpixels midpoints.

    Returns
    -------
    (H, W, F) complex, radiance for a projector of irradiance 1; 0 where a ray misses the wall.

    Source: derived here. The intensity is that of Mitsuba 3's ``projector``; a test compares the two.
    """
    normal = np.asarray(wall_normal, dtype=np.float64) / np.linalg.norm(wall_normal)
    gap_m = (np.asarray(wall_point_m, dtype=np.float64) - np.asarray(camera_location_m)) @ normal
    axes = np.asarray(camera_axes, dtype=np.float64)
    turns = phase_per_metre(frequencies_hz)  # (F,)
    step = max(1, _BLOCK_RAYS // (width * subpixels**2))
    blocks = []
    for first in range(0, height, step):
        last = min(first + step, height)
        rays = pixel_rays(
            width * subpixels,
            height * subpixels,
            horizontal_fov_deg,
            rows=(first * subpixels, last * subpixels),
        )  # (rows s, W s, 3)
        towards = rays @ axes @ normal  # cosine to the normal; same sign as gap_m: wall ahead
        ahead = towards * gap_m > 0
        radial_depth_m = np.where(ahead, gap_m / np.where(ahead, towards, 1.0), np.inf)
        forward = rays[..., 2]
        # Not forward ** 3: numpy rounds that of a strided array by where the array lies in memory.
        cubed = forward * forward * forward
        radiance = np.abs(towards) / (radial_depth_m**2 * cubed)  # (rows s, W s); 0 at infinity
        opl_m = 2 * np.where(ahead, radial_depth_m, 0.0)  # the optical path goes out and back
        shape = (last - first, subpixels, width, subpixels)
        each = [(radiance * np.exp(1j * k * opl_m)).reshape(shape).mean(axis=(1, 3)) for k in turns]
        blocks.append(np.stack(each, axis=-1))  # (rows, W, F)
    return np.concatenate(blocks)
