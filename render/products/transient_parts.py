"""When the direct return of a pixel has ended and when its hidden light begins, from the geometry of a scene.

A transient file holds the sum of both parts. Light that met the hidden object went a longer way, so the time
of a bin tells which part it belongs to, as docs/reference/files.md (Transients) says.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from disk import NightError, inside
from disk.plain_file import read_plain
from itof import WIDEST_REACH_BINS, TransientLayout, pixel_rays
from render.settings import RenderError
from scenegen import Dataset, Scene, camera_axes, rotation_matrix, wall_normal
from scenegen.mitsuba_description import hidden_names
from scenegen.pose import mirror_image
from scenegen.scene_folder import MOST_FILE_BYTES
from scenegen.triangles import scene_triangles

_MOST_TRIANGLES = 200_000  # looked at again in finer parts
_FINEST = 16  # times that triangles are divided


def direct_end_m(scene: Scene, layout: TransientLayout) -> NDArray[np.float64]:
    """(H, W) optical path length after which a pixel has no direct return, metres.

    It is twice the way to the farthest point of the relay wall in the pixel. On a plane, the distance to a
    point is convex, so the farthest point of a pixel is a corner of it. What is beyond the wall's own corners
    returns nothing. The bin whose centre is 1.5 bins later is the last with direct light.
    """
    far_m = _corner_depths_m(scene, layout)
    return 2 * np.maximum.reduce([far_m[:-1, :-1], far_m[1:, :-1], far_m[:-1, 1:], far_m[1:, 1:]])


def first_hidden_bin(scene: Scene, layout: TransientLayout) -> NDArray[np.int64]:
    """(H, W) the first bin of a pixel without direct light; at most the number of bins."""
    bins = (direct_end_m(scene, layout) - layout.start_opl_m) / layout.bin_width_m
    # Bin n has its centre at n + 1/2.
    after = np.floor(bins + WIDEST_REACH_BINS - 0.5) + 1
    return np.clip(after, 0, layout.bin_count).astype(np.int64)


def hidden_start_m(dataset: Dataset, scene: Scene, layout: TransientLayout, row: int, column: int) -> float:
    """Optical path length before which a pixel has no hidden light, metres, to a bin.

    Light from the projector e reaches a point s of the hidden object over the wall, so its way is at least
    that from the mirror image of e straight to s. From s it goes to a point w of the wall in the pixel, and
    from there to the camera. This is the minimum of |e' - s| + |s - w| over the object, less the
    extent of the pixel on the wall, plus the shortest way to the camera. Further bounces make the way longer.

    In an empty corner it is infinite.

    Raises
    ------
    RenderError : a mesh of the scene is missing or damaged.
    """
    if not scene.hidden_objects:
        return np.inf
    depths_m = _corner_depths_m(scene, layout)[row : row + 2, column : column + 2]  # (2, 2)
    camera_m = np.array(scene.camera.location_m)
    directions = _corner_rays(scene, layout)[row : row + 2, column : column + 2]
    corners_m = (camera_m + depths_m[..., None] * directions).reshape(4, 3)
    middle_m = corners_m.mean(axis=0)
    extent_m = np.linalg.norm(corners_m - middle_m, axis=-1).max()
    image_m = mirror_image(np.array(scene.emitter.location_m), scene.relay_wall)
    way_m = _shortest_way_m(_object_triangles(dataset, scene), image_m, middle_m, layout.bin_width_m)
    return way_m - extent_m + float(depths_m.min())


def _shortest_way_m(
    triangles: NDArray[np.float64], start_m: NDArray[np.float64], end_m: NDArray[np.float64], error_m: float
) -> float:
    """A lower bound of the shortest way from `start_m` to `end_m` over a point of `triangles`, to `error_m`.

    From the middle of a triangle to any other point of it, the way changes by at most twice the distance.
    Triangles that can be on the shortest way are divided into four, until the bound is good enough.
    """
    for _ in range(_FINEST):
        middle = triangles.mean(axis=1)  # (M, 3)
        radius = np.linalg.norm(triangles - middle[:, None], axis=-1).max(axis=1)
        way = np.linalg.norm(middle - start_m, axis=1) + np.linalg.norm(middle - end_m, axis=1)
        low = way - 2 * radius
        if low.min() > way.min() - error_m:
            break
        near = triangles[low < way.min()]
        if len(near) > _MOST_TRIANGLES:
            break
        triangles = _quarters(near)
    return float(low.min())


def _quarters(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4 M, 3, 3) the four parts of each triangle (M, 3, 3), by the middles of its sides."""
    a, b, c = triangles.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _object_triangles(dataset: Dataset, scene: Scene) -> NDArray[np.float64]:
    """(M, 3, 3) corners of all triangles of the hidden objects."""
    found = []
    for name in hidden_names(scene):
        file = inside(dataset.scene_folder(scene.id), f"{name}.ply")
        try:
            vertices, triangles = scene_triangles(read_plain(file, MOST_FILE_BYTES), str(file))
        except (OSError, NightError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise RenderError(f"{file} cannot be read ({why}): run night-gen scenes again") from None
        found.append(vertices[triangles].astype(np.float64))
    return np.concatenate(found)


def _corner_rays(scene: Scene, layout: TransientLayout) -> NDArray[np.float64]:
    """(H + 1, W + 1, 3) unit vectors through the corners of all pixels, in world space."""
    # An image that is larger by one pixel, of the same pitch, has its pixel centres there.
    half = np.tan(np.radians(scene.camera.horizontal_fov_deg) / 2) * (layout.width + 1) / layout.width
    rays = pixel_rays(layout.width + 1, layout.height + 1, float(np.degrees(2 * np.arctan(half))))
    return rays @ camera_axes(scene.camera)


def _corner_depths_m(scene: Scene, layout: TransientLayout) -> NDArray[np.float64]:
    """(H + 1, W + 1) way to the relay wall through the corners of pixels, at most to its own corners."""
    wall, camera_m = scene.relay_wall, np.array(scene.camera.location_m)
    normal, place_m = wall_normal(wall), np.array(wall.location_m)
    towards = _corner_rays(scene, layout) @ normal
    gap_m = (place_m - camera_m) @ normal
    ahead = towards * gap_m > 0
    half = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * (*wall.size_m, 0.0)
    ends_m = place_m + half @ rotation_matrix(wall.rotation_deg).T  # (4, 3)
    farthest_m = np.linalg.norm(ends_m - camera_m, axis=1).max()
    return np.minimum(np.where(ahead, gap_m / np.where(ahead, towards, 1.0), np.inf), farthest_m)
