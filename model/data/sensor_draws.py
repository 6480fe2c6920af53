"""A camera between scene and network in the training: each image is measured by one of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from itof.sensor.binned import BinnedCamera
from itof.sensor.demodulation import wiggling
from itof.sensor.random_camera import random_camera
from itof.sensor.settings import SensorSettings
from itof.weighted_reference import quotient
from scenegen import Preset

_SAME_DEG = 1e-6
_STREAM = 3  # of a seed's random numbers, apart from those of the other augmentations


@dataclass(frozen=True)
class SensorDraws:
    """Measures each image with another camera of the type of the settings.

    Each image has its own noise and drift of the phases, and its own `itof.sensor.random_camera`: its
    contrast, rise time, duty cycle, scattering, and part of the wiggling that the calibration leaves. The
    rest, such as the falloff of the lens, is that of the settings.

    With the direct return of the wall, the images are divided by what the camera makes of the empty corner,
    as a prediction with a capture of it does. The capture has no noise: it can be averaged for long.

    Attributes
    ----------
    camera : with the settings' imperfections, which are the largest.
    empty : (H, W, F) complex64 direct return of the wall, on the device of the images; None for no capture.
    """

    camera: BinnedCamera
    empty: Tensor | None = None

    def __call__(self, phasor: Tensor, seeds: Sequence[int]) -> Tensor:
        """(N, H, W, F) complex64 phasors as cameras measure them; the N seeds decide everything."""
        settings = self.camera.settings
        drawn = [_Drawn.of(seed, settings, phasor.shape[-1]) for seed in seeds]
        cameras = [each.camera for each in drawn]
        drift = torch.tensor(np.array([each.drift_rad for each in drawn]), dtype=torch.float32)
        drift = drift.to(phasor.device)[:, None, None]
        seen: Tensor = self.camera.mean(phasor * torch.polar(torch.ones_like(drift), drift), cameras)
        noise = torch.stack([each.noise(phasor[0]) for each in drawn])
        seen = seen + torch.as_tensor(self.camera.spread(phasor)) * noise
        if self.empty is None:
            return seen
        corner = self.empty * quotient(torch, phasor[..., :1].abs(), self.empty[..., :1].abs())
        return seen * quotient(torch, corner, self.camera.mean(corner, cameras))


@dataclass(frozen=True)
class _Drawn:
    """The camera of an image, and what its state and noise are."""

    camera: SensorSettings
    drift_rad: NDArray[np.float64]  # (F,)
    noise_seed: int

    @classmethod
    def of(cls, seed: int, settings: SensorSettings, frequencies: int) -> _Drawn:
        """What a seed decides; more frequencies change nothing of the rest."""
        rng = np.random.default_rng(np.random.SeedSequence((seed, _STREAM)))
        noise_seed, camera = int(rng.integers(2**62)), random_camera(settings, rng)
        return cls(camera, settings.phase_drift_rad * rng.standard_normal(frequencies), noise_seed)

    def noise(self, like: Tensor) -> Tensor:
        """Complex Gaussian noise with variance 1 in each component, on the device of `like`."""
        generator = torch.Generator(like.device).manual_seed(self.noise_seed)
        return torch.view_as_complex(torch.randn(*like.shape, 2, generator=generator, device=like.device))


def view_problem(
    settings: SensorSettings,
    preset: Preset,
    source: object,
    width: int,
    height: int,
    frequencies_hz: Sequence[float],
) -> str | None:
    """Why this camera cannot measure images (W x H) of the scenes of a preset at these frequencies, Hz.

    None if it can. `source` names the preset or its dataset in the sentence.
    """
    if preset.camera_spread.horizontal_fov_deg:
        return f"the scenes of {source} have different fields of view, and a camera has one"
    fov_deg = preset.camera.horizontal_fov_deg
    if abs(fov_deg - settings.horizontal_fov_deg) > _SAME_DEG:
        return (
            f"the camera sees {settings.horizontal_fov_deg:g} degrees and the scenes of {source} are "
            f"rendered for {fov_deg:g}: set horizontal_fov_deg of the camera to that"
        )
    try:
        settings.binning(width, height)
        if settings.wiggling_left < 1:
            for frequency_hz in frequencies_hz:
                wiggling(settings, frequency_hz)
    except ValueError as error:
        return f"the camera cannot measure {source}: {error}"
    return None
