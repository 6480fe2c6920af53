"""The linear inverse of the three bounces, which shows a network the hidden scene beside its input.

At each coarse pixel of the mirrored scene and at each of a few depths, a point scatters light back to the
wall. Its measurement is converted to input channels y_v. Any measurement y is taken for a sum of them,
y = sum_v a_v y_v. Least squares with Tikhonov's damping gives

    a = U diag(s / (s² + λ P)) V^T y,

with the matrix of all y_v = U diag(s) V^T and their mean power P. Only the largest singular values s are
kept, because no measurement shows the others. The a_v of one depth are an image
(`model.network.bounce_images`).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from itof import pixel_rays
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from model.device import one_thread
from model.network.bounce_images import PLANES, BounceImages
from model.network.channels import IMAGES_AT_ONCE, InputSpec
from model.refinement.light.room import Room
from model.refinement.light.three_bounces import Bounces

CROSS_SECTION_M2: Final = 1e-5  # of a point: so small that the channels are linear in its light
SPREADS: Final = 2.0  # standard deviations of the object's depth, in front of its mean and behind
DAMPING: Final = 1e-2  # λ
_DARK: Final = 1e-30  # where no light comes back from anywhere, the images are black
ROUGHNESS: Final = 0.6  # of a relay wall whose roughness is not known: the middle of the preset `paper`


def bounce_inverse(
    images: BounceImages, room: Room, view: WallView, inputs: InputSpec, object_depth_m: tuple[float, float]
) -> dict[str, Tensor]:
    """The buffers of `images` for a corner.

    Parameters
    ----------
    images : for their shapes; they stay as they are.
    room, view : the corner.
    inputs : input channels of the network.
    object_depth_m : mean and standard deviation of the object's radial depth, metres.

    Returns
    -------
    ``project`` and ``expand`` of `BounceImages`.
    """
    with one_thread():  # with several, no two results are the same to the bit
        y = _responses(images, room, view, inputs, object_depth_m)  # (V, M)
        across, singular, down = np.linalg.svd(y, full_matrices=False)
    rank = len(images.project)
    across, singular, down = across[:, :rank], singular[:rank], down[:rank]
    power = max(float((y**2).sum(axis=1).mean()), _DARK)
    project = (singular / (singular**2 + DAMPING * power))[:, None] * down
    arrays = {"project": project, "expand": across}
    return {name: torch.as_tensor(array, dtype=torch.float32).contiguous() for name, array in arrays.items()}


def _responses(
    images: BounceImages, room: Room, view: WallView, inputs: InputSpec, object_depth_m: tuple[float, float]
) -> NDArray[np.float64]:
    """(V, M) residual channels of a point at each place, on the coarse parts of the wall."""
    height, width = images.seen
    direct = view.direct_phasors(width, height, inputs.frequencies_hz)
    wall = view.expected_wall(direct, inputs.frequencies_hz)
    hidden = _hidden(images, room, wall, object_depth_m)
    found = []
    for start in range(0, len(hidden), IMAGES_AT_ONCE):
        phasor = direct * (1 + hidden[start : start + IMAGES_AT_ONCE])
        channels = inputs.apply(phasor, inputs.reference_of_image(phasor, wall), is_weighted=True)
        found.append(channels[:, images.channels].reshape(len(phasor), -1))
    return np.concatenate(found).astype(np.float64)


def _hidden(
    images: BounceImages, room: Room, wall: ExpectedWall, object_depth_m: tuple[float, float]
) -> NDArray[np.complex128]:
    """(V, r, c, F) hidden light of the points over the direct light; 0 for those in front of the wall."""
    height, width = wall.rays.shape[:2]
    rays = wall.rays.reshape(-1, 3)
    meets = rays @ room.plane_per_m > 0
    light = Bounces(room, rays[meets], width / height, wall.frequencies_hz, fine=True)
    rows, columns = images.shape
    towards = pixel_rays(columns, rows, room.horizontal_fov_deg).reshape(-1, 3)
    mean_m, spread_m = object_depth_m
    depths_m = mean_m + spread_m * np.linspace(-SPREADS, SPREADS, PLANES)
    found = np.zeros((PLANES, len(towards), len(rays), len(wall.frequencies_hz)), complex)
    for depth_m, plane in zip(depths_m, found, strict=True):
        behind = depth_m * (towards @ room.plane_per_m) > 1  # where the mirror image is
        places_m = room.points_m(np.full(np.count_nonzero(behind), depth_m), towards[behind])
        plane[np.ix_(behind, meets)] = light.of_points(
            places_m, CROSS_SECTION_M2, ROUGHNESS if room.is_rough else None
        )
    return found.reshape(-1, height, width, len(wall.frequencies_hz))
