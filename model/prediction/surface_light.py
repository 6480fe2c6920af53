"""The hidden light of a predicted surface: what a camera would see if a depth map were true.

Light goes from the projector, which is at the camera, to the wall, to the surface, back to the wall and to
the camera. It factorises at the surface: its points are lit by the wall (W x P terms), and light the pixels
(P x H W terms). All reflections are diffuse, and nothing is hidden by anything else. The source is
`render.batch`'s equation; this is its coarse form for surfaces that are no solids, without Mitsuba.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from itof.arrays import Bools, Floats, Phasors
from itof.light import phase_per_metre
from itof.wall.expected_wall import ExpectedWall

# Pixels, about, that light the surface, that it lights, and its own: spread over the image.
_LIT, _SEEN, _OWN = 300, 500, 400
_STEEPEST: Final = 0.15  # cosine to the ray: steeper pixels are jumps from one surface to another


def surface_light(radial_depth_m: Floats, mask: Bools, wall: ExpectedWall) -> Phasors:
    """(H, W, F) phasors of the light that has met the surface, in any unit; all 0 without a surface.

    Parameters
    ----------
    radial_depth_m : (H, W) of the mirror image of the surface, metres.
    mask : (H, W) its pixels.
    wall : the relay wall where it is.
    """
    rays, plane = np.asarray(wall.rays), np.asarray(wall.plane_per_m)
    normal = plane / np.linalg.norm(plane)  # away from the camera
    points, normals, area = _patches(radial_depth_m, mask, rays)
    points = mirrored(points, plane)
    normals = normals - 2 * (normals @ normal)[:, None] * normal
    lit_step, step = (max(1, math.isqrt(mask.size // count)) for count in (_LIT, _SEEN))
    (lit, lit_m), (seen, seen_m) = (
        ways(points, normals, wall, (slice(None, None, every),) * 2) for every in (lit_step, step)
    )
    found = []
    for slope in phase_per_metre(wall.frequencies_hz):
        at_surface = (lit * np.exp(1j * slope * lit_m)).sum(axis=0) * area
        found.append((seen * np.exp(1j * slope * seen_m)) @ at_surface)
    height, width = mask.shape
    coarse = np.stack(found, axis=-1).reshape(-(-height // step), -(-width // step), len(found))
    fine: Phasors = coarse.repeat(step, axis=0).repeat(step, axis=1)[:height, :width]
    return fine


def ways(
    points: Floats, normals: Floats, wall: ExpectedWall, pixels: tuple[slice, slice]
) -> tuple[Floats, Floats]:
    """Ways between P patches (P, 3) and the n wall points that some rows and columns of pixels see.

    Returns
    -------
    (n, P) both cosines over the square of the distance, 1/m², 0 where a ray misses the wall; and (n, P) the
    length of the way from the camera over the wall to the patch, metres.
    """
    normal = np.asarray(wall.plane_per_m) / np.linalg.norm(wall.plane_per_m)  # away from the camera
    there = np.asarray(wall.radial_depth_m)[pixels].reshape(-1)
    meets = np.isfinite(there)
    there = np.where(meets, there, 1.0)
    rays = np.asarray(wall.rays)[pixels].reshape(-1, 3)
    apart = points - (rays * there[:, None])[:, None]  # (n, P, 3)
    distance_m = np.linalg.norm(apart, axis=-1)
    from_wall = np.maximum(-(apart @ normal), 0.0)
    to_wall = np.maximum(-np.einsum("npk,pk->np", apart, normals), 0.0)
    return meets[:, None] * from_wall * to_wall / distance_m**4, distance_m + there[:, None]


def mirrored(points: Floats, plane_per_m: Floats) -> Floats:
    """Points (P, 3) in camera axes, reflected in the plane of a wall."""
    image: Floats = (
        points - 2 * ((points @ plane_per_m - 1) / (plane_per_m @ plane_per_m))[:, None] * plane_per_m
    )
    return image


def _patches(radial_depth_m: Floats, mask: Bools, rays: Floats) -> tuple[Floats, Floats, Floats]:
    """Points (P, 3), unit normals towards the camera (P, 3) and areas (P,) of pixels of a mask."""
    place = rays * radial_depth_m[..., None]
    across, down = _differences(place, mask, 1), _differences(place, mask, 0)
    normal = np.cross(across, down)
    area = np.linalg.norm(normal, axis=-1)
    used = np.flatnonzero(mask & (area > 0))
    step = max(1, len(used) // _OWN)
    used = used[::step]
    points, area = place.reshape(-1, 3)[used], area.reshape(-1)[used]
    normals = normal.reshape(-1, 3)[used] / area[:, None]
    normals = normals * -np.sign((normals * points).sum(axis=-1))[:, None]
    straight = (points**2).sum(axis=-1) * np.square(np.linalg.norm(rays[0, 1] - rays[0, 0]))
    return points, normals, step * np.minimum(area, straight / _STEEPEST)


def _differences(place: Floats, mask: Bools, axis: int) -> Floats:
    """(H, W, 3) steps to the next pixel of the mask, or from the last one; 0 where there is neither."""
    step = np.diff(place, axis=axis)
    both = np.moveaxis(mask, axis, 0)[1:] & np.moveaxis(mask, axis, 0)[:-1]
    step = np.where(np.moveaxis(both, 0, axis)[..., None], step, 0.0)
    pad = [(0, 0)] * 3
    pad[axis] = (0, 1)
    ahead = np.pad(step, pad)
    pad[axis] = (1, 0)
    behind = np.pad(step, pad)
    return np.where((ahead != 0).any(axis=-1, keepdims=True), ahead, behind)
