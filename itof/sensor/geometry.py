"""Where a camera's light comes from: a lamp beside the lens, distortion of the lens, and motion.

Images are phasors of a pinhole camera with the lamp in the lens, at rest. Arrays may be of numpy or of any
other library of the array API.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from array_api_compat import array_namespace, device, to_device
from numpy.typing import NDArray

from itof.arrays import A, PhasorsOf
from itof.light import phase_per_metre
from itof.pinhole import pixel_rays
from itof.radial_distortion import undistorted_radius
from itof.sensor.settings import SensorSettings
from itof.unwrapping import unwrap_depth


def geometry(settings: SensorSettings, image: PhasorsOf[A], frequencies_hz: Sequence[float]) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) with lamp, motion and lens as the settings have them."""
    return distorted(settings, moved(settings, with_lamp(settings, image, frequencies_hz), frequencies_hz))


def with_lamp(settings: SensorSettings, image: PhasorsOf[A], frequencies_hz: Sequence[float]) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) with the lamp at `emitter_offset_m`.

    A point at the distance d along the ray r is |d r - e| from the lamp at e, instead of d. The distance is
    that of the phases, whose light is almost all direct; hidden light gets the same change of phase.
    """
    if not any(settings.emitter_offset_m):
        return image
    seen = np.asarray(to_device(image, "cpu"), dtype=np.complex128)
    depth_m = unwrap_depth(np.angle(seen), frequencies_hz)[..., None]  # (..., H, W, 1)
    height, width = seen.shape[-3:-1]
    points_m = depth_m * pixel_rays(width, height, settings.horizontal_fov_deg)
    way_m = np.linalg.norm(points_m - np.array(settings.emitter_offset_m), axis=-1, keepdims=True) - depth_m
    return _turned(image, way_m * phase_per_metre(frequencies_hz))


def moved(settings: SensorSettings, image: PhasorsOf[A], frequencies_hz: Sequence[float]) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) of a camera that moves along its axis while it measures.

    The frequencies are measured one after the other, so the wall is at another distance in each. The way
    within the raw frames of one frequency is neglected.
    """
    if not settings.motion_m_s:
        return image
    height, width = image.shape[-3:-1]
    each_s = settings.phase_steps * settings.integration_s
    middle_s = each_s * (np.arange(len(frequencies_hz)) + 0.5)
    middle_s += each_s * len(frequencies_hz) * (settings.frames - 1) / 2
    along = pixel_rays(width, height, settings.horizontal_fov_deg)[..., 2:]  # (H, W, 1)
    nearer_m = settings.motion_m_s * middle_s / along  # of a wall that the axis meets at a right angle
    return _turned(image, -2 * nearer_m * phase_per_metre(frequencies_hz))


def distorted(settings: SensorSettings, image: PhasorsOf[A]) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) as a lens with the radial distortion k1, k2 shows them.

    What a pinhole shows at the radius r of the image plane at the distance 1 is at r (1 + k1 r² + k2 r⁴).
    Between pixels, phasors are interpolated by cubic convolution (Keys 1981); beyond the image, its edge.
    """
    if not any(settings.distortion):
        return image
    xp = array_namespace(image)
    height, width = image.shape[-3:-1]
    weights = _resampling(width, height, settings.horizontal_fov_deg, settings.distortion)
    rows, columns, row_weights, column_weights = weights
    total = xp.zeros_like(image)
    for row, row_weight in zip(rows, row_weights, strict=True):
        for column, column_weight in zip(columns, column_weights, strict=True):
            place = xp.asarray((row * width + column).ravel(), device=device(image))
            flat = xp.reshape(image, (*image.shape[:-3], height * width, image.shape[-1]))
            taken = xp.reshape(xp.take(flat, place, axis=-2), tuple(image.shape))
            weight = np.asarray(row_weight * column_weight)[..., None]
            total = total + taken * xp.asarray(weight, dtype=xp.real(image).dtype, device=device(image))
    return total


def _turned(image: PhasorsOf[A], phase_rad: NDArray[np.float64]) -> PhasorsOf[A]:
    xp = array_namespace(image)
    turn = np.exp(1j * phase_rad)
    return image * xp.asarray(turn, dtype=image.dtype, device=device(image))


@cache
def _resampling(
    width: int, height: int, horizontal_fov_deg: float, distortion: tuple[float, float]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows and columns (4, H, W) of the pixels that a pixel is made of, and their weights."""
    focal = width / 2 / np.tan(np.radians(horizontal_fov_deg) / 2)
    y, x = np.mgrid[:height, :width] + 0.5
    seen = np.stack([(x - width / 2), (y - height / 2)]) / focal  # where the lens shows it
    radius = np.hypot(*seen)
    pinhole = seen * (undistorted_radius(radius, distortion) / np.maximum(radius, 1e-300))
    column, row = pinhole[0] * focal + width / 2 - 0.5, pinhole[1] * focal + height / 2 - 0.5
    parts = []
    for place, count in ((row, height), (column, width)):
        first = np.floor(place).astype(np.int64)
        near = np.clip(first + np.arange(-1, 3)[:, None, None], 0, count - 1)
        parts.append((near, _cubic(place - first)))
    return parts[0][0], parts[1][0], parts[0][1], parts[1][1]


def _cubic(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, H, W) weights of the neighbours at -1, 0, 1 and 2 of a place t between 0 and 1."""
    return np.stack(
        [
            ((2 - t) * t - 1) * t / 2,
            ((3 * t - 5) * t**2 + 2) / 2,
            (((4 - 3 * t) * t) + 1) * t / 2,
            (t - 1) * t**2 / 2,
        ]
    )
