"""Point clouds of depth maps, their distance from the truth, and their colours.

Points are in *camera axes*: x to the right, y down, z forward, metres, camera at the origin. They show the
mirrored scene: the mirror image of the hidden object in the relay wall.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from disk import whole_file
from itof import points_from_radial

TRUTH_COLOUR = "#3565f0"
DISTANCE_COLOURS = ("#0a8f3c", "#e8c21a", "#d01c1c")  # at distance 0, FAR_M / 2 and FAR_M
FAR_M = 0.2  # distance from the truth at and above which a point has the last colour
DISTANCE_COLOUR_MAP = LinearSegmentedColormap.from_list("distance", DISTANCE_COLOURS)


def object_points(
    radial_depth_m: ArrayLike, mask: ArrayLike, horizontal_fov_deg: float
) -> NDArray[np.float32]:
    """(n, 3) points in camera axes, metres, of the pixels of a (H, W) depth map that show the object."""
    points = points_from_radial(radial_depth_m, horizontal_fov_deg)  # (H, W, 3)
    return points[np.asarray(mask).astype(bool)].astype(np.float32)


def distances_m(points_m: NDArray[np.float32], truth_m: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n,) distance of each of (n, 3) points from the nearest of (m, 3) points of the truth, metres.

    The truth is known at its pixels only. Beside the surface that a pixel shows, a distance can therefore be
    too large, by at most the distance of neighbouring true points. It is infinite if there is no true point.
    """
    if not len(truth_m):
        return np.full(len(points_m), np.inf)
    found: NDArray[np.float64] = cKDTree(truth_m).query(points_m)[0]
    return found


def distance_colours(distance_m: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(n, 4) RGBA of (n,) distances: green at 0, over yellow to red at FAR_M and above.

    Source: Caligiuri et al. 2024, Fig. 6 (green is close, red is far); the scale is ours.
    """
    colours: NDArray[np.uint8] = DISTANCE_COLOUR_MAP(np.minimum(distance_m / FAR_M, 1.0), bytes=True)
    return colours


def write_point_cloud(
    path: Path, points_m: NDArray[np.float32], colours: NDArray[np.uint8] | None = None
) -> None:
    """Write (n, 3) points as a binary PLY file, whole or not at all.

    Parameters
    ----------
    colours : (n, 4) or (4,) RGBA of the points; None for a file without colours.

    Raises
    ------
    ValueError : there are no points; most viewers cannot open such a file.
    """
    if not len(points_m):
        raise ValueError(f"{path} would hold no points")
    cloud = trimesh.PointCloud(points_m, colors=colours)
    with whole_file(path, sweep=False) as partial:  # many files in a new folder: nothing to sweep
        partial.write_bytes(cloud.export(file_type="ply"))
