"""Where the relay wall is, by captures of the empty corner.

A capture of the empty corner takes the camera's errors out of a measurement. It does not say by itself where
its wall is. Self-calibration takes some dimensions of the hidden light out of the channels, which depend on
how the wall is turned, and hardly on its distance: for `night-80x60`, 10 cm change nothing, and 0.25, 0.5, 1
and 2 degrees raise an MAE of 0.89 cm to 1.0, 1.3, 1.9 and 3.2 cm (`benchmarks/wall_error.py --captured`). So
a capture whose distance is uncertain still says what a prediction needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from itof.arrays import Floats, Phasors
from itof.light import OFFSET_STD_RAD
from itof.other_surfaces import is_dark
from itof.wall.expected_wall import NumpyWall, angle_deg, distance_m, strength_elsewhere
from itof.wall.finding import length
from itof.wall.wall_fit import plane_std
from itof.wall.wall_phases import WallRays
from itof.wall.wall_search import found, locate_wall

_LARGEST_STD_M: Final = 0.015  # about as a tape measure's
LARGEST_TILT_DEG: Final = 2.0  # about as a camera is turned by hand


@dataclass(frozen=True)
class CapturedPlane:
    """The plane of the relay wall as empty corners show it, beside the expected one.

    Attributes
    ----------
    plane_per_m : (3,) plane m in camera axes, 1/m: its points p have m · p = 1.
    expected_per_m : (3,) the plane that was expected.
    distance_std_m, tilt_std_deg : standard deviations of its distance along its normal, metres, and of its
        angle, degrees, with errors that are smooth over the image (`itof.wall.robust_solution`) and the
        scatter of several corners; infinite if a capture shows no wall.
    needs_distance : whether it is for the truth of a dataset; predictions need the angle alone.
    """

    plane_per_m: Floats
    expected_per_m: Floats
    distance_std_m: float
    tilt_std_deg: float
    needs_distance: bool = False

    @property
    def is_certain(self) -> bool:
        """Whether it is known about as well as a preset's wall usually is."""
        is_near = not self.needs_distance or self.distance_std_m <= _LARGEST_STD_M
        return is_near and self.tilt_std_deg <= LARGEST_TILT_DEG

    def as_data(self) -> dict[str, object]:
        """The plane, 1/m, its standard deviations (None: no wall is seen), and whether it is used."""
        seen = np.isfinite(self.distance_std_m)
        return {
            "plane_per_m": self.plane_per_m.tolist(),
            "distance_std_m": self.distance_std_m if seen else None,
            "tilt_std_deg": self.tilt_std_deg if seen else None,
            "used": self.is_certain,
        }

    @property
    def sentence(self) -> str:
        """How far the wall is from where it was expected."""
        if not np.isfinite(self.distance_std_m):
            return "the empty corner shows no wall, so the wall is taken to be where it is expected"
        if not self.is_certain:
            return (
                f"the empty corner leaves the wall's distance uncertain by {length(self.distance_std_m)} and "
                f"its angle by {self.tilt_std_deg:.1f} degrees, so the wall is taken to be where it is "
                "expected"
            )
        tilt_deg = angle_deg(self.expected_per_m, self.plane_per_m)
        away_m = distance_m(self.plane_per_m) - distance_m(self.expected_per_m)
        return (
            f"the empty corner shows the wall {length(abs(away_m))} "
            f"{'farther' if away_m > 0 else 'nearer'} than expected, uncertain by "
            f"{length(self.distance_std_m)}, and turned by {tilt_deg:.1f} degrees, uncertain by "
            f"{self.tilt_std_deg:.1f}"
        )


def find_wall(
    corners: Sequence[Phasors],
    wall: NumpyWall,
    offset_std_rad: ArrayLike = OFFSET_STD_RAD,
    *,
    needs_distance: bool = False,
) -> CapturedPlane:
    """The wall that captures (H, W, F) of the empty corner show, the mean of their planes.

    Parameters
    ----------
    corners : at least one capture, complex; pixels that are 0 are not used.
    wall : the expected one, with its computed return.
    offset_std_rad : of the camera's phase offsets, as in `itof.wall.wall_fit.fit_wall`.
    needs_distance : as in `CapturedPlane`.

    Returns
    -------
    The wall. Its uncertainty has the scatter of the planes, too, so that of a camera that was moved is not
    certain.
    """
    expected = np.asarray(wall.plane_per_m)
    fits = [locate_wall(corner, wall, offset_std_rad=offset_std_rad) for corner in corners]
    shown = [fit for fit in fits if fit is not None and found(fit)]
    if len(shown) < len(fits):
        return CapturedPlane(expected, expected, np.inf, np.inf, needs_distance)
    planes = np.array([fit.plane_per_m for fit in shown])
    plane = planes.mean(axis=0)
    away = planes - plane
    # Not over their number: smooth errors are those of the camera in every corner.
    covariance = np.mean([fit.plane_covariance for fit in shown], axis=0) + away.T @ away / len(away)
    return CapturedPlane(plane, expected, *plane_std(plane, covariance), needs_distance)


def captured_wall(corner: Phasors, wall: NumpyWall) -> NumpyWall:
    """The wall with the return of a capture (H, W, F) of the empty corner, where this capture shows it.

    Where its angle is uncertain, it is the expected wall. The weights of pixels in fits, which decide what of
    the hidden light is lost, are those of a diffuse wall there.

    Parameters
    ----------
    wall : the expected one, with its computed return.

    Returns
    -------
    The wall, with `corner` as its return, 0 where it holds only noise, the plane of the capture, and weights
    in any unit.
    """
    expected = np.abs(wall.direct[..., 0])
    light = np.abs(corner[..., 0]) / np.where(expected > 0, expected, np.inf)  # (H, W)
    corner = np.where(is_dark(light)[..., None], 0, corner)
    seen = find_wall([corner], wall)
    return captured_at(corner, wall, seen.plane_per_m) if seen.is_certain else wall.captured(corner)


def captured_at(corner: Phasors, wall: NumpyWall, plane_per_m: Floats) -> NumpyWall:
    """The expected wall in another plane (3,), with the return of a capture (H, W, F) of the empty corner."""
    pixels, captured = WallRays.of(wall), wall.captured(corner)
    depth_m, meets = pixels.depth_m(plane_per_m)
    share = (strength_elsewhere(pixels.expected_depth_m, depth_m) * meets).reshape(wall.meets.shape)
    return replace(captured, plane_per_m=plane_per_m, strength=captured.fit_strength * share)
