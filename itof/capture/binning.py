"""From the pixels of a sensor to those of an image: means of phasors over areas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from disk.quantities import MIN_FOV_DEG, fov_problem
from itof.capture.sidecar import CaptureError

LONGEST_SIDE: Final = 2**14  # of a sensor, pixels; those of iToF cameras have up to 2**11
_LEAST_PART = 1e-9  # of a sensor pixel
_PLANE = ((0, 0), (1, 0), (0, 1))  # powers of row and column
_ROUNDING = 1e-9  # of a bin's side
_BOLDEST = 3.0  # variance that a plane's value may have, over that of the mean


@dataclass(frozen=True)
class Binning:
    """A window around the middle of a sensor, divided into square bins.

    Attributes
    ----------
    sensor_width, sensor_height : of the sensor, pixels.
    width, height : of the image, pixels.
    side : sensor pixels along a side of a bin; need not be a whole number.
    """

    sensor_width: int
    sensor_height: int
    width: int
    height: int
    side: float

    @classmethod
    def of(
        cls,
        sensor: tuple[int, int],
        fov_deg: float,
        *,
        bin_side: int | None = None,
        size: tuple[int, int] | None = None,
        wanted_fov_deg: float | None = None,
    ) -> Binning:
        """The bins of a sensor (width, height) whose image has a field of view, degrees.

        Parameters
        ----------
        bin_side : sensor pixels along a side of a bin.
        size : (width, height) of the image instead; the largest window of this shape is taken.
        wanted_fov_deg : horizontal field of view of the window, degrees, at a `size`; by default as large as
            possible.

        Raises
        ------
        CaptureError : the image would be larger than the sensor, see more than it, or less than a degree, or
            the sensor is too large.
        """
        width, height = sensor
        if max(sensor) > LONGEST_SIDE:
            raise CaptureError(
                f"the frames have {width}x{height} pixels, and {LONGEST_SIDE} is the most on a side: correct "
                "axes"
            )
        if bin_side is not None and size is not None:
            raise CaptureError("give a bin's side or an image size, not both")
        if bin_side is not None and wanted_fov_deg is not None:
            raise CaptureError(
                "a field of view is cut out at an image size, not at a bin's side: give --size with --fov"
            )
        if bin_side is not None and bin_side < 1:
            raise CaptureError(f"a bin has a side of at least one pixel, not {bin_side}")
        problem = None if wanted_fov_deg is None else fov_problem(wanted_fov_deg)
        if problem:
            raise CaptureError(problem)
        if size is None:
            whole = bin_side or 1
            size = (width // whole, height // whole)
            found = cls(width, height, *size, float(whole))
        else:
            found = cls(width, height, *size, min(width / max(size[0], 1), height / max(size[1], 1)))
        if min(size) < 1 or found.side < 1:
            raise CaptureError(
                f"images of {size[0]}x{size[1]} pixels cannot be binned from a sensor of {width}x{height}: "
                "choose a smaller image"
            )
        if wanted_fov_deg is not None:
            found = found._cut(fov_deg, wanted_fov_deg)
        if found.fov_deg(fov_deg) < MIN_FOV_DEG:
            raise CaptureError(
                f"images of {size[0]}x{size[1]} pixels would be {found.fov_deg(fov_deg):.2g} degrees wide, "
                f"and {MIN_FOV_DEG:g} degree is the least: choose a wider image"
            )
        return found

    def _cut(self, fov_deg: float, wanted_fov_deg: float) -> Binning:
        """The same image with a smaller field of view, degrees."""
        size, sensor = (self.width, self.height), (self.sensor_width, self.sensor_height)
        half, wanted = (np.tan(np.radians(angle) / 2) for angle in (fov_deg, wanted_fov_deg))
        side = float(wanted / half) * sensor[0] / size[0]
        what = f"a field of view of {wanted_fov_deg:g} degrees at {size[0]}x{size[1]} pixels"
        if side > self.side * (1 + _ROUNDING):
            raise CaptureError(
                f"{what} does not fit the sensor of {sensor[0]}x{sensor[1]} pixels and {fov_deg:g} degrees: "
                f"it allows at most {self.fov_deg(fov_deg):.4g} degrees"
            )
        if side < 1 - _ROUNDING:
            raise CaptureError(
                f"{what} needs more pixels than the sensor has: give --size with a smaller image"
            )
        return Binning(*sensor, *size, side)

    def fov_deg(self, sensor_fov_deg: float) -> float:
        """Horizontal field of view of the image, degrees, by that of the sensor."""
        part = self.side * self.width / self.sensor_width
        if part == 1:
            return sensor_fov_deg
        seen_deg = 2 * np.degrees(np.arctan(part * np.tan(np.radians(sensor_fov_deg) / 2)))
        return min(round(float(seen_deg), 9), sensor_fov_deg)  # rounding errors would leave allowed ranges

    def part(self, pixels: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(H, W) part of each bin that some of the sensor pixels (sensor height, sensor width) make up."""
        if (self.height, self.width) == pixels.shape:
            return pixels.astype(np.float64)
        rows = _moments(self.sensor_height, self.height, self.side)[0]
        columns = _moments(self.sensor_width, self.width, self.side)[0]
        return np.asarray(rows @ pixels.astype(np.float64) @ columns.T)

    def of_pixels(self, good: NDArray[np.bool_]) -> Bins:
        """The bins of a sensor whose good pixels (sensor height, sensor width) are known."""
        if (self.height, self.width) == good.shape:
            return Bins(good, [], [], np.ones((*good.shape, 1)))
        known = good.astype(np.float64)
        rows = _moments(self.sensor_height, self.height, self.side)
        columns = _moments(self.sensor_width, self.width, self.side)
        weight = {
            (a, b): rows[a] @ known @ columns[b].T for a in range(3) for b in range(3) if a + b < 3
        }  # (H, W) moments of the good pixels
        return Bins(good, rows[:2], columns[:2], _middle(weight))


