"""What a rough relay wall reflects: a diffuse base under a rough dielectric surface.

The same material as Mitsuba's ``roughplastic`` with its defaults: Beckmann's distribution of facets, Smith's
shadowing, refractive index 1.49 in air, and a base whose light passes the surface twice.

Source: Walter et al. 2007, Microfacet models for refraction (facets, shadowing); the base as documented for
Mitsuba's ``roughplastic``.
"""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scenegen.mitsuba_description import ROUGH_WALL_INDEX as _INDEX

ROUGHNESS: Final = (0.05, 1.0)  # smallest and largest that the tables have
_STEP = 0.05  # of the roughness in the tables
_COSINES = 63  # intervals of the tables, as in Mitsuba
_FACETS = (48, 24)  # of the quadrature: inclination and azimuth


def reflected(
    towards: Tensor, leaving: Tensor, normal: Tensor, roughness: float | None, reflectance: float = 1.0
) -> Tensor:
    """(...,) BSDF times the cosine of `leaving`, 1/sr; 0 behind the wall.

    Parameters
    ----------
    towards, leaving : (..., 3) unit vectors from the wall to where light comes from and goes to.
    normal : (3,) unit normal of the wall.
    roughness : alpha of the facets, in `ROUGHNESS`; None for a Lambertian wall.
    reflectance : of the base.
    """
    cos_in, cos_out = towards @ normal, leaving @ normal
    front = (cos_in > 0) & (cos_out > 0)
    if roughness is None:
        return torch.where(front, cos_out, 0) * (reflectance / math.pi)
    through = _looked_up(roughness, cos_in) * _looked_up(roughness, cos_out)
    inside = _internal_reflectance(roughness)
    base = through * cos_out * (reflectance / (math.pi * _INDEX**2 * (1 - inside)))
    between = towards + leaving
    facet = between / between.norm(dim=-1, keepdim=True)
    cos_facet = (facet @ normal).clamp(min=1e-4)
    incidence = (towards * facet).sum(-1).clamp(0, 1)
    tangent2 = 1 / cos_facet**2 - 1
    density = torch.exp(-tangent2 / roughness**2) / (math.pi * roughness**2 * cos_facet**4)
    shadowing = _smith(cos_in, roughness) * _smith(cos_out, roughness)
    gloss = density * shadowing * _fresnel(incidence, _INDEX) / (4 * cos_in.clamp(min=1e-4))
    return torch.where(front, base + gloss, 0)


def _smith(cosine: Tensor, roughness: float) -> Tensor:
    """Share of the facets that is not in shadow (Walter et al. 2007, eq. 27)."""
    inner = cosine.clamp(1e-4, 1 - 1e-7)
    a = inner / (roughness * torch.sqrt(1 - inner**2))
    fit = (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2)
    return torch.where(a >= 1.6, 1.0, fit)


def _fresnel(cosine: Tensor, index: float) -> Tensor:
    """Reflectance of an unpolarised ray, 1 at total reflection (Walter et al. 2007, eq. 22)."""
    squared = index**2 - 1 + cosine**2
    g = torch.sqrt(squared.clamp(min=1e-12))
    ratio = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    value = ((g - cosine) / (g + cosine)) ** 2 * (1 + ratio**2) / 2
    return torch.where(squared > 0, value, 1.0)


def _looked_up(roughness: float, cosine: Tensor) -> Tensor:
    """Share of light at these cosines that passes the surface, linear between the entries of the table."""
    table = torch.as_tensor(_interpolated(_tables()[0], roughness), dtype=cosine.dtype)
    place = (cosine.clamp(0, 1) * _COSINES).clamp(max=_COSINES - 1e-3)
    below = place.long()
    return torch.lerp(table[below], table[below + 1], place - below)


def _internal_reflectance(roughness: float) -> float:
    """Share of the diffuse light of the base that the surface sends back to it."""
    return float(_interpolated(_tables()[1], roughness))


def _interpolated(table: NDArray[np.float64], roughness: float) -> NDArray[np.float64]:
    low, high = ROUGHNESS
    place = min(max((roughness - low) / _STEP, 0), (high - low) / _STEP - 1e-6)
    below = int(place)
    mixed: NDArray[np.float64] = table[below] * (1 - place + below) + table[below + 1] * (place - below)
    return mixed


@functools.cache
def _tables() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(A, C + 1) transmittance by roughness and cosine, and (A,) internal reflectance."""
    low, high = ROUGHNESS
    roughness = low + _STEP * np.arange(round((high - low) / _STEP) + 1)
    cosines = np.linspace(0, 1, _COSINES + 1)
    sides = [[_shares(float(each), cosines, index) for index in (_INDEX, 1 / _INDEX)] for each in roughness]
    passed = np.stack([outside[1] for outside, _ in sides])
    back = np.stack([inside[0] for _, inside in sides]) * cosines  # (A, C + 1)
    return passed, 2 * back.mean(axis=1)  # as Mitsuba takes the mean


def _shares(
    roughness: float, cosines: NDArray[np.float64], index: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(C,) shares of light that a surface of facets reflects and lets through, by the cosine of incidence.

    The quadrature is even in the distribution function of the facets' inclination, and in their azimuth.
    What leaves in the shadow of another facet is lost in both.
    """
    cosine = torch.as_tensor(cosines, dtype=torch.float64).clamp(min=1e-4)[:, None, None]  # (C, 1, 1)
    node, weight = np.polynomial.legendre.leggauss(_FACETS[0])
    tangent2 = torch.as_tensor(-(roughness**2) * np.log1p(-(node + 1) / 2))[:, None]
    azimuth = torch.as_tensor(
        (np.arange(_FACETS[1]) + 0.5) * np.pi / _FACETS[1]
    )  # the other half is the same
    facet_z = 1 / torch.sqrt(1 + tangent2)  # (U, 1)
    facet_x = torch.sqrt(tangent2) * facet_z * torch.cos(azimuth)  # (U, V)
    incidence = torch.sqrt(1 - cosine**2) * facet_x + cosine * facet_z  # (C, U, V)
    weights = torch.as_tensor(weight / 2)[:, None] / _FACETS[1] * (incidence > 0)
    weights = weights * _smith(cosine, roughness) * incidence / (cosine * facet_z)
    fresnel = _fresnel(incidence.clamp(0, 1), index)
    mirrored = 2 * incidence * facet_z - cosine
    cosine_through = torch.sqrt((1 - (1 - incidence**2) / index**2).clamp(min=0))
    refracted = cosine / index - facet_z * (incidence / index - cosine_through)  # below the surface
    shares = []
    for part, leaving in ((fresnel, mirrored), (1 - fresnel, refracted)):
        lit = torch.where(leaving > 0, weights * part * _smith(leaving, roughness), 0)
        shares.append(lit.sum((1, 2)).numpy())
    return shares[0], shares[1]
