"""A lamp beside the lens, motion, distortion and crosstalk, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import convolve

from itof import phase_per_metre, pixel_rays
from itof.radial_distortion import turning_square, undistorted_radius
from itof.sensor.binned import BinnedCamera
from itof.sensor.camera import Camera
from itof.sensor.geometry import distorted, moved, with_lamp
from itof.sensor.settings import SensorSettings
from itof.wall.expected_wall import ExpectedWall
from itof.wall.self_calibration import calibrate

HZ = (20e6, 50e6, 60e6)
SMALL = SensorSettings(width=48, height=36)
WALL = ExpectedWall.of_plane([-0.2, 0.1, 0.5], 48, 36, HZ, 60.0)


def single_path():
    """(H, W, F) phasors of one path a pixel, as far as the wall."""
    return np.exp(2j * WALL.radial_depth_m[..., None] * phase_per_metre(HZ)) * 0.3


def test_the_way_from_a_lamp_beside_the_lens_is_that_of_its_place():
    lamp = (0.05, -0.02, 0.01)
    found = with_lamp(replace(SMALL, emitter_offset_m=lamp), single_path(), HZ)
    points_m = WALL.radial_depth_m[..., None] * WALL.rays
    way_m = np.linalg.norm(points_m - np.array(lamp), axis=-1) + WALL.radial_depth_m
    np.testing.assert_allclose(found, 0.3 * np.exp(1j * way_m[..., None] * phase_per_metre(HZ)), atol=1e-9)
    # From far away, a lamp 5 cm to the side is 5 cm times the sine of the ray's angle nearer.
    near_m = -np.angle(found / single_path())[..., 2] / phase_per_metre(HZ)[2]
    np.testing.assert_allclose(near_m, WALL.rays @ np.array(lamp), atol=0.05**2 / 1.5)


def test_motion_moves_each_frequency_by_its_time():
    settings = replace(SMALL, motion_m_s=0.5, integration_s=1e-3, frames=2)
    found = moved(settings, single_path(), HZ)
    middle = 36 // 2, 48 // 2
    ray = pixel_rays(48, 36, 60.0)[middle][2]
    # Four raw frames of 1 ms at each frequency; the second measurement follows 12 ms after the first.
    times_s = np.array([2e-3, 6e-3, 10e-3]) + 6e-3
    expected = -2 * 0.5 * times_s / ray * phase_per_metre(HZ)
    np.testing.assert_allclose(np.angle(found / single_path())[middle], expected, rtol=1e-9)
    # The self-calibration takes it for a nearer wall and phase offsets. What it cannot take is the difference
    # of the frequencies, 2 mm, times the part of 1 / cos that is no constant.
    head_on = ExpectedWall.of_plane([0.0, 0.0, 0.5], 48, 36, HZ, 60.0)
    seen = moved(settings, head_on.direct, HZ)
    left = np.abs(np.angle(seen / calibrate(seen, head_on).moved(seen, head_on))).max()
    spread = np.ptp(1 / pixel_rays(48, 36, 60.0)[..., 2])
    assert 1e-5 < left < 0.5 * 4e-3 * 2 * phase_per_metre(HZ)[2] * spread


@pytest.mark.parametrize("distortion", [(-0.2, 0.05), (0.1, 0.0)])
def test_a_distorting_lens_shows_a_ray_where_its_polynomial_says(distortion):
    """The image is a smooth function of the ray's place in the image plane, known between pixels, too."""
    settings = replace(SMALL, distortion=distortion)

    def light(x, y):
        return np.exp(1j * (0.4 * x - 0.7 * y + 0.5 * x * y))[..., None] * (1 + 0.2 * x[..., None])

    rays = pixel_rays(48, 36, 60.0)
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    found = distorted(settings, light(x, y))
    # Of a pixel's pinhole place p, the lens makes p (1 + k1 r² + k2 r⁴): the inverse by Newton's method.
    r = np.hypot(x, y)
    p = r.copy()
    for _ in range(20):
        p -= (p * (1 + distortion[0] * p**2 + distortion[1] * p**4) - r) / (
            1 + 3 * distortion[0] * p**2 + 5 * distortion[1] * p**4
        )
    expected = light(x * p / r, y * p / r)
    inside = np.maximum(np.abs(x * p / r) / np.abs(x).max(), np.abs(y * p / r) / np.abs(y).max()) < 0.93
    assert inside.mean() > 0.6
    np.testing.assert_allclose(found[inside], expected[inside], atol=3e-6)
    assert np.abs(found - light(x, y)).max() > 5e-3


