"""What a camera makes of an image on average, and how much it scatters: fast enough for a training.

`itof.sensor.camera` counts the electrons of every sensor pixel. Where many of them are binned, or a network
sees a million images, the mean of a binned pixel and the variance of the closed form do as well. Arrays may
be of numpy or of any other library of the array API.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType

import numpy as np
from array_api_compat import array_namespace, device
from numpy.typing import NDArray

from itof.arrays import A, Array, PhasorsOf, PixelsOf
from itof.sensor.demodulation import (
    Harmonics,
    first_harmonic,
    folded,
    harmonics,
    phasor_of_differences,
    tap_differences,
)
from itof.sensor.fixed_pattern import alive_pixels
from itof.sensor.geometry import geometry
from itof.sensor.light import ambient_rate_e_s, falloff, leaked, scattered, signal_rate_e_s
from itof.sensor.noise import difference_variance_e2
from itof.sensor.settings import SensorSettings


@dataclass(frozen=True)
class BinnedCamera:
    """A camera whose sensor pixels are binned to W x H pixels, by mean and variance.

    Left out are what averages over the sensor pixels of a bin or changes no phase: the fixed pattern of gains
    and offsets, a mismatch of the taps, and the correlation of rounding errors in the converter. Full wells
    clip the mean charge, which is exact up to the shot noise of a charge beside the limit.

    Attributes
    ----------
    settings : of the camera.
    frequencies_hz : F modulation frequencies, Hz.
    width, height : of the images.

    Raises
    ------
    ValueError : the size does not fit the sensor.
    """

    settings: SensorSettings
    frequencies_hz: Sequence[float]
    width: int
    height: int

    def __post_init__(self) -> None:
        self.settings.binning(self.width, self.height)

    def mean(self, phasor: PhasorsOf[A], cameras: Sequence[SensorSettings] | None = None) -> PhasorsOf[A]:
        """(..., H, W, F) complex mean of the phasors that the camera gives, without drift of its phases.

        Parameters
        ----------
        phasor : (..., H, W, F) complex phasors of scenes.
        cameras : for phasors (N, H, W, F), the N cameras that measure them, each of which is a
            `itof.sensor.random_camera` of the settings. Their contrast, waves, scattering and
            `wiggling_left` count, the rest is that of the settings; the firmware knows its contrast.
        """
        xp = array_namespace(phasor)
        own = None if cameras is None else _Cameras(xp, phasor, self.settings, cameras)
        light = self._behind_lens(xp, phasor, None if own is None else own.scattering)
        images = [
            self._demodulated(xp, light, place, frequency_hz, own)
            for place, frequency_hz in enumerate(self.frequencies_hz)
        ]
        seen = xp.asarray(self._averaged > 0, dtype=images[0].dtype, device=device(phasor))
        return xp.astype(xp.stack(images, axis=-1) * seen[..., None], phasor.dtype)

    def passed(self, phasor: PhasorsOf[A]) -> PhasorsOf[A]:
        """(..., H, W, F) what the lens lets through of phasors, with their phases."""
        still = replace(self.settings, emitter_offset_m=(0.0, 0.0, 0.0), motion_m_s=0.0)
        camera = replace(self, settings=still)
        return camera._behind_lens(array_namespace(phasor), phasor, None)

    def spread(self, phasor: PhasorsOf[Array]) -> Array:
        """(..., H, W, F) standard deviation of the noise of each component of `mean`.

        That of `itof.sensor.noise.phase_noise_rad` with the electrons of each pixel, over the square root of
        the number of sensor pixels and frames that are averaged. It does not depend on the phase, because the
        taps of a raw frame divide the same electrons.
        """
        xp, settings = array_namespace(phasor), self.settings
        light = self._behind_lens(xp, phasor, None)
        brightness = xp.abs(light[..., 0])
        variance = difference_variance_e2(
            settings, brightness * self._electrons, self._other_e(xp, brightness)
        )
        count = xp.asarray(self._averaged, dtype=brightness.dtype, device=device(phasor))  # (H, W)
        size = xp.sqrt(2 * variance / (settings.phase_steps * xp.clip(count, min=1.0))) / self._electrons
        size = xp.broadcast_to(xp.where(count > 0, size, xp.zeros_like(size)), tuple(phasor.shape[:-1]))
        return xp.stack([size / first_harmonic(settings, f) for f in self.frequencies_hz], axis=-1)

    @property
    def _electrons(self) -> float:
        """Electrons of a raw frame in both taps, per radiance."""
        return signal_rate_e_s(self.settings) * self.settings.integration_s

    @cached_property
    def _averaged(self) -> NDArray[np.float64]:
        """(H, W) sensor pixels of a pixel that are not dead, times the averaged frames."""
        binning = self.settings.binning(self.width, self.height)
        alive = alive_pixels(self.settings).reshape(self.height, binning, self.width, binning)
        return np.asarray(alive.sum(axis=(1, 3), dtype=np.float64) * self.settings.frames)

    def _behind_lens(self, xp: ModuleType, phasor: PhasorsOf[A], scattering: Array | None) -> PhasorsOf[A]:
        """(..., H, W, F) phasors behind the lens."""
        lens = falloff(self.settings, self.width, self.height)
        there = geometry(self.settings, phasor, self.frequencies_hz)
        light = scattered(self.settings, there, scattering)
        light = light * xp.asarray(lens, dtype=xp.real(phasor).dtype, device=device(phasor))[..., None]
        return leaked(self.settings, light)

    def _other_e(self, xp: ModuleType, like: A) -> PixelsOf[A]:
        """(H, W) electrons of ambient light in both taps of a raw frame."""
        lens = falloff(self.settings, self.width, self.height)
        other_e = ambient_rate_e_s(self.settings) * self.settings.integration_s * lens
        return xp.asarray(other_e, dtype=like.dtype, device=device(like))

    def _demodulated(
        self,
        xp: ModuleType,
        light: PhasorsOf[Array],
        place: int,
        frequency_hz: float,
        cameras: _Cameras | None,
    ) -> PixelsOf[Array]:
        """(..., H, W) phasors of one frequency that the firmware makes of the mean charges."""
        settings, z = self.settings, light[..., place]
        parts = harmonics(settings, frequency_hz) if cameras is None else cameras.harmonics(frequency_hz)
        gain = 1.0 if cameras is None else cameras.gain(frequency_hz)
        if len(parts) == 1 and not self._fills(xp, light):
            return z * gain
        seen = folded(settings, z, frequency_hz, parts)
        error = _log_ratio(xp, seen, z)  # of the waveforms
        seen = seen * gain
        if self._fills(xp, light):
            difference = tap_differences(settings, z * gain, frequency_hz, parts)
            seen = phasor_of_differences(
                settings, self._clipped(xp, difference, xp.abs(light[..., 0])), frequency_hz
            )
        left = settings.wiggling_left if cameras is None else cameras.wiggling_left
        factor = (left - 1) * error
        size = xp.exp(xp.real(factor))
        return seen * size * (xp.cos(xp.imag(factor)) + 1j * xp.sin(xp.imag(factor)))

    def _fills(self, xp: ModuleType, light: PhasorsOf[Array]) -> bool:
        """Whether a tap may get more electrons than it can be read with."""
        dark_e = self.settings.dark_current_e_s * self.settings.integration_s
        other_e = ambient_rate_e_s(self.settings) * self.settings.integration_s
        brightest = float(xp.max(xp.abs(light[..., 0])))
        return brightest * self._electrons + other_e / 2 + dark_e >= self._most_e

    @property
    def _most_e(self) -> float:
        """Electrons that a tap can be read with."""
        settings, most = self.settings, float("inf")
        if settings.full_well_e is not None:
            most = settings.full_well_e
        if settings.adc_bits is not None and settings.adc_e_per_dn is not None:
            steps = 2**settings.adc_bits - 1 - settings.adc_offset_dn
            most = min(most, steps * settings.adc_e_per_dn)
        return most

    def _clipped(self, xp: ModuleType, difference: A, brightness: PixelsOf[Array]) -> A:
        """(..., H, W, N) differences of taps that hold no more than they can."""
        dark_e = self.settings.dark_current_e_s * self.settings.integration_s
        other_e = self._other_e(xp, brightness)[..., None]
        taps = []
        for sign in (1, -1):
            own_e = (brightness[..., None] + sign * difference) * self._electrons + other_e
            taps.append(xp.clip(xp.clip(own_e, min=0.0) / 2 + dark_e, max=self._most_e))
        return (taps[0] - taps[1]) / self._electrons


class _Cameras:
    """What differs between the cameras of N images, as arrays (N, 1, 1) or (N, 1, 1, 1)."""

    def __init__(
        self,
        xp: ModuleType,
        phasor: PhasorsOf[Array],
        settings: SensorSettings,
        cameras: Sequence[SensorSettings],
    ) -> None:
        if phasor.ndim != 4 or len(cameras) != phasor.shape[0]:
            raise ValueError(f"{len(cameras)} cameras for phasors of the shape {tuple(phasor.shape)}")
        self._settings, self._cameras = settings, cameras
        self._xp, self._kind, self._device = xp, xp.real(phasor[..., :1]).dtype, device(phasor)
        self.wiggling_left = self._array([each.wiggling_left for each in cameras])
        self.scattering = self._array([each.scattering for each in cameras])[..., None]

    def gain(self, frequency_hz: float) -> Array:
        """Contrast over the one that the firmware knows."""
        known = first_harmonic(self._settings, frequency_hz)
        return self._array([first_harmonic(each, frequency_hz) / known for each in self._cameras])

    def harmonics(self, frequency_hz: float) -> Harmonics:
        """`itof.sensor.demodulation.harmonics` of all images."""
        each = [harmonics(camera, frequency_hz) for camera in self._cameras]
        return {h: self._array([found.get(h, 0.0) for found in each]) for h in sorted(set().union(*each))}

    def _array(self, values: list[float]) -> Array:
        found = np.asarray(values, dtype=np.float64).reshape(-1, 1, 1)
        return self._xp.asarray(found, dtype=self._kind, device=self._device)


def _log_ratio(xp: ModuleType, seen: A, true: A) -> A:
    """log(seen / true), 0 where there is no light."""
    lit = true != 0
    quotient = xp.where(lit, seen, xp.ones_like(seen)) / xp.where(lit, true, xp.ones_like(true))
    return xp.log(xp.abs(quotient)) + 1j * xp.atan2(xp.imag(quotient), xp.real(quotient))
