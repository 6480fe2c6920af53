"""Where the relay wall is, by captures of the empty corner.

A capture of the empty corner takes the camera's errors out of a measurement. It does not say by itself where
its wall is. If this is taken to be the expected one and is 4 cm elsewhere, the self-calibration of the
measurement takes other dimensions of the hidden light out, and the channels err by up to 15 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from itof.arrays import Floats, Phasors
from itof.frequency_images import frequencies_first
from itof.wall.expected_wall import (
    ExpectedWall,
    angle_deg,
    distance_m,
    strength_elsewhere,
)
from itof.wall.robust_solution import covariance
from itof.wall.self_calibration import calibrate, phases_over
from itof.wall.wall_fit import WallFit
from itof.wall.wall_phases import Residual, WallRays, by_pixel

_LARGEST_ERROR_M: Final = 0.01  # as much as a tape measure's
_EDGE_RAD: Final = 0.5  # a pixel that is farther off does not see the wall


@dataclass(frozen=True)
class CapturedPlane:
    """The plane of the relay wall as empty corners show it, beside the expected one.

    Attributes
    ----------
    plane_per_m : (3,) plane m in camera axes, 1/m: its points p have m · p = 1.
    expected_per_m : (3,) the plane that was expected.
    error_m : standard deviation that noise and errors of single pixels cause, in distance along the camera's
        rays (root mean square), with the scatter of several corners. Errors that are smooth over the image
        come on top.
    """

    plane_per_m: Floats
    expected_per_m: Floats
    error_m: float

    @property
    def is_certain(self) -> bool:
        """Whether it is known better than a preset's wall usually is."""
        return self.error_m <= _LARGEST_ERROR_M

    def as_data(self) -> dict[str, object]:
        """Plane, 1/m, its error, metres (None: no wall is seen), and whether it is used, for JSON."""
        error_m = self.error_m if np.isfinite(self.error_m) else None
        return {"plane_per_m": self.plane_per_m.tolist(), "error_m": error_m, "used": self.is_certain}

    @property
    def sentence(self) -> str:
        """How far the wall is from where it was expected."""
        if not np.isfinite(self.error_m):
            return "the empty corner shows no wall, so the wall is taken to be where it is expected"
        if not self.is_certain:
            return (
                f"noise and differences between captures make the wall of the empty corner uncertain by "
                f"{100 * self.error_m:.1f} cm, so the wall is taken to be where it is expected"
            )
        tilt_deg = angle_deg(self.expected_per_m, self.plane_per_m)
        away_cm = 100 * (distance_m(self.plane_per_m) - distance_m(self.expected_per_m))
        return (
            f"the empty corner shows the wall {abs(away_cm):.1f} cm {'farther' if away_cm > 0 else 'nearer'} "
            f"than expected and turned by {tilt_deg:.1f} degrees; noise makes its distance uncertain by "
            f"{1000 * self.error_m:.1f} mm"
        )


def find_wall(corners: Sequence[Phasors], wall: ExpectedWall) -> CapturedPlane:
    """The wall that captures (H, W, F) of the empty corner show, the mean of their planes.

    Plane, phase offsets and four-cycle errors are fitted to each (`itof.wall.self_calibration`). There is no
    hidden light that a fit could take for a wall elsewhere.

    Parameters
    ----------
    corners : at least one capture, complex; pixels that are 0 are not used.
    wall : the expected one, with its computed return; it may be off by some decimetres.

    Returns
    -------
    The wall. Its error has the scatter of the planes, too, so that of a camera that was moved is not certain.
    """
    fits = [calibrate(corner, wall, wiggling=True) for corner in corners]
    planes = np.array([fit.plane_per_m for fit in fits])
    plane = planes.mean(axis=0)
    errors = [_error_m(corner, fit, wall) for corner, fit in zip(corners, fits, strict=True)]
    # Not over the root of their number: errors of single pixels are those of the camera in every corner.
    error_m = float(np.sqrt(np.mean(np.square(errors)) + _scatter_m(planes, plane, wall) ** 2))
    return CapturedPlane(plane, np.asarray(wall.plane_per_m), error_m)


def _scatter_m(planes: Floats, plane: Floats, wall: ExpectedWall) -> float:
    """Root mean square of the distances between (N, 3) planes and their mean, along the rays."""
    inverse = wall.rays.reshape(-1, 3) @ np.concatenate([planes, plane[None]]).T
    inverse = inverse[(inverse > 0).all(axis=1)]
    if not len(inverse):
        return float("inf")
    return float(np.sqrt(((1 / inverse[:, :-1] - 1 / inverse[:, -1:]) ** 2).mean()))


def _error_m(corner: Phasors, fit: WallFit, wall: ExpectedWall) -> float:
    """Standard deviation of the wall's distance by the phases that a fit leaves; infinite if none shows it.

    The weights are those of the expected wall, which are nearly those of the fit.
    """
    problem, direct = phases_over(corner, wall, wiggling=True), fit.moved(corner, wall)
    left = np.angle(corner * np.conj(direct))  # (H, W, F)
    inverse = wall.rays @ fit.plane_per_m  # (H, W), over the distance
    good = (corner != 0).all(-1) & (direct != 0).all(-1) & (np.abs(left).max(-1) < _EDGE_RAD)
    good = (good & (inverse > 0)).reshape(-1)
    if np.count_nonzero(good) < 3 + 3 * left.shape[-1]:
        return float("inf")
    depth_m = 1 / np.where(good, inverse.reshape(-1), 1.0)
    left = by_pixel(problem.xp, frequencies_first(problem.xp, left))  # (F, n)
    weight = np.broadcast_to(good * np.abs(wall.direct[..., 0]).reshape(-1) ** 2, left.shape)
    of_unknowns = covariance(problem, Residual(left, depth_m, good), weight, weight * left)[:3, :3]
    of_distance = problem.pixels.tangent(depth_m)[:, good]
    return float(np.sqrt(np.einsum("ip,ij,jp->p", of_distance, of_unknowns, of_distance).mean()))


def captured_wall(corner: Phasors, wall: ExpectedWall) -> ExpectedWall:
    """The wall with the return of a capture (H, W, F) of the empty corner, where this capture shows it.

    Where noise leaves more than a centimetre of its distance, it is the expected wall. The weights of pixels
    in fits, which decide what of the hidden light is lost, are those of a diffuse wall there.

    Parameters
    ----------
    wall : the expected one, with its computed return.

    Returns
    -------
    The wall, with `corner` as its return, the plane of the capture, and weights in any unit.
    """
    found, captured = find_wall([corner], wall), wall.captured(corner)
    if not found.is_certain:
        return captured
    pixels = WallRays.of(wall)
    depth_m, meets = pixels.depth_m(found.plane_per_m)
    share = (strength_elsewhere(pixels.expected_depth_m, depth_m) * meets).reshape(wall.meets.shape)
    return replace(captured, plane_per_m=found.plane_per_m, strength=captured.strength * share)
