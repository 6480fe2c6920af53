"""The rays of pixels in axes of the wall, and what a network that knows them makes of images of any size."""

import numpy as np
import pytest
import torch

from itof import pixel_rays
from itof.wall.turned_axes import TURN_DEG, turned_rays
from model.network.ray_channels import LARGEST, answered, seen, upright
from model.network.unet import UNet

# Planes of walls, 1/m in camera axes: near that of the paper, with roll, and one whose camera looks left.
PLANES = np.array([[-0.49, 0.0, 0.59], [-0.40, 0.08, 0.70], [-0.55, -0.12, 0.45], [0.45, 0.10, 0.60]])
LEFT = 3  # the last one
SIZE = (40, 30, 62.0)  # pixels, degrees
FLOAT32 = 40 * np.finfo(np.float32).eps  # a few dozen operations


def rays_of(width, height, fov_deg):
    """(4, 3, H, W) rays of a camera at four walls, in turned axes."""
    return turned_rays(PLANES, np.moveaxis(pixel_rays(width, height, fov_deg), -1, 0))


def axes_of(plane):
    """Rows: right, down and forward of the turned camera, in camera axes."""
    return turned_rays(plane, np.eye(3)[:, :, None])[..., 0]


def channels_of(width, height, fov_deg=62.0):
    """(4, 4, H, W) a random image, and the rays, at the four walls."""
    images = torch.randn(4, 1, height, width, generator=torch.Generator().manual_seed(1))
    return torch.cat([images, torch.from_numpy(rays_of(width, height, fov_deg)).float()], dim=1)


def network(channels=4):
    generator = torch.Generator().manual_seed(0)
    return UNet(channels, 4, levels=2, block=2, rays=True, generator=generator).eval()


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


def test_a_camera_turned_at_its_place_about_its_vertical_axis_has_the_same_rays():
    plane, angle = PLANES[0], 0.2
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    np.testing.assert_allclose(axes_of(turn @ plane) @ turn, axes_of(plane), atol=1e-14)


def test_a_camera_that_looks_left_along_the_wall_is_turned_upside_down():
    plane = PLANES[3]
    right, down, forward = axes_of(plane * [-1, 1, 1]) * [-1, 1, 1]  # of the mirrored corner, mirrored back
    np.testing.assert_allclose(axes_of(plane), [right, -down, forward], atol=1e-14)
    assert down[1] > 0


def test_a_flipped_image_is_that_of_the_corner_upside_down():
    """A flip and the flip of the rays' vertical part are one image: that of the reflected camera."""
    channels = channels_of(*SIZE)
    rays = channels[:, 1:]
    reflected = turned_rays(PLANES * [1, -1, 1], np.moveaxis(pixel_rays(*SIZE), -1, 0))
    assert torch.equal(upright(rays), rays)
    np.testing.assert_allclose(upright(rays.flip(-2)), reflected, atol=FLOAT32)
    other = torch.cat([channels[:, :1].flip(-2), torch.from_numpy(reflected).float()], dim=1)
    with torch.no_grad():
        torch.testing.assert_close(network()(channels.flip(-2)), network()(other), rtol=0, atol=1e-5)


def test_an_image_whose_camera_looks_to_the_left_is_seen_turned_half_and_answered_as_it_is():
    channels = channels_of(*SIZE)
    images, looks_left = seen(channels)
    assert looks_left.flatten().tolist() == [place == LEFT for place in range(4)]
    assert torch.equal(images[:LEFT], channels[:LEFT].clamp(-LARGEST, LARGEST))
    assert torch.equal(images[LEFT], channels[LEFT].clamp(-LARGEST, LARGEST).flip((-2, -1)))
    assert (images[:, 1, :, 1:] > images[:, 1, :, :-1]).all()  # rays go to the right
    assert torch.equal(answered(images, looks_left, (30, 40)), channels.clamp(-LARGEST, LARGEST))


def test_channels_at_the_edges_of_other_surfaces_are_bounded():
    channels = channels_of(*SIZE)
    channels[0, 0, 3, 4], channels[0, 0, 5, 6] = 300.0, -80.0
    images, _ = seen(channels)
    assert (images[0, 0, 3, 4], images[0, 0, 5, 6]) == (LARGEST, -LARGEST)


@pytest.mark.parametrize(("width", "height", "less"), [(40, 30, 1), (24, 14, 1), (80, 60, 2), (320, 240, 8)])
def test_large_images_are_averaged_over_whole_blocks_and_answers_have_their_size(width, height, less):
    channels = channels_of(width, height)[:LEFT]
    images, _ = seen(channels)
    bounded = channels.clamp(-LARGEST, LARGEST)
    blocks = bounded.unflatten(-1, (-1, less)).unflatten(-3, (-1, less)).mean((-1, -3))
    torch.testing.assert_close(images, blocks, rtol=0, atol=LARGEST * FLOAT32)
    with torch.no_grad():
        assert network()(channels).shape == (LEFT, 2, height, width)


def test_an_answer_that_is_linear_over_the_image_stays_so():
    """Bilinear interpolation: exact between the centres of the pixels that the network sees."""
    place = torch.arange(10.0).expand(1, 1, 6, 10)
    found = answered(place, torch.zeros(1, 1, 1, 1, dtype=torch.bool), (24, 40))
    expected = (torch.arange(40) - 1.5) / 4  # in these pixels
    torch.testing.assert_close(found[0, 0, 12, 2:-2], expected[2:-2], rtol=0, atol=10 * FLOAT32)
