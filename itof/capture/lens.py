"""From the image of a lens with distortion, or a part of it, to that of a pinhole camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from disk.quantities import MIN_FOV_DEG
from itof import pixel_rays
from itof.capture.sidecar import CaptureError, Lens
from itof.radial_distortion import radial_factor, turning_square, undistorted_radius

_WHOLE = 1 - 1e-9  # weight of good pixels that a value needs
_STEPS = 30  # of Newton's method, which doubles the digits in each
_SURE = 1e-9  # tangent of an angle that it leaves
_WIDEST_DEG = 150.0  # field of view of a window
_HALVINGS = 30  # of the interval in which the field of view of a window is searched

Floats = NDArray[np.float64]


def seen_at(lens: Lens, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Column and row of the pixel that sees the rays (x, y) at z = 1; `Lens` has the equation.

    NaN where no pixel sees them, because the distortion folds back before.
    """
    shown = _moved(lens, x, y) if lens.maps_to == "pixel" else _moved_from(lens, x, y)
    return lens.cx + lens.fx * shown[0], lens.cy + lens.fy * shown[1]


def ray_of(lens: Lens, column: float, row: float) -> tuple[float, float]:
    """The ray (x, y) at z = 1 that a pixel sees; NaN if there is none."""
    x, y = np.array((column - lens.cx) / lens.fx), np.array((row - lens.cy) / lens.fy)
    found = _moved_from(lens, x, y) if lens.maps_to == "pixel" else _moved(lens, x, y)
    return float(found[0]), float(found[1])


