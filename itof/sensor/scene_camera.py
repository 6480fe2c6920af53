"""A rendered scene as a modelled camera measures it, with or without a capture of the empty corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from itof.arrays import Phasors
from itof.sensor.binned import BinnedCamera
from itof.sensor.camera import Camera
from itof.sensor.noise import phase_noise_rad
from itof.sensor.settings import SensorSettings


@dataclass(frozen=True)
class MeasuredScene:
    """What a camera makes of a scene.

    Attributes
    ----------
    phasor : (H, W, F) complex.
    corner : (H, W, F) complex capture of the empty corner; None without one.
    electrons : median over the pixels, of the emitter's light in both taps of a sensor pixel in a raw frame.
    saturated : part of the sensor pixels and raw frames that are saturated.
    snr : hidden light over its noise, `hidden_snr`.
    """

    phasor: Phasors
    corner: Phasors | None
    electrons: float
    saturated: float
    snr: tuple[float, float]


@dataclass(frozen=True)
class SceneCamera:
    """A camera of `settings` in front of scenes of W x H pixels at F frequencies, Hz.

    A single measurement is counted electron by electron (`itof.sensor.camera`). The mean of several is drawn
    as such (`itof.sensor.binned`).

    Attributes
    ----------
    corner_frames : averaged measurements of the empty corner, by the same camera; 0 for no capture.
    """

    settings: SensorSettings
    frequencies_hz: Sequence[float]
    width: int
    height: int
    corner_frames: int = 0

    def measure(
        self, phasor: Phasors, direct: Phasors, hidden: Phasors, rng: np.random.Generator
    ) -> MeasuredScene:
        """Measure a scene whose phasors (H, W, F) are `direct` + `hidden`."""
        once = Camera(replace(self.settings, frames=1), self.frequencies_hz).capture(phasor, rng)
        seen: Phasors = np.asarray(once.phasor)
        if self.settings.frames > 1:
            drift = self.settings.phase_drift_rad * rng.standard_normal(len(self.frequencies_hz))
            seen = self._mean_of(self.settings.frames, phasor * np.exp(1j * drift), rng)
        corner = self._mean_of(self.corner_frames, direct, rng) if self.corner_frames else None
        return MeasuredScene(
            seen,
            corner,
            float(np.median(np.asarray(once.signal_e))),
            float(np.mean(np.asarray(once.saturated))),
            hidden_snr(self._binned, phasor, hidden),
        )

    def phase_noise_rad(self, electrons: float) -> float:
        """Noise of the phase of an image pixel at the last frequency, by the closed form, radians."""
        averaged = self.settings.binning(self.width, self.height) ** 2 * self.settings.frames
        return phase_noise_rad(self.settings, electrons, self.frequencies_hz[-1]) / float(np.sqrt(averaged))

    @property
    def light_s(self) -> float:
        """Integration time of all raw frames together, seconds."""
        settings = self.settings
        return settings.integration_s * settings.phase_steps * len(self.frequencies_hz) * settings.frames

    @cached_property
    def _binned(self) -> BinnedCamera:
        return BinnedCamera(self.settings, self.frequencies_hz, self.width, self.height)

    def _mean_of(self, frames: int, phasor: Phasors, rng: np.random.Generator) -> Phasors:
        """Mean of some measurements without drift, by mean and variance."""
        camera = replace(self._binned, settings=replace(self.settings, frames=frames))
        re, im = rng.standard_normal((2, *phasor.shape))
        drawn: Phasors = camera.mean(phasor) + camera.spread(phasor) * (re + 1j * im)
        return drawn


def hidden_snr(camera: BinnedCamera, phasor: Phasors, hidden: Phasors) -> tuple[float, float]:
    """Hidden light over noise: root mean square of a component of a pixel, and of the image as a whole.

    With noise of deviation σ in each component, independent from pixel to pixel, no unbiased estimate of the
    strength of hidden light h whose shape is known is better than sqrt(sum |h|² / σ²) (Cramer-Rao). The
    first number is what one component of a pixel has of that on average. Infinite without noise.
    """
    spread = np.asarray(camera.spread(phasor))
    if not (spread > 0).any():
        return float("inf"), float("inf")
    seen = camera.passed(hidden)
    over_noise = np.divide(np.abs(seen), spread, out=np.zeros(seen.shape), where=spread > 0)
    whole = float(np.sqrt((over_noise**2).sum()))
    return whole / float(np.sqrt(2 * over_noise.size)), whole
