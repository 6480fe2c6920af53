"""The three-bounce integral of a small diffuse patch behind the corner, by Gauss quadrature in numpy alone.

Camera, projector and wall are those of `many_light_scenes`, without the middle wall: an endless diffuse wall
of reflectance 1 in the plane x = 0, lit inside the projector's frustum, and a patch of reflectance 1 that the
whole lit and visible wall sees from its front.

    z_f(pixel) = mean over the pixel of  ∫ patch dA_p  (1/π) cos b cos a / d²  e^{jk (t + d)}  (1/π) E_f(p)
    E_f(p) = ∫ lit wall dA_w  L(w)  cos c cos e / s²  e^{jk (r + s)},      L(w) = E0 cos g / (r² cos³ o)

r, g, o: distance of the wall point from the projector, its angles to the wall normal and the optical axis.
"""

from __future__ import annotations

import numpy as np

from itof import phase_per_metre, pixel_rays

_WALL_NORMAL = np.array([1.0, 0.0, 0.0])


def hidden_phasors(
    width,
    height,
    frequencies_hz,
    patch,
    normal,
    *,
    camera,
    axes,
    camera_fov_deg,
    projector_fov_deg,
    order=40,
    convex=False,
):
    """(H, W, F) phasors, averaged over pixels.

    Parameters
    ----------
    patch : (4, 3) corners of a parallelogram, in order.
    normal : (3,) towards the wall.
    camera : (3,) location of camera and projector, at the same height as the axis, which is horizontal.
    axes : (3, 3) rows right, down, forward.
    order : Gauss nodes along each axis of the lit wall.
    convex : whether the patch is a face of a convex body, which may turn its back to parts of the wall.
    """
    turns = phase_per_metre(frequencies_hz)
    normal = np.asarray(normal) / np.linalg.norm(normal)
    points, areas = _parallelogram_nodes(np.asarray(patch), 6)  # (P, 3), (P,)
    wall, weights = _lit_wall(camera, axes, width / height, projector_fov_deg, order)  # (M, 3), (M,)
    r = np.linalg.norm(wall - camera, axis=1)
    towards = (wall - camera) / r[:, None]
    radiance = -(towards @ _WALL_NORMAL) / (r**2 * (towards @ axes[2]) ** 3)  # (M,)
    transfer, distance = _form_factor(wall, points, normal, convex)  # (M, P)
    irradiance = [
        np.einsum("m,mp->p", weights * radiance * np.exp(1j * k * r), transfer * np.exp(1j * k * distance))
        for k in turns
    ]  # F of (P,)
    nodes = 6
    x, weight = np.polynomial.legendre.leggauss(nodes)
    share = np.outer(weight, weight) / 4  # of a pixel: Gauss weights sum to 2 on each axis
    z = np.zeros((height, width, len(turns)), complex)
    half_width = np.tan(np.radians(camera_fov_deg) / 2)
    pitch = 2 * half_width / width  # of pixels at unit depth
    centres = pixel_rays(width, height, camera_fov_deg)
    centres = centres / centres[..., 2:]
    for row in range(nodes):
        for column in range(nodes):
            offset = np.array([x[column], x[row], 0]) * pitch / 2
            rays = (centres + offset) @ axes
            rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
            t = camera[0] / -rays[..., 0]
            seen = camera + t[..., None] * rays  # (H, W, 3)
            transfer, distance = _form_factor(seen, points, normal, convex)  # (H, W, P)
            for index, k in enumerate(turns):
                arrived = areas * irradiance[index] / np.pi**2
                z[..., index] += share[row, column] * np.einsum(
                    "hwp,p,hw->hw", transfer * np.exp(1j * k * distance), arrived, np.exp(1j * k * t)
                )
    return z


def _form_factor(wall, points, normal, convex):
    """cos cos / d² between wall points (..., 3) and patch points (P, 3), and d: (..., P) each."""
    gap = points - wall[..., None, :]
    distance = np.linalg.norm(gap, axis=-1)
    at_wall = gap @ _WALL_NORMAL / distance
    at_patch = -gap @ normal / distance
    assert (at_wall > 0).all(), "every wall point lies before the patch"
    assert convex or (at_patch > 0).all(), "the patch shows its front to every wall point"
    at_patch = np.maximum(at_patch, 0)
    return at_wall * at_patch / distance**2, distance


def _parallelogram_nodes(corners, order):
    x, weight = np.polynomial.legendre.leggauss(order)
    u, v = np.meshgrid((x + 1) / 2, (x + 1) / 2)  # from [-1, 1] to [0, 1]
    a, b = corners[1] - corners[0], corners[3] - corners[0]
    area = np.linalg.norm(np.cross(a, b))
    points = corners[0] + u.ravel()[:, None] * a + v.ravel()[:, None] * b
    return points, area * np.outer(weight, weight).ravel() / 4  # weights sum to 2 on each axis


def _lit_wall(camera, axes, aspect, fov_deg, order):
    """Gauss nodes (M, 3) and area weights (M,) in the trapezium that the projector lights.

    The axis is horizontal, so the frustum's left and right planes meet the wall in vertical lines, and its
    top and bottom lie at ± tan(vertical half angle) x depth along the axis.
    """
    slope = np.tan(np.radians(fov_deg) / 2)
    edges = []
    for side in (-slope, slope):
        ray = axes[2] + side * axes[0]
        edges.append(camera[1] + ray[1] * camera[0] / -ray[0])
    x, weight = np.polynomial.legendre.leggauss(order)
    low, high = sorted(edges)
    y = low + (x + 1) / 2 * (high - low)  # from [-1, 1]
    depth = (np.stack([np.zeros(order), y, np.full(order, camera[2])], axis=1) - camera) @ axes[2]
    half_height = slope / aspect * depth
    z = camera[2] + half_height[:, None] * x
    points = np.stack([np.zeros((order, order)), np.repeat(y[:, None], order, axis=1), z], axis=-1)
    area = (high - low) / 2 * weight[:, None] * half_height[:, None] * weight  # Gauss weights sum to 2
    return points.reshape(-1, 3), area.ravel()
