"""Rays of a pinhole camera; conversion between radial depth and z-depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def pixel_rays(
    width: int, height: int, horizontal_fov_deg: float, *, rows: tuple[int, int] | None = None
) -> NDArray[np.float64]:
    """Unit vectors through the pixel centres in camera axes: x right, y down, z forward.

    Parameters
    ----------
    width, height : image size, pixels (square pixels).
    horizontal_fov_deg : full horizontal field of view, degrees, between 0 and 180.
    rows : (first, last) for the image rows first to last - 1; None for all rows.

    Returns
    -------
    (H, W, 3) float64; with `rows`, (last - first, W, 3).

    Raises
    ------
    ValueError : an image without pixels, or a field of view that is not between 0 and 180 degrees.
    """
    if width < 1 or height < 1 or not 0 < horizontal_fov_deg < 180:
        raise ValueError(
            "a pinhole camera has at least one pixel and a field of view between 0 and 180 degrees, "
            f"got {width} x {height} pixels and {horizontal_fov_deg} degrees"
        )
    half_width = np.tan(np.radians(horizontal_fov_deg) / 2)
    pixel = 2 * half_width / width  # pixel pitch at z = 1
    x = (np.arange(width) + 0.5) * pixel - half_width  # (W,)
    row = np.arange(*(rows or (0, height)))
    y = (row + 0.5 - height / 2) * pixel  # (H,)
    rays = np.stack([*np.meshgrid(x, y), np.ones((len(y), width))], axis=-1)  # (H, W, 3)
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def z_from_radial(radial_depth_m: ArrayLike, horizontal_fov_deg: float) -> NDArray[np.float64]:
    """(..., H, W) z-depth (along the optical axis) of radial depth (along the ray), metres."""
    depth_m = np.asarray(radial_depth_m, dtype=np.float64)
    return depth_m * _cosine_to_axis(depth_m.shape, horizontal_fov_deg)


def radial_from_z(z_depth_m: ArrayLike, horizontal_fov_deg: float) -> NDArray[np.float64]:
    """(..., H, W) radial depth (along the ray) of z-depth (along the optical axis), metres."""
    depth_m = np.asarray(z_depth_m, dtype=np.float64)
    return depth_m / _cosine_to_axis(depth_m.shape, horizontal_fov_deg)


def points_from_radial(radial_depth_m: ArrayLike, horizontal_fov_deg: float) -> NDArray[np.float64]:
    """(H, W, 3) points in camera axes (x right, y down, z forward), metres, of (H, W) radial depth."""
    depth_m = np.asarray(radial_depth_m, dtype=np.float64)
    height, width = depth_m.shape
    return pixel_rays(width, height, horizontal_fov_deg) * depth_m[..., None]


def _cosine_to_axis(shape: tuple[int, ...], horizontal_fov_deg: float) -> NDArray[np.float64]:
    if len(shape) < 2:
        raise ValueError(f"a depth image has rows and columns, got shape {shape}")
    return pixel_rays(shape[-1], shape[-2], horizontal_fov_deg)[..., 2]  # (H, W)