def _moved(lens: Lens, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Where the equation of `Lens` moves places (x, y); NaN where it folds back."""
    square = np.asarray(x**2 + y**2)
    radial = np.where(
        square < turning_point(lens), radial_factor(square, (lens.k1, lens.k2, lens.k3)), np.nan
    )
    across = x * radial + 2 * lens.p1 * x * y + lens.p2 * (square + 2 * x**2)
    down = y * radial + lens.p1 * (square + 2 * y**2) + 2 * lens.p2 * x * y
    return across, down


def _moved_from(lens: Lens, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """The places that the equation of `Lens` moves to (x, y), by Newton's method from the radial solution."""
    radius = np.hypot(x, y)
    part = undistorted_radius(radius, (lens.k1, lens.k2, lens.k3)) / np.where(radius > 0, radius, 1.0)
    u, v = x * part, y * part
    for _ in range(_STEPS):
        square = u**2 + v**2
        radial = radial_factor(square, (lens.k1, lens.k2, lens.k3))
        slope = lens.k1 + square * (2 * lens.k2 + 3 * lens.k3 * square)  # of the radial factor, by the square
        off_x = u * radial + 2 * lens.p1 * u * v + lens.p2 * (square + 2 * u**2) - x
        off_y = v * radial + lens.p1 * (square + 2 * v**2) + 2 * lens.p2 * u * v - y
        xx = radial + 2 * u**2 * slope + 2 * lens.p1 * v + 6 * lens.p2 * u
        xy = 2 * u * v * slope + 2 * lens.p1 * u + 2 * lens.p2 * v
        yy = radial + 2 * v**2 * slope + 6 * lens.p1 * v + 2 * lens.p2 * u
        whole = xx * yy - xy**2
        whole = np.where(whole > 0, whole, np.nan)  # beyond a fold
        u, v = u - (yy * off_x - xy * off_y) / whole, v - (xx * off_y - xy * off_x) / whole
    across, down = _moved(lens, u, v)
    sure = np.hypot(across - x, down - y) <= _SURE  # False for NaN
    return np.where(sure, u, np.nan), np.where(sure, v, np.nan)


def turning_point(lens: Lens) -> float:
    """Smallest r² at z = 1 where the distorted radius r (1 + k1 r² + k2 r⁴ + k3 r⁶) stops growing with r.

    It is infinite if the radius always grows. Rays beyond it are folded back: calibrations do not hold there.
    """
    return turning_square((lens.k1, lens.k2, lens.k3))


@dataclass(frozen=True)
class Undistortion:
    """Takes images of a lens to the pinhole camera of the same size with a field of view.

    Values are linear between pixels. Phasors are interpolated, not phases.

    Attributes
    ----------
    places, weights : flat indices and weights (H, W) of the four pixels around the place that sees the ray of
        each pixel; the weight outside of the image, and of rays that the distortion folds back, is 0.
    fov_deg : horizontal field of view of the pinhole camera, degrees.
    """

    places: tuple[NDArray[np.intp], ...]
    weights: tuple[Floats, ...]
    fov_deg: float

    @classmethod
    def of(
        cls,
        lens: Lens,
        width: int,
        height: int,
        horizontal_fov_deg: float,
        turn: Floats | None = None,
    ) -> Undistortion:
        """For a lens and a field of view of the pinhole camera, degrees.

        Parameters
        ----------
        turn : (3, 3) rotation from the axes of the pinhole camera to those of the lens; by default none.
        """
        column, row = _seen(lens, pixel_rays(width, height, horizontal_fov_deg), turn)
        folded = ~np.isfinite(column + row)
        column, row = np.where(folded, 0, column), np.where(folded, 0, row)
        left, top = np.floor(column), np.floor(row)
        places, weights = [], []
        for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):
            at_column, at_row = left + right, top + below
            weight = (1 - np.abs(column - at_column)) * (1 - np.abs(row - at_row))
            outside = (at_column < 0) | (at_column >= width) | (at_row < 0) | (at_row >= height)
            at_column, at_row = np.clip(at_column, 0, width - 1), np.clip(at_row, 0, height - 1)
            places.append((at_row * width + at_column).astype(np.intp))
            weights.append(np.where(outside | folded, 0.0, weight))
        return cls(tuple(places), tuple(weights), horizontal_fov_deg)

    @classmethod
    def of_window(
        cls,
        lens: Lens | None,
        sensor: tuple[int, int],
        horizontal_fov_deg: float,
        window: tuple[int, int, int, int] | None,
    ) -> Undistortion | None:
        """For a window (left, top, width, height) of a sensor (width, height), or all of it.

        None for all of a pinhole camera's image, which stays as it is.

        Light from a direction does not depend on where the camera looks: a window beside the middle is the
        image of a camera at the same place that is turned to the middle of the window, first to the side and
        then up or down, so that level rows stay level. Its field of view is as large as the window allows.

        Raises
        ------
        CaptureError : the lens sees nothing in the middle of the window, or the window is too small.
        """
        if window is None:
            return None if lens is None else cls.of(lens, *sensor, horizontal_fov_deg)
        left, top, width, height = window
        if lens is None:
            focal = sensor[0] / 2 / np.tan(np.radians(horizontal_fov_deg) / 2)
            lens = Lens(fx=focal, fy=focal, cx=(sensor[0] - 1) / 2, cy=(sensor[1] - 1) / 2)
        lens = replace(lens, cx=lens.cx - left, cy=lens.cy - top)
        x, y = ray_of(lens, (width - 1) / 2, (height - 1) / 2)
        if not np.isfinite(x + y):
            raise CaptureError("the lens sees nothing in the middle of the window: correct lens or window")
        turn = _turned_to(x, y)

        def fits(fov_deg: float) -> bool:
            rays = pixel_rays(width, height, fov_deg)
            edges = np.concatenate([rays[0], rays[-1], rays[:, 0], rays[:, -1]])
            column, row = _seen(lens, edges, turn)
            return bool(((column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)).all())

        low, high = MIN_FOV_DEG, _WIDEST_DEG
        if not fits(low):
            raise CaptureError(f"a window of {width}x{height} pixels is too small for an image: enlarge it")
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if fits(middle) else (low, middle)
        return cls.of(lens, width, height, low, turn)

    def good(self, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(H, W) pixels that are made of good ones in the image alone."""
        known = good.reshape(-1).astype(np.float64)
        sure = sum(weight * known[place] for place, weight in self._corners())
        return np.asarray(sure >= _WHOLE)

    def resampled(self, image: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Phasors (H, W, F) of the pinhole camera."""
        flat = image.reshape(-1, image.shape[-1])
        return np.asarray(sum(weight[..., None] * flat[place] for place, weight in self._corners()))

    def _corners(self) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        return zip(self.places, self.weights, strict=True)


def _seen(lens: Lens, rays: Floats, turn: Floats | None) -> tuple[Floats, Floats]:
    """Column and row of the pixels that see rays (..., 3) of a camera that is turned; NaN if none does."""
    rays = rays if turn is None else rays @ turn.T
    front = np.where(rays[..., 2] > 0, rays[..., 2], np.nan)
    return seen_at(lens, rays[..., 0] / front, rays[..., 1] / front)


def _turned_to(x: float, y: float) -> Floats:
    """(3, 3) rotation that takes the optical axis to the ray (x, y) at z = 1: a pan and then a tilt."""
    pan, tilt = np.arctan(x), np.arctan2(-y, np.hypot(x, 1))
    cos, sin = np.cos(pan), np.sin(pan)
    about_y = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    cos, sin = np.cos(tilt), np.sin(tilt)
    return np.asarray(about_y @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]))
