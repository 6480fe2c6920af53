"""Walls and camera frusta as polygons, for a picture of a scene from outside."""

from __future__ import annotations

from math import radians

import numpy as np
from numpy.typing import NDArray

from scenegen.pose import camera_axes, rotation_matrix
from scenegen.scene import Camera, Wall


def wall_corners(wall: Wall) -> NDArray[np.float64]:
    """(4, 3) corners of a wall in world space, metres, in order around it."""
    right, up, _ = rotation_matrix(wall.rotation_deg).T
    across, along = wall.size_m[0] / 2 * right, wall.size_m[1] / 2 * up
    offsets = np.array([-across - along, across - along, across + along, along - across])
    return np.array(wall.location_m) + offsets


def frustum_edges(camera: Camera) -> NDArray[np.float64]:
    """(4, 3) directions through the image's corners in world space, in order, of z-depth 1."""
    half_width = np.tan(radians(camera.horizontal_fov_deg) / 2)
    half_height = half_width * camera.height / camera.width
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (half_width, half_height)
    return np.column_stack([corners, np.ones(4)]) @ camera_axes(camera)


def frustum_sides(camera: Camera) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """The frustum's four planes: a point of each (the camera's location), and its inward normal."""
    edges = frustum_edges(camera)
    normals = [
        np.cross(edge, following) for edge, following in zip(edges, np.roll(edges, -1, 0), strict=True)
    ]
    forward = edges.mean(axis=0)
    return [(np.array(camera.location_m), normal * np.sign(normal @ forward)) for normal in normals]


def clipped(
    polygon: NDArray[np.float64], planes: list[tuple[NDArray[np.float64], NDArray[np.float64]]]
) -> NDArray[np.float64]:
    """The part of a convex polygon that lies on the inner side of all planes.

    Parameters
    ----------
    polygon : (M, 3) corners in order.
    planes : a point (3,) and the inward normal (3,) of each.

    Returns
    -------
    (N, 3) corners in order; N is 0 where nothing is left.

    Source: Sutherland and Hodgman 1974.
    """
    for point, normal in planes:
        heights = (polygon - point) @ normal
        kept = []
        for index, height in enumerate(heights):
            before = heights[index - 1]
            if (height >= 0) != (before >= 0):
                kept.append(
                    polygon[index - 1] + before / (before - height) * (polygon[index] - polygon[index - 1])
                )
            if height >= 0:
                kept.append(polygon[index])
        polygon = np.array(kept).reshape(-1, 3)
    return polygon