@dataclass(frozen=True)
class Bins:
    """Bins and the good sensor pixels in them.

    Where pixels are missing on one side of a bin, or a bin's edge cuts through pixels, their mean is that of
    another place: with 5 mrad from pixel to pixel, half a bin of 8 pixels is 10 mrad off. Therefore a plane
    is fitted to the phasors of a bin by least squares, and its value in the middle is taken. For a bin
    without missing and cut pixels this is the mean.

    Attributes
    ----------
    good : (sensor height, sensor width).
    rows, columns : shares of the sensor's rows and columns in those of the image, and shares times place.
    shares : (H, W, 3) factors of the sums of z, z · row and z · column.
    """

    good: NDArray[np.bool_]
    rows: list[csr_array]
    columns: list[csr_array]
    shares: NDArray[np.float64]

    def mean(self, image: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """(H, W, F) phasors of the bins; 0 without any good pixel."""
        lit = np.where(self.good[..., None], image, 0.0)
        if not self.rows:  # bins of one pixel
            return lit
        total = np.zeros((*self.shares.shape[:2], image.shape[-1]), dtype=np.complex128)
        for place, (a, b) in enumerate(_PLANE):
            for at in range(image.shape[-1]):
                sums = self.rows[a] @ lit[..., at] @ self.columns[b].T
                total[..., at] += self.shares[..., place] * sums
        return total


def _moments(sensor: int, count: int, side: float) -> list[csr_array]:
    """(count, sensor) shares of the sensor pixels in each bin, times powers 0, 1, 2 of their place in it."""
    edges = (sensor - side * count) / 2 + side * np.arange(count + 1)  # the window is in the middle
    most = int(np.ceil(side)) + 1  # sensor pixels that a bin touches
    pixel = np.floor(edges[:-1, None]).astype(np.intp) + np.arange(most)  # (count, most)
    low, high = np.maximum(edges[:-1, None], pixel), np.minimum(edges[1:, None], pixel + 1)
    share = np.where((pixel >= 0) & (pixel < sensor), np.maximum(high - low, 0.0) / side, 0.0)
    place = (pixel + 0.5 - (edges[:-1, None] + edges[1:, None]) / 2) / side
    bins = np.repeat(np.arange(count), most)
    at = np.clip(pixel, 0, sensor - 1).reshape(-1)
    return [
        csr_array(((share * place**power).reshape(-1), (bins, at)), shape=(count, sensor))
        for power in range(3)
    ]


def _middle(weight: dict[tuple[int, int], NDArray[np.float64]]) -> NDArray[np.float64]:
    """(H, W, 3) factors of the sums of z, z · row and z · column that give a plane's value in the middle.

    Where the good pixels lie so far from the middle that the plane's value would be uncertain, the mean.
    """
    lines = [np.stack([weight[a + c, b + d] for a, b in _PLANE], axis=-1) for c, d in _PLANE]
    normal = np.stack(lines, axis=-1)  # (H, W, 3, 3)
    lit = weight[0, 0] > _LEAST_PART
    size = np.where(lit, weight[0, 0], 1.0)
    shares = np.linalg.pinv(normal, rcond=_ROUNDING, hermitian=True)[..., 0, :]
    bold = shares[..., 0] * size > _BOLDEST  # variance of the plane's value over that of the mean
    plain = np.stack([1 / size, np.zeros_like(size), np.zeros_like(size)], axis=-1)
    return np.where(lit[..., None], np.where(bold[..., None], plain, shares), 0.0)
