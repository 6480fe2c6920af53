"""Point clouds of depth maps.

Points are in *camera axes*: x to the right, y down, z forward, metres, camera at the origin. They show the
mirrored scene: the mirror image of the hidden object in the relay wall.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from itof import points_from_radial
from scenegen import whole_file


def object_points(
    radial_depth_m: ArrayLike, mask: ArrayLike, horizontal_fov_deg: float
) -> NDArray[np.float32]:
    """(n, 3) points in camera axes, metres, of the pixels of a (H, W) depth map that show the object."""
    points = points_from_radial(radial_depth_m, horizontal_fov_deg)  # (H, W, 3)
    return points[np.asarray(mask).astype(bool)].astype(np.float32)


def write_point_cloud(path: Path, points_m: NDArray[np.float32]) -> None:
    """Write (n, 3) points as a binary PLY file, whole or not at all.

    Raises
    ------
    ValueError : there are no points; most viewers cannot open such a file.
    """
    if not len(points_m):
        raise ValueError(f"{path} would hold no points")
    with whole_file(path, sweep=False) as partial:  # many files in a new folder: nothing to sweep
        partial.write_bytes(trimesh.PointCloud(points_m).export(file_type="ply"))
