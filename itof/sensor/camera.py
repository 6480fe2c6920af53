"""A camera: raw frames of its taps, with noise and limits, and the phasors that come out of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from array_api_compat import array_namespace, device, to_device
from numpy.typing import NDArray

from itof.arrays import Array, Phasors, PhasorsOf, PixelsOf, S
from itof.sensor.demodulation import calibrated, phasor_of_differences, tap_differences
from itof.sensor.fixed_pattern import alive_pixels, tap_patterns
from itof.sensor.geometry import geometry
from itof.sensor.light import ambient_rate_e_s, falloff, leaked, scattered, signal_rate_e_s
from itof.sensor.settings import SensorSettings

_FEW_E = 1e6  # above, Poisson's distribution is that of Gauss to 1e-3 of its width, and drawn as such


@dataclass(frozen=True)
class Captured:
    """What a camera makes of images.

    Attributes
    ----------
    phasor : (..., H, W, F) complex, in the unit of the scenes; 0 where all sensor pixels of a pixel are dead.
    saturated : (..., H, W) part of the sensor pixels of a pixel, and of its raw frames, that are saturated.
    signal_e : (..., H, W) expected electrons of the emitter's light in both taps of a sensor pixel in a raw
        frame, without saturation.
    """

    phasor: PhasorsOf[Array]
    saturated: PixelsOf[Array]
    signal_e: PixelsOf[Array]


@dataclass(frozen=True)
class Camera:
    """A camera with a fixed pattern of its own.

    Attributes
    ----------
    settings : of the camera.
    frequencies_hz : F modulation frequencies, Hz.
    """

    settings: SensorSettings
    frequencies_hz: Sequence[float]

    def capture(self, phasor: PhasorsOf[Array], rng: np.random.Generator) -> Captured:
        """Measure images.

        The amplitude at the lowest frequency stands for the brightness: light of one path has the same
        amplitude at every frequency, and the light of a pixel is almost that of one path.

        Parameters
        ----------
        phasor : (..., H, W, F) complex phasors of scenes (unit: docs/reference/files.md), of numpy or another
            library of the array API. H and W divide the sensor's height and width by the same whole number;
            the sensor pixels of a pixel see the same light, and their phasors are averaged.
        rng : for noise and drift; the fixed pattern has its own seed.

        Raises
        ------
        ValueError : the number of frequencies differs, or H and W do not fit the sensor.
        """
        xp = array_namespace(phasor)
        seen = np.asarray(to_device(phasor, "cpu"), dtype=np.complex128)
        self._refuse_other_frequencies(seen)
        height, width = seen.shape[-3:-1]
        images = seen.reshape(-1, *seen.shape[-3:])
        parts = [self._one(image, self.settings.binning(width, height), rng) for image in images]
        kind = np.dtype(str(phasor.dtype).rpartition(".")[2])  # "torch.complex64" or "complex64"
        found = [
            np.stack(each).reshape(*seen.shape[:-3], *each[0].shape).astype(wanted)
            for each, wanted in zip(zip(*parts, strict=True), (kind, np.float32, np.float32), strict=True)
        ]
        return Captured(*(xp.asarray(each, device=device(phasor)) for each in found))

    def raw_frames(self, phasor: Phasors, rng: np.random.Generator) -> NDArray[np.float64]:
        """Numbers that the sensor is read with, before any firmware.

        Parameters
        ----------
        phasor : (H, W, F) complex phasors of a scene, as in `capture`.

        Returns
        -------
        (frames, F, N, 2, sensor height, sensor width) numbers of the converter (DN), or electrons if there is
        none, of both taps in each of N raw frames; of dead pixels 0.

        Raises
        ------
        ValueError : as in `capture`.
        """
        self._refuse_other_frequencies(phasor)
        settings = self.settings
        binning = settings.binning(phasor.shape[1], phasor.shape[0])
        light = self._light(np.asarray(phasor, dtype=np.complex128), rng)
        frames = [
            [
                self._tap_images(light, place, frequency_hz, binning, rng)[0]
                for place, frequency_hz in self._places
            ]
            for _ in range(settings.frames)
        ]
        taps = np.moveaxis(np.asarray(frames), (-2, -1), (2, 3))  # (frames, F, N, 2, height, width)
        if settings.adc_e_per_dn is not None:
            taps = np.round(taps / settings.adc_e_per_dn + settings.adc_offset_dn)
        return np.asarray(taps * self._alive)

    def _one(
        self, image: NDArray[np.complex128], binning: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
        """`capture` of one image (H, W, F)."""
        settings = self.settings
        light = self._light(image, rng)
        alive = self._alive
        total = np.zeros(image.shape, dtype=np.complex128)
        saturated = np.zeros(image.shape[:2])
        readings = settings.frames * len(self.frequencies_hz) * settings.phase_steps * 2
        for place, frequency_hz in self._places:
            for _ in range(settings.frames):
                taps, full = self._tap_images(light, place, frequency_hz, binning, rng)
                saturated += _binned(full * alive, binning) / readings
                z = np.asarray(phasor_of_differences(settings, taps[..., 0] - taps[..., 1], frequency_hz))
                total[..., place] += _binned(calibrated(settings, z, frequency_hz) * alive, binning)
        lit = _binned(alive.astype(np.float64), binning)
        share = np.divide(1.0, lit, out=np.zeros_like(lit), where=lit > 0)
        mean = total * share[..., None] / (settings.frames * self._electrons)
        return mean, saturated * share, np.abs(light[..., 0]) * self._electrons

    @property
    def _places(self) -> list[tuple[int, float]]:
        return list(enumerate(self.frequencies_hz))

    @property
    def _electrons(self) -> float:
        """Electrons of a raw frame in both taps, per radiance."""
        return signal_rate_e_s(self.settings) * self.settings.integration_s

    def _refuse_other_frequencies(self, phasor: PhasorsOf[Array]) -> None:
        if phasor.shape[-1] != len(self.frequencies_hz):
            raise ValueError(
                f"expected phasors at {len(self.frequencies_hz)} frequencies, got {phasor.shape[-1]}"
            )

    def _light(self, image: NDArray[np.complex128], rng: np.random.Generator) -> NDArray[np.complex128]:
        """(H, W, F) phasors behind the lens, with the phases of this image."""
        there = geometry(self.settings, image, self.frequencies_hz)
        height, width = image.shape[:2]
        lens = falloff(self.settings, width, height)  # (H, W)
        drift = self.settings.phase_drift_rad * rng.standard_normal(len(self.frequencies_hz))
        light = scattered(self.settings, there) * lens[..., None] * np.exp(1j * drift)
        return np.asarray(leaked(self.settings, light))

    def _tap_images(
        self,
        light: NDArray[np.complex128],
        place: int,
        frequency_hz: float,
        binning: int,
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Electrons (height, width, N, 2) that the taps are read with; full ones of each sensor pixel."""
        settings = self.settings
        height, width = light.shape[:2]
        other_e = ambient_rate_e_s(settings) * settings.integration_s * falloff(settings, width, height)
        dark_e = settings.dark_current_e_s * settings.integration_s  # in each tap
        brightness = np.abs(light[..., 0])  # (H, W)
        difference = tap_differences(settings, light[..., place], frequency_hz)  # (H, W, N)
        found, full = [], np.zeros((settings.height, settings.width))
        for sign in (1, -1):
            mine = (brightness[..., None] + sign * difference) * self._electrons  # twice this tap's part
            mean_e = np.maximum(mine + other_e[..., None], 0) / 2 + dark_e
            tap_e, is_full = self._read(_repeated(mean_e, binning), sign, rng)
            found.append(tap_e)
            full += is_full.sum(axis=-1)
        return np.stack(found, axis=-1), full

    def _read(
        self, mean_e: NDArray[np.float64], tap: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Electrons (..., N) that a tap (1 or -1) of every sensor pixel is read with; whether it is full."""
        settings = self.settings
        gain, offset_e = self._pattern[0 if tap > 0 else 1]
        gain = gain * (1.0 if tap > 0 else 1 + settings.tap_mismatch)
        charge_e = _shot(mean_e, rng) if settings.shot_noise else mean_e
        full = np.zeros(charge_e.shape, dtype=np.bool_)
        if settings.full_well_e is not None:
            full |= charge_e >= settings.full_well_e
            charge_e = np.minimum(charge_e, settings.full_well_e)
        read_e = charge_e * gain[..., None] + offset_e[..., None]
        if settings.read_noise_e:
            read_e = read_e + settings.read_noise_e * rng.standard_normal(read_e.shape)
        if settings.adc_bits is not None and settings.adc_e_per_dn is not None:
            most = 2**settings.adc_bits - 1
            numbers = np.round(read_e / settings.adc_e_per_dn + settings.adc_offset_dn)
            full |= numbers >= most
            read_e = (np.clip(numbers, 0, most) - settings.adc_offset_dn) * settings.adc_e_per_dn
        return read_e, full

    @cached_property
    def _pattern(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        return tap_patterns(self.settings)

    @cached_property
    def _alive(self) -> NDArray[np.bool_]:
        return alive_pixels(self.settings)


def _shot(mean_e: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Electrons that arrive where `mean_e` are expected."""
    many = mean_e > _FEW_E
    drawn = rng.poisson(np.where(many, 0, mean_e)).astype(np.float64)
    if many.any():
        drawn[many] = mean_e[many] + np.sqrt(mean_e[many]) * rng.standard_normal(int(many.sum()))
    return drawn


def _repeated(image: NDArray[np.float64], binning: int) -> NDArray[np.float64]:
    """(H b, W b, ...) every pixel of (H, W, ...) b times along both axes."""
    return image.repeat(binning, axis=0).repeat(binning, axis=1)


def _binned(image: NDArray[S], binning: int) -> NDArray[S]:
    """(H, W) sums over the b x b pixels of an image (H b, W b)."""
    height, width = image.shape[0] // binning, image.shape[1] // binning
    return np.asarray(image.reshape(height, binning, width, binning).sum(axis=(1, 3)))
