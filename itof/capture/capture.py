"""A capture: frames, read, demodulated, undistorted, binned and averaged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from itof.arrays import S
from itof.capture.averaging import average
from itof.capture.binning import Binning
from itof.capture.demodulating import frame_phasors, sensor_pixels
from itof.capture.facts import LARGEST_RAD, CaptureFacts
from itof.capture.lens import Undistortion
from itof.capture.raw_frames import RawFrames, read_frames
from itof.capture.sidecar import CaptureError, Sidecar
from processes.progress import showing_progress


@dataclass(frozen=True)
class ImageShape:
    """The image that a capture becomes.

    Attributes
    ----------
    bin_side : sensor pixels along a side of a pixel of the image; or
    size : width and height of the image, pixels. By default the pixels are those of the sensor.
    horizontal_fov_deg : field of view to cut out at a `size`, degrees; by default as much as there is.
    """

    bin_side: int | None = None
    size: tuple[int, int] | None = None
    horizontal_fov_deg: float | None = None


@dataclass(frozen=True)
class Capture:
    """The mean of the frames of a capture.

    Attributes
    ----------
    phasor : (H, W, F) complex; the phase grows with distance. 0 where a pixel has no good sensor pixel.
    frequencies_hz : F frequencies, Hz.
    saturated_part : (H, W) part of the sensor pixels of a pixel that are saturated.
    facts : the numbers of the capture.
    """

    phasor: NDArray[np.complex128]
    frequencies_hz: tuple[float, ...]
    saturated_part: NDArray[np.float64]
    facts: CaptureFacts


def read_capture(
    files: Sequence[Path],
    sidecar: Sidecar,
    folder: Path,
    shape: ImageShape = ImageShape(),
    *,
    progress: bool = False,
) -> Capture:
    """Read the frames of a capture (`itof.capture.raw_frames.read_frames`) and average them.

    Raises
    ------
    CaptureError : a file or the sidecar is wrong, or no pixel can be used.
    """
    return capture_of(read_frames(files, sidecar, folder), sidecar, shape, progress=progress)


def capture_of(
    raw: RawFrames, sidecar: Sidecar, shape: ImageShape = ImageShape(), *, progress: bool = False
) -> Capture:
    """Average frames.

    Each frame is demodulated, then resampled to a pinhole camera if the sidecar has a lens or a window, then
    binned. All of this is linear in the phasors. Then the frames are averaged.

    Raises
    ------
    CaptureError : the sidecar does not fit the frames, or no pixel can be used.
    """
    pixels = sensor_pixels(raw, sidecar)
    height, width = pixels.good.shape
    straight = Undistortion.of_window(sidecar.lens, raw.sensor, sidecar.horizontal_fov_deg, sidecar.window)
    fov_deg = sidecar.horizontal_fov_deg if straight is None else straight.fov_deg
    binning = Binning.of(
        (width, height),
        fov_deg,
        bin_side=shape.bin_side,
        size=shape.size,
        wanted_fov_deg=shape.horizontal_fov_deg,
    )
    bins = binning.of_pixels(pixels.good if straight is None else straight.good(pixels.good))

    def frames() -> Iterator[NDArray[np.complex128]]:
        for z in frame_phasors(raw, sidecar):
            pinhole = z if straight is None else straight.resampled(z)
            yield _turned(bins.mean(pinhole), sidecar)
            bar.update()

    passes = 2 * len(raw.exposures_s)  # the mean, then what differs from it
    with showing_progress(passes, "frame", "average", show=progress) as bar:
        mean = average(frames, raw.exposures_s, sidecar.frequencies_hz, raw.source)
    lit = (mean.phasor != 0).all(axis=-1)
    if not lit.any():
        raise CaptureError(
            f"{raw.source}: no pixel of the image holds light: is the lens of the sidecar right?"
        )
    full = binning.part(pixels.saturated)
    facts = CaptureFacts(
        frames=len(raw.exposures_s),
        sensor_size=(width, height),
        image_size=(binning.width, binning.height),
        horizontal_fov_deg=binning.fov_deg(fov_deg),
        noise_rad=_typical_noise(mean.noise_rad, lit, len(raw.exposures_s)),
        drift_rad=tuple(np.ptp(mean.drift_rad, axis=0).tolist()),
        saturated=float(pixels.saturated.mean()),
        dead=float(pixels.dead.mean()),
        empty_pixels=float((~lit).mean()),
    )
    z = np.where(lit[..., None], mean.phasor, 0.0)
    return Capture(z, sidecar.frequencies_hz, _turned(full, sidecar), facts)


def _turned(image: NDArray[S], sidecar: Sidecar) -> NDArray[S]:
    """The image (H, W, F) with rows from the top and columns from the left."""
    image = image[::-1] if sidecar.rows_from_bottom else image
    return image[:, ::-1] if sidecar.columns_from_right else image


def _typical_noise(
    noise_rad: NDArray[np.float64] | None, lit: NDArray[np.bool_], frames: int
) -> tuple[float, ...] | None:
    """(F,) noise of the middle pixel, radians; None for one frame.

    The variance of a pixel, estimated from N frames, is the true one times chi-squared of N - 1 degrees of
    freedom over N - 1. The median of this is below 1: 0.45 for two frames.
    """
    if noise_rad is None:
        return None
    freedom = frames - 1
    variance = np.median(noise_rad[lit] ** 2, axis=0) * freedom / chdtri(freedom, 0.5)
    return tuple(np.minimum(np.sqrt(variance), LARGEST_RAD).tolist())
