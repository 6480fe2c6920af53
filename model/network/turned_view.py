"""Carries images to the view of a camera that is turned to the wall, and a network's outputs back."""

from __future__ import annotations

from math import radians, tan
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from model.settings.input import TURNED_WIDTH

TURNED_HEIGHT: Final = 56
_HALF_WIDTH: Final = tan(radians(80 / 2))  # of the turned view, at a distance of 1
_LEAST_FORWARD: Final = 0.05  # of a ray: rays that leave the view farther to the side get its border


class TurnedView:
    """A pinhole view of 80 degrees and 80 x 56 pixels, turned as `itof.wall.turned_view` says.

    Pixels of a camera and of this view that have the same ray have the same light and depth. Images of any
    size and field of view become images of this one, and outputs become images of the camera again, both by
    bilinear interpolation. Large images are averaged to about its number of pixels before.
    """

    def of_camera(self, images: Tensor, rays: Tensor) -> Tensor:
        """(N, C + 1, 56, 80) images as the turned camera sees them, and where they are known, from 0 to 1.

        Parameters
        ----------
        images : (N, C, H, W).
        rays : (N, 3, H, W) those of the pixels, in the axes of the turned camera.
        """
        height, width = images.shape[-2:]
        less = max(1, min(width // TURNED_WIDTH, height // TURNED_HEIGHT))
        to_pixel = _homography(rays)
        grid = self._grid(rays)
        x, y, z = (to_pixel[:, :, :, None, None] * grid[None, None]).sum(2).unbind(1)  # (N, 56, 80)
        is_ahead = z > 0
        z = torch.where(is_ahead, z, 1.0)
        places = torch.stack([torch.where(is_ahead, x / z, 2.0), torch.where(is_ahead, y / z, 2.0)], dim=-1)
        if less > 1:
            images = functional.interpolate(images, (height // less, width // less), mode="area")
        images = torch.cat([images, torch.ones_like(images[:, :1])], dim=1)
        return functional.grid_sample(images, places, mode="bilinear", align_corners=False)

    def to_camera(self, images: Tensor, rays: Tensor) -> Tensor:
        """(N, C, H, W) images of the turned view (N, C, 56, 80), at the pixels with these rays."""
        x, y, z = rays.unbind(1)
        z = z.clamp(min=_LEAST_FORWARD) * _HALF_WIDTH
        places = torch.stack([x / z, y / z * (TURNED_WIDTH / TURNED_HEIGHT)], dim=-1)
        return functional.grid_sample(
            images, places, mode="bilinear", padding_mode="border", align_corners=False
        )

    @staticmethod
    def _grid(like: Tensor) -> Tensor:
        """(3, 56, 80) rays of the view's pixels, with a forward part of 1."""
        x = _centres(TURNED_WIDTH, like) * _HALF_WIDTH
        y = _centres(TURNED_HEIGHT, like) * (_HALF_WIDTH * TURNED_HEIGHT / TURNED_WIDTH)
        columns, rows = x.expand(TURNED_HEIGHT, -1), y[:, None].expand(-1, TURNED_WIDTH)
        return torch.stack([columns, rows, torch.ones_like(rows)])


def upright(rays: Tensor) -> Tensor:
    """Rays (N, 3, H, W) of images that may have been flipped top to bottom, as those of a camera.

    A flip reverses the order of an image's rays, which no turn of a camera does. The flipped image is that of
    a camera whose rays go up instead of down, in the corner upside down.
    """
    one, two, three = rays[..., 0, 0], rays[..., 0, -1], rays[..., -1, 0]  # (N, 3)
    is_flipped = (torch.linalg.cross(one, two) * three).sum(-1) < 0  # x, y, z: right, down, forward
    ones = torch.ones_like(is_flipped, dtype=rays.dtype)
    sign = torch.stack([ones, torch.where(is_flipped, -ones, ones), ones], dim=-1)
    return rays * sign[..., None, None]


def _centres(count: int, like: Tensor) -> Tensor:
    """(count,) centres of pixels, with the image from -1 to 1."""
    return (2 * torch.arange(count, dtype=like.dtype, device=like.device) + 1) / count - 1


def _homography(rays: Tensor) -> Tensor:
    """(N, 3, 3) maps from rays to pixels (x w, y w, w), with the image from -1 to 1 and w > 0 ahead.

    The pixels are those of a pinhole camera, so the rays of four of them decide the map.
    """
    height, width = rays.shape[-2:]
    corners = rays[..., [0, 0, -1, -1], [0, -1, 0, -1]]  # (N, 3, 4)
    right, down = 1 - 1 / width, 1 - 1 / height  # centre of the last pixel
    pixels = rays.new_tensor([[-right, right, -right], [-down, -down, down], [1, 1, 1]])
    last = rays.new_tensor([right, down, 1.0])
    of_rays = _inverse(corners[..., :3])
    weights = (_inverse(pixels[None]) @ last) / (of_rays @ corners[..., 3:])[..., 0]  # (N, 3)
    return (pixels * weights[:, None, :]) @ of_rays


def _inverse(matrices: Tensor) -> Tensor:
    """Inverse of (N, 3, 3) matrices by their adjugates, which every export of a network can express."""
    a, b, c = matrices.unbind(-1)
    rows = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=-2)
    return rows / (a * rows[..., 0, :]).sum(-1)[..., None, None]
