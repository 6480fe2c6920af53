"""The linear inverse of the three bounces, which shows a network the hidden scene beside its input.

At each coarse pixel of the mirrored scene and at each of a few depths, a small white sphere scatters light
back to the wall. Its measurement is converted to input channels y_v. Any measurement y is taken for a sum of
them, y = sum_v a_v y_v. Least squares with Tikhonov's damping gives

    a = U diag(s / (s² + λ P)) V^T y,

with the matrix of all y_v = U diag(s) V^T and their mean power P. Only the largest singular values s are
kept, because no measurement shows the others. The a_v of one depth are an image
(`model.network.bounce_images`).
"""

from __future__ import annotations

from dataclasses import replace
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
from model.refinement.light.corner_light import CornerLight, Mirror, vector
from scenegen.scene import HiddenObject, Scene

SPHERE_M: Final = 4e-3  # diameter: so small that the channels are linear in its light
SPREADS: Final = 2.0  # standard deviations of the object's depth, in front of its mean and behind
DAMPING: Final = 1e-2  # λ
_DARK: Final = 1e-30  # where no light comes back from anywhere, the images are black
ROUGHNESS: Final = 0.6  # of a relay wall whose roughness is not known: the middle of the preset `paper`


def bounce_inverse(
    images: BounceImages,
    corner: Scene,
    view: WallView,
    inputs: InputSpec,
    object_depth_m: tuple[float, float],
) -> dict[str, Tensor]:
    """The buffers of `images` for a corner.

    Parameters
    ----------
    images : for their shapes; they stay as they are.
    corner, view : the corner; its hidden objects do not matter.
    inputs : input channels of the network.
    object_depth_m : mean and standard deviation of the object's radial depth, metres.

    Returns
    -------
    ``project`` and ``expand`` of `BounceImages`.
    """
    with one_thread():  # with several, no two results are the same to the bit
        y = _responses(images, corner, view, inputs, object_depth_m)  # (V, M)
        across, singular, down = np.linalg.svd(y, full_matrices=False)
    rank = len(images.project)
    across, singular, down = across[:, :rank], singular[:rank], down[:rank]
    power = max(float((y**2).sum(axis=1).mean()), _DARK)
    project = (singular / (singular**2 + DAMPING * power))[:, None] * down
    arrays = {"project": project, "expand": across}
    return {name: torch.as_tensor(array, dtype=torch.float32).contiguous() for name, array in arrays.items()}


def _responses(
    images: BounceImages,
    corner: Scene,
    view: WallView,
    inputs: InputSpec,
    object_depth_m: tuple[float, float],
) -> NDArray[np.float64]:
    """(V, M) residual channels of a sphere at each place, on the coarse parts of the wall."""
    height, width = images.seen
    direct = view.direct_phasors(width, height, inputs.frequencies_hz)
    wall = view.expected_wall(direct, inputs.frequencies_hz)
    hidden = _hidden(images, corner, wall, object_depth_m)
    found = []
    for start in range(0, len(hidden), IMAGES_AT_ONCE):
        phasor = direct * (1 + hidden[start : start + IMAGES_AT_ONCE])
        channels = inputs.apply(phasor, inputs.reference_of_image(phasor, wall), is_weighted=True)
        found.append(channels[:, images.channels].reshape(len(phasor), -1))
    return np.concatenate(found).astype(np.float64)


def _hidden(
    images: BounceImages, corner: Scene, wall: ExpectedWall, object_depth_m: tuple[float, float]
) -> NDArray[np.complex128]:
    """(V, r, c, F) hidden light of the spheres over the direct light; 0 for those in front of the wall."""
    plane = np.asarray(wall.plane_per_m)
    rays = wall.rays.reshape(-1, 3)
    meets = rays @ plane > 0
    rows, columns = images.shape
    towards = pixel_rays(columns, rows, corner.camera.horizontal_fov_deg).reshape(-1, 3)
    mean_m, spread_m = object_depth_m
    depths_m = mean_m + spread_m * np.linspace(-SPREADS, SPREADS, PLANES)
    depth_m, towards = np.repeat(depths_m, len(towards)), np.tile(towards, (PLANES, 1))
    behind = depth_m * (towards @ plane) > 1  # where the mirror image is
    relay = corner.relay_wall
    corner = replace(corner, relay_wall=replace(relay, roughness=ROUGHNESS if relay.roughness else None))
    spheres = [
        replace(
            corner, hidden_objects=(HiddenObject("sphere", (SPHERE_M,) * 3, vector(place), (0, 0, 0), 1),)
        )
        for place in Mirror(corner.camera, plane).points_m(depth_m[behind], towards[behind])
    ]
    found = np.zeros((len(depth_m), len(rays), len(wall.frequencies_hz)), complex)
    if spheres:
        light = CornerLight(wall.frequencies_hz).over_direct(spheres, rays[meets], fine=False)
        found[np.ix_(behind, meets)] = light
    return found.reshape(-1, *wall.rays.shape[:2], len(wall.frequencies_hz))
