"""The wall fit that explains a measurement best: with known or any offsets, as expected or elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from itof.arrays import Floats, Phasors
from itof.light import OFFSET_STD_RAD, phase
from itof.unwrapping import combined_range_m, unwrap_depth
from itof.wall.expected_wall import NumpyWall
from itof.wall.wall_fit import (
    MOST_PIXELS,
    RobustFit,
    fit_wall,
    pixel_weights,
    without_unit,
)

_FARTHEST_M = 30.0  # of a wall that is searched
_NEAREST_M = 1e-3
_STEPS = 40  # of the search; each takes a few milliseconds at 320 x 240
_SAME_PLANE = 1e-6  # relative change of a step that ends the search: the fit goes on from there


def locate_wall(
    phasor: Phasors,
    wall: NumpyWall,
    *,
    direct: Phasors | None = None,
    offset_std_rad: ArrayLike = OFFSET_STD_RAD,
) -> RobustFit | None:
    """The fit of the wall that explains the phases (H, W, F); None if too few pixels hold light.

    If the wall is not near its expected place, it is searched everywhere. With `direct`, a measured direct
    return, it is only searched near the place that this return shows. `offset_std_rad` is as in `best_fit`.
    """
    try:
        if direct is not None:
            return best_fit(phasor, wall.captured(direct), offset_std_rad=offset_std_rad)
        near = best_fit(phasor, wall, offset_std_rad=offset_std_rad)
        if near.distance_is_known:
            return near
        far = best_fit(phasor, wall, plane_from_nothing(phasor, wall), offset_std_rad=offset_std_rad)
    except ValueError:  # too few pixels
        return None
    if far.distance_is_known or not near.shows_wall:
        return max(near, far, key=lambda each: (each.distance_is_known, float(each.wall_share.mean())))
    return near


def found(fit: RobustFit | None) -> bool:
    """Whether the fit shows a wall at every frequency."""
    return fit is not None and fit.shows_wall


def plane_from_nothing(phasor: ArrayLike, wall: NumpyWall) -> Floats:
    """(3,) plane m of a wall whose pose is unknown, 1/m in camera axes: a start for `fit_wall`.

    The phases of all frequencies together give each pixel's distance L (`itof.unwrap_depth`), and
    1 / L = m · r is linear in m. Of the expected wall only rays and frequencies are used. Pixels are
    weighted by |z|² and by the inverse of their error (least absolute deviations).

    Raises
    ------
    ValueError : no pixel holds light.
    """
    z = without_unit(phasor, wall)
    lit = np.flatnonzero((z != 0).all(-1))
    if not lit.size:
        raise ValueError("no pixel holds light")
    lit = lit[:: max(1, len(lit) // MOST_PIXELS)]
    z, rays = z.reshape(-1, z.shape[-1])[lit], wall.rays.reshape(-1, 3)[lit]
    limit_m = min(combined_range_m(wall.frequencies_hz), _FARTHEST_M)
    depth_m = np.maximum(unwrap_depth(phase(z), wall.frequencies_hz, limit_m), _NEAREST_M)  # (n,)
    weight = pixel_weights(z, z) * depth_m**4  # d(1/L) = -dL / L²
    error_m, plane = np.ones_like(depth_m), np.zeros(3)
    for _ in range(_STEPS):
        root = np.sqrt(weight / weight.sum() / error_m)
        before = plane
        plane = np.linalg.lstsq(rays * root[:, None], root / depth_m, rcond=None)[0]
        error_m = np.maximum(np.abs(rays @ plane - 1 / depth_m) * depth_m**2, _NEAREST_M)
        if np.linalg.norm(plane - before) < _SAME_PLANE * np.linalg.norm(plane):
            break
    return plane


def best_fit(
    phasor: Phasors,
    wall: NumpyWall,
    start_per_m: Floats | None = None,
    *,
    offset_std_rad: ArrayLike = OFFSET_STD_RAD,
) -> RobustFit:
    """The fit from one start (`itof.wall.wall_fit.fit_wall`); any offsets if the known ones do not do."""
    fit = fit_wall(phasor, wall, offset_std_rad=offset_std_rad, start_per_m=start_per_m)
    if fit.distance_is_known:
        return fit
    free = fit_wall(phasor, wall, offset_std_rad=np.inf, start_per_m=start_per_m)
    return min(fit, free, key=lambda each: each.mismatch)