@pytest.mark.parametrize("distortion", [(-0.3, 0.05), (-0.3, 0.0), (0.5, -0.02), (1.0, 1.0), (0.0, 0.0)])
def test_radii_are_found_up_to_where_the_lens_folds(distortion):
    turning = np.sqrt(turning_square(distortion))
    true = np.linspace(0, min(turning, 5.0), 1000)
    seen = true * (1 + distortion[0] * true**2 + distortion[1] * true**4)
    assert (np.diff(seen) > 0).all()
    # At the fold the slope is 0, so that rounding of the radius seen moves the ray by its root.
    np.testing.assert_allclose(undistorted_radius(seen, distortion), true, atol=1e-6)
    if np.isfinite(turning):
        beyond = 1.01 * turning
        assert beyond * (1 + distortion[0] * beyond**2 + distortion[1] * beyond**4) < seen.max()


@pytest.mark.parametrize(("distortion", "fov_deg"), [((-0.5, 0.0), 60.0), ((-0.3, 0.0), 100.0)])
def test_a_lens_that_folds_its_image_is_refused(distortion, fov_deg):
    with pytest.raises(ValueError, match="folds the image before the corners"):
        replace(SMALL, distortion=distortion, horizontal_fov_deg=fov_deg)
    replace(SMALL, distortion=distortion, horizontal_fov_deg=fov_deg / 2)


@pytest.mark.parametrize(
    "changes", [{"distortion": (-0.1, 0.02)}, {"emitter_offset_m": (0.03, 0.0, 0.0)}, {"motion_m_s": 1.0}]
)
def test_both_cameras_and_torch_see_the_same(changes):
    settings = replace(SMALL, **changes, contrast=((20e6, 0.8),))
    z = single_path()
    counted = Camera(settings, HZ).capture(z, np.random.default_rng(0)).phasor
    assert np.abs(counted - z).max() > 1e-4
    camera = BinnedCamera(settings, HZ, 48, 36)
    np.testing.assert_allclose(camera.mean(z), counted, rtol=1e-9)
    images = torch.from_numpy(np.stack([z, 2 * z]))
    found = camera.mean(images)
    np.testing.assert_allclose(found.numpy(), np.stack([counted, 2 * counted]), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.abs(camera.passed(z)), np.abs(counted), rtol=1e-6)


def test_electrons_that_go_to_the_neighbours_are_those_of_a_convolution_of_the_sensor_pixels():
    z = single_path() * np.exp(np.random.default_rng(0).standard_normal((36, 48, 1)))
    kernel = np.array([[0, 1, 0], [1, -4, 1], [0, 1, 0]]) * 0.08 / 4
    kernel[1, 1] += 1
    sensor = np.repeat(np.repeat(z[..., 0], 4, axis=0), 4, axis=1)  # 4 x 4 see the light of a pixel
    mixed = convolve(sensor.real, kernel, mode="nearest") + 1j * convolve(sensor.imag, kernel, mode="nearest")
    expected = mixed.reshape(36, 4, 48, 4).mean(axis=(1, 3))
    settings = replace(SMALL, width=192, height=144, crosstalk=0.08)
    found = Camera(settings, HZ).capture(z, np.random.default_rng(0)).phasor
    np.testing.assert_allclose(found[..., 0], expected, rtol=1e-9)
    assert np.abs(found[..., 0] - z[..., 0]).max() > 1e-3
    np.testing.assert_allclose(found.sum(axis=(0, 1)), z.sum(axis=(0, 1)), rtol=1e-9)  # nothing is lost
