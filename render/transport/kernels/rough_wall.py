"""The material of a rough relay wall: Mitsuba's ``roughplastic`` with its defaults, ready sooner.

Mitsuba computes the tables of each ``roughplastic`` anew. That takes 70 ms, a third of the time of a scene of
40 x 30 pixels. Here, the tables of each roughness are computed once. The materials themselves are not kept,
because DrJit would compile all that exist into every kernel.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from scenegen.mitsuba_description import ROUGH_WALL_INDEX as _INDEX

PLUGIN = "night_rough_wall"
COSINES = 64  # in the table of the transmittance, from 0 to 1
_NODES = 32  # of its quadrature, along each axis


@cache
def register_rough_wall(variant: str) -> str:
    """Register the material for the active `variant`, and return the name of its plugin.

    The plugin has the parameters `alpha`, the roughness of the facets, and `diffuse_reflectance` of the base,
    a number or a texture. The facets have Beckmann's distribution and Smith's shadowing, and the refractive
    index 1.49 in air. Light passes them on its way to the base and on its way back.

    Source: Walter et al. 2007, Microfacet models for refraction (facets, shadowing); the base, the tables and
    the choice of samples are those of Mitsuba's ``roughplastic``, with which the tests compare.
    """
    import drjit as dr
    import mitsuba as mi

    facets, front = mi.MicrofacetType.Beckmann, mi.BSDFFlags.FrontSide
    hemisphere, hemisphere_pdf = mi.warp.square_to_cosine_hemisphere, mi.warp.square_to_cosine_hemisphere_pdf

    class RoughWall(mi.BSDF):
        def __init__(self, properties: mi.Properties) -> None:
            super().__init__(properties)
            alpha = float(properties["alpha"])
            self.base = properties.get_texture("diffuse_reflectance", 0.5)
            transmittance, internal = surface_tables(variant, alpha)
            # opaque, because literals would compile all kernels again for another roughness
            self.alpha = dr.opaque(mi.Float, alpha)
            self.transmittance = mi.Float(transmittance)
            self.scale = dr.opaque(mi.Float, 1 / (np.pi * _INDEX**2 * (1 - internal)))
            self.gloss_share = dr.opaque(mi.Float, 1 / (1 + float(np.ravel(self.base.mean())[0])))
            self.m_components = [
                mi.BSDFFlags.GlossyReflection | front,
                mi.BSDFFlags.DiffuseReflection | front,
            ]
            self.m_flags = self.m_components[0] | self.m_components[1]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """BSDF times the cosine of `wo`, 1/sr."""
            cos_in, cos_out = si.wi.z, wo.z
            active = (cos_in > 0) & (cos_out > 0) & active
            between, distribution = dr.normalize(wo + si.wi), self._facets()
            fresnel = mi.fresnel(dr.dot(si.wi, between), mi.Float(_INDEX))[0]
            gloss = fresnel * distribution.eval(between) * distribution.G(si.wi, wo, between) / (4 * cos_in)
            through = self._through(cos_in, active) * self._through(cos_out, active)
            return (gloss + self.base.eval(si, active) * (self.scale * cos_out * through)) & active

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """Density of the directions of `sample`, 1/sr."""
            active = (si.wi.z > 0) & (wo.z > 0) & active
            between, distribution = dr.normalize(wo + si.wi), self._facets()
            gloss = distribution.eval(between) * distribution.smith_g1(si.wi, between) / (4 * si.wi.z)
            return dr.select(active, dr.lerp(hemisphere_pdf(wo), gloss, self._gloss(si, active)), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            """Results of `eval` and `pdf`."""
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            """A direction, and the BSDF times its cosine over its density."""
            active = (si.wi.z > 0) & active
            is_gloss = sample1 < self._gloss(si, active)
            facet = self._facets().sample(si.wi, sample2)[0]
            chosen = mi.BSDFSample3f()
            chosen.wo = dr.select(is_gloss, mi.reflect(si.wi, facet), hemisphere(sample2))
            chosen.eta = 1.0
            chosen.sampled_component = dr.select(is_gloss, mi.UInt32(0), mi.UInt32(1))
            types = [
                mi.UInt32(int(t)) for t in (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection)
            ]
            chosen.sampled_type = dr.select(is_gloss, *types)
            value, chosen.pdf = self.eval_pdf(ctx, si, chosen.wo, active)
            return chosen, dr.select(active & (chosen.pdf > 0), value / chosen.pdf, 0)

        def to_string(self) -> str:
            """Name of the material and its parameters."""
            return f"RoughWall[alpha = {self.alpha}, diffuse_reflectance = {self.base}]"

        def _facets(self) -> mi.MicrofacetDistribution:
            return mi.MicrofacetDistribution(facets, self.alpha, True)

        def _gloss(self, si: Any, active: Any) -> Any:
            """Probability that a sample takes the facets and not the base."""
            through = self._through(si.wi.z, active)
            share = (1 - through) * self.gloss_share
            return share / (share + through * (1 - self.gloss_share))

        def _through(self, cosine: Any, active: Any) -> Any:
            """Share of light at this cosine that passes the facets."""
            place = cosine * (COSINES - 1)
            below = dr.minimum(mi.UInt32(place), COSINES - 2)
            ends = [dr.gather(mi.Float, self.transmittance, below + step, active) for step in (0, 1)]
            return dr.lerp(*ends, place - mi.Float(below))

    mi.register_bsdf(PLUGIN, RoughWall)
    return PLUGIN


@cache
def surface_tables(variant: str, alpha: float) -> tuple[np.ndarray, float]:
    """What passes the facets from outside, (C,) by cosine, and what they send back of the base's light.

    Mitsuba adds up the first in float32. Its light therefore differs by 1e-6, up to 0.1 % of the hidden
    signal.
    """
    import drjit as dr
    import mitsuba as mi

    facets = mi.MicrofacetType.Beckmann
    cosines = np.linspace(0, 1, COSINES, dtype=np.float32).clip(1e-6)
    columns = (np.sqrt(1 - cosines**2), np.zeros_like(cosines), cosines)
    directions = mi.Vector3f(*(mi.Float(column) for column in columns))
    inside = np.array(mi.eval_reflectance(facets, alpha, alpha, directions, 1 / _INDEX))
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    place = [axis.ravel() for axis in np.meshgrid((node + 1) / 2, (node + 1) / 2)]
    weights = np.outer(weight, weight).ravel() / 4
    lane = dr.arange(mi.UInt32, COSINES * _NODES**2)
    incident = dr.gather(mi.Vector3f, directions, lane // _NODES**2)
    sample = mi.Point2f(*(dr.gather(mi.Float, mi.Float(axis), lane % _NODES**2) for axis in place))
    distribution = mi.MicrofacetDistribution(facets, dr.opaque(mi.Float, alpha), True)
    facet = distribution.sample(incident, sample)[0]
    fresnel, cosine, _, inverse = mi.fresnel(dr.dot(incident, facet), mi.Float(_INDEX))
    refracted = mi.refract(incident, facet, cosine, inverse)
    passed = dr.select(refracted.z < 0, distribution.smith_g1(refracted, facet) * (1 - fresnel), 0)
    # not a matrix product, which numbers of threads round differently
    transmittance = (np.array(passed).reshape(COSINES, -1) * weights).sum(axis=1)
    return transmittance, float(2 * (inside * cosines).mean())
