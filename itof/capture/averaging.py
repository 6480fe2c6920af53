"""The mean of many frames, its noise, and what changes from frame to frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from disk.frequency_text import megahertz
from itof.capture.sidecar import CaptureError

MIXED: Final = 1.1  # brightness of a frame over that of another; emitters drift by a few per cent
NO_LIGHT: Final = "holds no light: a dark frame? take it out of the frames"
_DARK = 0.01  # brightness of a frame over that of the brightest; exposures within a capture differ less

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Averaged:
    """The mean of N frames.

    Attributes
    ----------
    phasor : (H, W, F) mean of the phasors, weighted by exposure.
    noise_rad : (H, W, F) standard deviation of the phase of this mean, radians; 0 where there is no light.
        None for one frame, which does not tell it.
    drift_rad : (N, F) phase of each frame over that of the mean, common to all pixels, radians.
    brightness : (N, F) of each frame over that of the mean; 1 at a frequency without light.
    """

    phasor: Complexes
    noise_rad: Floats | None
    drift_rad: Floats
    brightness: Floats


def average(
    frames: Callable[[], Iterable[Complexes]],
    exposures_s: Floats,
    frequencies_hz: Sequence[float],
    source: str,
) -> Averaged:
    """The mean of frames, read twice.

    Frame n with the exposure t_n gives z_n per second, with the variance σ² / t_n of shot noise; the mean
    sum t_n z_n / sum t_n has the least variance, σ² / sum t_n. Of the deviations p_n across the mean's
    direction, after the drift of all pixels together was taken out, sum t_n p_n² / (N - 1) estimates the
    variance without bias.

    Parameters
    ----------
    frames : gives the (H, W, F) phasors of each frame, the same at each call.
    exposures_s : (N, F) exposure times; only the ratios at one frequency matter.
    frequencies_hz : F modulation frequencies, Hz, for the message, as `source`, the files.

    Raises
    ------
    CaptureError : frames are of different brightness at a frequency.
    """
    weights = exposures_s / exposures_s.sum(axis=0)  # (N, F)
    each = iter(frames())
    mean = weights[0] * next(each)
    for weight, z in zip(weights[1:], each, strict=True):
        mean += weight * z
    power = np.einsum("hwf,hwf->f", mean, mean.conj()).real  # (F,)
    size = np.abs(mean)
    direction = np.divide(mean, size, out=np.zeros_like(mean), where=size > 0)
    drift, brightness, across = [], [], np.zeros(mean.shape)
    for weight, z in zip(weights, frames(), strict=True):
        gain = np.einsum("hwf,hwf->f", z, mean.conj()) / np.where(power > 0, power, 1.0)
        drift.append(np.angle(gain))
        brightness.append(np.where(power > 0, np.abs(gain), 1.0))
        across += weight * (z * np.exp(-1j * drift[-1]) * direction.conj()).imag ** 2
    for place, frequency_hz in enumerate(frequencies_hz):
        _refuse_mixed(np.array(brightness)[:, place], f"{source}: at {megahertz(frequency_hz)}")
    noise = None
    if len(weights) > 1:
        variance = across / (len(weights) - 1)
        noise = np.divide(np.sqrt(variance), size, out=np.zeros_like(size), where=size > 0)
    return Averaged(mean, noise, np.array(drift), np.array(brightness))


def _refuse_mixed(brightness: Floats, where: str) -> None:
    """Refuse frames whose brightness (N,) at a frequency differs too much."""
    low, high = int(brightness.argmin()), int(brightness.argmax())
    if brightness[low] < _DARK * brightness[high]:
        raise CaptureError(f"{where}, frame {low} {NO_LIGHT}")
    if brightness[high] > MIXED * brightness[low]:
        raise CaptureError(
            f"{where}, frame {high} is {brightness[high] / brightness[low]:.3g} times as "
            f"bright as frame {low}: frames of mixed exposure, or something moved; give the exposure times "
            "by exposures_s, or import the frames of one exposure"
        )
