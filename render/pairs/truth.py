"""The hidden object's depth map from a capture of a mirror on the relay wall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from disk import NightError
from itof import DepthMap, unwrap_depth
from itof.wall.expected_wall import ExpectedWall

_BEHIND_M: Final = 0.05  # behind the wall's plane: nearer light is the wall's own
_SINGLE_RAD: Final = 0.3  # rms phase that one return may leave: more is two surfaces in a pixel, or noise
_FEWEST_PIXELS: Final = 6  # of a piece of the object
_OTHER_RAD: Final = 0.3  # scatter of the phases about those of the expected wall that is another wall's

Phasors = NDArray[np.complexfloating[Any, Any]]


class MirrorError(NightError):
    """A mirror's capture shows no object, or does not fit its measurement."""


@dataclass(frozen=True)
class Region:
    """Sphere in which the hidden object is, in camera axes, metres."""

    centre_m: NDArray[np.float64]
    radius_m: float

    def mirrored(self, plane_per_m: NDArray[np.float64]) -> Region:
        """The region as the mirror in the plane m (m · p = 1) shows it."""
        gap = (self.centre_m @ plane_per_m - 1) / (plane_per_m @ plane_per_m)
        return Region(self.centre_m - 2 * gap * plane_per_m, self.radius_m)


@dataclass(frozen=True)
class MirrorTruth:
    """What the mirror shows.

    Attributes
    ----------
    depth_map : (H, W) of the object's mirror image.
    offsets_rad : (F,) phase offsets of the camera, which were taken out.
    object_points_m : (n, 3) points of the object itself, mirrored back, camera axes.
    """

    depth_map: DepthMap
    offsets_rad: NDArray[np.float64]
    object_points_m: NDArray[np.float64]


def truth_of_mirror(
    mirror: Phasors, corner: Phasors, wall: ExpectedWall, region: Region, frequencies_hz: Sequence[float]
) -> MirrorTruth:
    """Depth map of the object from a capture of the mirror.

    The wall is taken to be where `wall` says: the mean phase of `corner` over its return is the offset of
    the camera at each frequency. Depth is unwrapped from the phases at all frequencies, up to the far end of
    the region: farther depths would explain noisy phases as well if the frequencies have no large common
    divisor. A pixel shows the object if one return explains its phases, behind the wall's plane and within
    the mirror image of `region`; pieces of a few pixels are dropped. With two frequencies, a return from
    behind the region may look like one within it. An error of the wall's distance, or of 10 mrad at 60 MHz,
    which is 4 mm, is one of the depth.

    Parameters
    ----------
    mirror : (H, W, F) complex.
    corner : (H, W, F) complex, of the same camera at the same place: the empty corner, or the measurement
        itself, whose hidden light is 1 to 3 mrad.
    wall : where the relay wall is; `itof.wall.empty_corner` finds it.
    region : where the object can be.
    frequencies_hz : F modulation frequencies, Hz.

    Raises
    ------
    MirrorError : the images differ in size, `corner` does not show the wall where it should be, or no pixel
        of the mirror shows an object.

    Source: Caligiuri et al. 2024, sec. 8, propose a mirror for real ground truth; the steps are ours.
    """
    if mirror.shape != corner.shape:
        raise MirrorError(
            f"mirror and measurement must be of one camera: their phasors have the shapes {mirror.shape} and "
            f"{corner.shape}"
        )
    plane, wall_m = np.asarray(wall.plane_per_m), np.asarray(wall.radial_depth_m)
    offsets = wall_offsets_rad(corner, wall)
    phases = np.angle(mirror) - offsets
    seen = region.mirrored(plane)
    farthest_m = float(np.linalg.norm(seen.centre_m)) + seen.radius_m
    depth_m = unwrap_depth(phases, frequencies_hz, farthest_m)
    left = phases - wall.slope * depth_m[..., None]
    left = left - 2 * np.pi * np.round(left / (2 * np.pi))
    points_m = depth_m[..., None] * wall.rays
    mask = (mirror != 0).all(axis=-1) & (np.sqrt((left**2).mean(axis=-1)) < _SINGLE_RAD)
    mask &= depth_m > wall_m + _BEHIND_M
    mask &= np.linalg.norm(points_m - seen.centre_m, axis=-1) < seen.radius_m
    mask = _pieces(mask)
    if not mask.any():
        raise MirrorError(
            "the mirror shows no object: no return lies behind the wall where the preset has hidden objects"
        )
    back = (points_m[mask] @ plane - 1) / (plane @ plane)
    return MirrorTruth(
        DepthMap.of_object(np.where(mask, depth_m, 0.0), mask, frequencies_hz[0]),
        offsets,
        points_m[mask] - 2 * back[:, None] * plane,
    )


def wall_offsets_rad(corner: Phasors, wall: ExpectedWall) -> NDArray[np.float64]:
    """(F,) mean phases of a corner (H, W, F) over the wall's return.

    Raises
    ------
    MirrorError : the corner is dark, or shows another wall.
    """
    direct = np.asarray(wall.direct)
    if not corner.any():
        raise MirrorError("the measurement holds no light: capture it again")
    over_direct = corner * np.conj(direct) / np.maximum(np.abs(direct), 1e-300)  # (H, W, F)
    offsets = np.angle(over_direct.sum(axis=(0, 1)))
    left = np.angle(over_direct * np.exp(-1j * offsets))
    scatter_rad = np.sqrt(
        (left**2 * np.abs(over_direct)).sum(axis=(0, 1)) / np.abs(over_direct).sum(axis=(0, 1))
    )
    if not scatter_rad.max() <= _OTHER_RAD:
        raise MirrorError(
            f"the phases of the wall scatter by {scatter_rad.max():.2f} rad about those of the preset's: "
            "correct camera and wall in the preset, or check the capture"
        )
    return np.asarray(offsets)


def _pieces(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The connected pieces of a mask that have enough pixels."""
    labels, count = ndimage.label(mask)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    kept: NDArray[np.bool_] = (sizes >= _FEWEST_PIXELS)[labels]
    return kept
