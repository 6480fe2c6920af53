"""From radiance to photo-electrons, and what the lens does to an image."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from array_api_compat import array_namespace, device
from numpy.typing import NDArray
from scipy.constants import c as light_speed_m_s
from scipy.constants import h as planck_j_s
from scipy.ndimage import gaussian_filter1d

from itof.arrays import A, Array, PhasorsOf
from itof.pinhole import pixel_rays
from itof.sensor.settings import SensorSettings


def electrons_per_joule(settings: SensorSettings) -> float:
    """Photo-electrons per joule of light on the area of a pixel."""
    photon_j = planck_j_s * light_speed_m_s / (settings.wavelength_nm * 1e-9)
    return settings.quantum_efficiency * settings.fill_factor / photon_j


def pixel_power_w(settings: SensorSettings, radiance: float) -> float:
    """Power on the axis on the area of a pixel that sees a radiance, W m^-2 sr^-1.

    The irradiance behind a lens of f-number N with the transmission T is π L T / (4 N²).
    """
    area_m2 = (settings.pixel_pitch_um * 1e-6) ** 2
    aperture = math.pi * settings.lens_transmission / (4 * settings.f_number**2)
    return radiance * aperture * area_m2


def emitter_scale(settings: SensorSettings) -> float:
    """Radiance for this emitter over the radiance of a scene, whose projector has the irradiance scale 1.

    That projector has the radiant intensity π / cos³ of the angle to its axis, so its power is π times the
    area of its image at a distance of 1.
    """
    side = 2 * math.tan(math.radians(settings.horizontal_fov_deg) / 2)
    return settings.emitter_power_w / (math.pi * side**2 * settings.height / settings.width)


def signal_rate_e_s(settings: SensorSettings) -> float:
    """Electrons per second in both taps of a pixel on the axis, per radiance of a scene."""
    return pixel_power_w(settings, emitter_scale(settings)) * electrons_per_joule(settings)


def ambient_rate_e_s(settings: SensorSettings) -> float:
    """Electrons per second in both taps of a pixel on the axis, of a white wall in the ambient light."""
    return pixel_power_w(settings, settings.ambient_w_m2 / math.pi) * electrons_per_joule(settings)


def falloff(settings: SensorSettings, width: int, height: int) -> NDArray[np.float64]:
    """(H, W) light of the pixels of an image over that on the axis (vignetting)."""
    cosine = pixel_rays(width, height, settings.horizontal_fov_deg)[..., 2]
    return np.asarray(cosine**settings.vignetting, dtype=np.float64)


def scattered(
    settings: SensorSettings, image: PhasorsOf[A], part: Array | float | None = None
) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) after the lens has spread a part of their light over the image.

    The spread is a Gaussian; what leaves the image comes back mirrored at its border.

    Parameters
    ----------
    image : of numpy or any other library of the array API.
    part : scalar or (..., 1, 1, 1) array that replaces the `scattering` of the settings.
    """
    if settings.scattering == 0:
        return image
    xp = array_namespace(image)
    sigma = settings.scattering_width * image.shape[-2]
    down, across = (
        xp.asarray(_blur(size, sigma), dtype=image.dtype, device=device(image)) for size in image.shape[-3:-1]
    )
    planes = xp.moveaxis(image, -1, -3)  # (..., F, H, W)
    spread = xp.moveaxis(down @ planes @ xp.matrix_transpose(across), -3, -1)
    part = settings.scattering if part is None else part
    return (1 - part) * image + part * spread


def leaked(settings: SensorSettings, image: PhasorsOf[A]) -> PhasorsOf[A]:
    """Phasors (..., H, W, F) after every sensor pixel has lost electrons to its four neighbours.

    Within a bin of b x b sensor pixels this changes nothing on average; over each of its sides, 1 / b of the
    pixels lose a quarter of their `crosstalk` to the next bin. At the border of the sensor, nothing is lost.

    Parameters
    ----------
    image : of numpy or any other library of the array API.
    """
    if settings.crosstalk == 0:
        return image
    xp = array_namespace(image)
    height, width = image.shape[-3:-1]
    part = settings.crosstalk / 4 / settings.binning(width, height)
    down, across = (
        xp.asarray(part * _neighbours(size), dtype=image.dtype, device=device(image))
        for size in (height, width)
    )
    planes = xp.moveaxis(image, -1, -3)  # (..., F, H, W)
    return xp.moveaxis(planes + down @ planes + planes @ across, -3, -1)


@cache
def _neighbours(size: int) -> NDArray[np.float64]:
    """(size, size) matrix of both neighbours' sum less twice a value; the ends are their own neighbours."""
    both = np.eye(size, k=1) + np.eye(size, k=-1)
    return both - np.diag(both.sum(axis=0))


@cache
def _blur(size: int, sigma: float) -> NDArray[np.float64]:
    """(size, size) matrix of a Gaussian of standard deviation `sigma` pixels along an axis."""
    return np.asarray(gaussian_filter1d(np.eye(size), sigma, axis=0, mode="reflect", truncate=3.0))
