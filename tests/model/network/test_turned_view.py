"""Images in the view of a camera that is turned to the wall, and outputs carried back."""

import numpy as np
import pytest
import torch

from itof import pixel_rays
from itof.wall.turned_view import TURN_DEG, turned_rays
from model.network.turned_view import TURNED_HEIGHT, TURNED_WIDTH, TurnedView, upright
from model.network.unet import UNet

# Planes of walls, 1/m in camera axes: near that of the paper, with roll, and one whose camera looks left.
PLANES = np.array([[-0.49, 0.0, 0.59], [-0.40, 0.08, 0.70], [-0.55, -0.12, 0.45], [0.45, 0.10, 0.60]])
VIEWS = [(40, 30, 62.0), (24, 14, 52.0), (96, 30, 75.0)]  # pixels, degrees
HALF = np.tan(np.radians(40))
FLOAT32 = 40 * np.finfo(np.float32).eps  # a few dozen operations


def rays_of(width, height, fov_deg):
    """(4, 3, H, W) rays of a camera at four walls, in turned axes."""
    return turned_rays(PLANES, np.moveaxis(pixel_rays(width, height, fov_deg), -1, 0))


def axes_of(plane):
    """Rows: right, down and forward of the turned camera, in camera axes."""
    return turned_rays(plane, np.eye(3)[:, :, None])[..., 0]


def pixel_coordinates(width, height):
    """(2, H, W) column and row of each pixel centre, with the image from -1 to 1."""
    x, y = ((2 * np.arange(count) + 1) / count - 1 for count in (width, height))
    return np.stack(np.broadcast_arrays(x, y[:, None]))


@pytest.mark.parametrize("plane", PLANES)
def test_the_turned_camera_has_a_fixed_angle_to_the_wall_and_keeps_what_is_vertical(plane):
    right, down, forward = axes = axes_of(plane)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1)
    normal = plane / np.linalg.norm(plane)
    assert forward @ normal == pytest.approx(np.cos(np.radians(TURN_DEG)))
    assert down @ normal == pytest.approx(0)
    vertical = np.array([0, 1, 0]) - normal[1] * normal  # the camera's, projected onto the wall
    np.testing.assert_allclose(np.cross(down, vertical), 0, atol=1e-14)
    assert forward[2] > 0
    assert right @ (forward - (forward @ normal) * normal) > 0


def test_a_camera_turned_at_its_place_about_the_walls_horizontal_axis_has_the_same_rays():
    plane, angle = PLANES[0], 0.2
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    np.testing.assert_allclose(axes_of(turn @ plane) @ turn, axes_of(plane), atol=1e-14)


def test_a_camera_that_looks_left_along_the_wall_is_turned_upside_down():
    plane = PLANES[3]
    right, down, forward = axes_of(plane * [-1, 1, 1]) * [-1, 1, 1]  # of the mirrored corner, mirrored back
    np.testing.assert_allclose(axes_of(plane), [right, -down, forward], atol=1e-14)
    assert down[1] > 0


@pytest.mark.parametrize(("width", "height", "fov_deg"), VIEWS)
def test_each_turned_pixel_shows_the_camera_pixel_with_its_ray(width, height, fov_deg):
    """Bilinear interpolation, and averages over blocks, are exact for coordinates."""
    rays = torch.from_numpy(rays_of(width, height, fov_deg)).float()
    places = torch.from_numpy(pixel_coordinates(width, height)).float()
    seen = TurnedView().of_camera(places.expand(4, -1, -1, -1), rays).numpy()
    x, y = pixel_coordinates(TURNED_WIDTH, TURNED_HEIGHT)
    turned = np.stack([x * HALF, y * HALF * TURNED_HEIGHT / TURNED_WIDTH, np.ones_like(x)])
    for plane, found in zip(PLANES, seen, strict=True):
        right, down, forward = np.einsum("ij,ihw->jhw", axes_of(plane), turned)
        scale = forward * np.tan(np.radians(fov_deg / 2))
        expected = np.stack([right / scale, down / scale * width / height])
        known = found[2] > 1 - FLOAT32
        assert known.mean() > 0.1
        np.testing.assert_allclose(found[:2, known], expected[:, known], atol=FLOAT32)
        outside = (np.abs(expected) > 1 + 2 / min(width, height)).any(0) | (forward < 0)
        assert not found[:, outside].any()


@pytest.mark.parametrize(("width", "height", "fov_deg"), VIEWS)
def test_each_camera_pixel_gets_the_output_along_its_ray(width, height, fov_deg):
    rays = rays_of(width, height, fov_deg)
    places = torch.from_numpy(pixel_coordinates(TURNED_WIDTH, TURNED_HEIGHT)).float()
    found = TurnedView().to_camera(places.expand(4, -1, -1, -1), torch.from_numpy(rays).float()).numpy()
    x, y = rays[:, 0] / rays[:, 2] / HALF, rays[:, 1] / rays[:, 2] / HALF * TURNED_WIDTH / TURNED_HEIGHT
    border = np.array([1 - 1 / TURNED_WIDTH, 1 - 1 / TURNED_HEIGHT])[:, None, None]  # centres at the edge
    ahead = rays[:, 2] > 0.1
    expected = np.clip(np.stack([x, y], axis=1), -border, border)
    difference = np.abs(found - expected).max(axis=1)
    assert difference[ahead].max() < FLOAT32


def test_a_flipped_image_is_that_of_the_corner_upside_down():
    """A flip and the flip of the rays' vertical part are one image: that of the reflected camera."""
    size = (40, 30, 62.0)
    rays = torch.from_numpy(rays_of(*size)).float()
    camera = np.moveaxis(pixel_rays(*size), -1, 0)
    reflected = torch.from_numpy(turned_rays(PLANES * [1, -1, 1], camera)).float()
    assert torch.equal(upright(rays), rays)
    np.testing.assert_allclose(upright(rays.flip(-2)), reflected, atol=FLOAT32)
    network = UNet(5, 4, levels=2, block=2, turned=True, generator=torch.Generator().manual_seed(0)).eval()
    images = torch.randn(4, 5, 30, 40, generator=torch.Generator().manual_seed(1))
    flipped = network(torch.cat([images, rays], dim=1).flip(-2))
    np.testing.assert_allclose(
        flipped.detach(), network(torch.cat([images.flip(-2), reflected], dim=1)).detach(), atol=1e-5
    )
