"""The scenes of a batch, and what their walls reflect. Import this module after a Mitsuba variant is set."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from render.batch.kernels.shadows import Shadows
from render.transport.kernels.rough_wall import COSINES
from scenegen.mitsuba_description import ROUGH_WALL_INDEX as _INDEX

QUAD = mi.Vector4f  # four numbers that one gather reads


class Batch:
    """The scenes of a batch, as flat arrays.

    Attributes
    ----------
    walls : relay wall and occluder of each scene, as `Wall` reads them.
    transmittance : (N, COSINES) share of light that passes the wall's surface, by cosine.
    phase_per_metre : opaque numbers, rad/m, of each frequency.
    shadows : what else can hide light.
    """

    def __init__(
        self, walls: mi.Float, transmittance: mi.Float, phase_per_metre: list[mi.Float], shadows: Shadows
    ) -> None:
        self.walls, self.transmittance = walls, transmittance
        self.phase_per_metre, self.shadows = phase_per_metre, shadows

    def with_objects(self, objects: mi.Float) -> Batch:
        """The same walls with other objects, which only mirror images may ask for: no scene has them."""
        old = self.shadows
        shadows = Shadows(old.world, old.first, old.last, objects, old.has_meshes)
        return Batch(self.walls, self.transmittance, self.phase_per_metre, shadows)


class Wall:
    """The relay wall of scene `n` and its occluder, gathered once for each lane."""

    WIDTH = 6  # groups of four

    def __init__(self, batch: Batch, n: mi.UInt32) -> None:
        rows = [dr.gather(QUAD, batch.walls, n * self.WIDTH + row) for row in range(self.WIDTH)]
        self.normal, self.alpha = mi.Vector3f(rows[0].x, rows[0].y, rows[0].z), rows[0].w
        self.dimming, self.brightness = mi.Vector3f(rows[1].x, rows[1].y, rows[1].z), rows[1].w
        self.corner, self.base = mi.Vector3f(rows[2].x, rows[2].y, rows[2].z), rows[2].w
        self.one, self.gloss = mi.Vector3f(rows[3].x, rows[3].y, rows[3].z), rows[3].w
        self.two = mi.Vector3f(rows[4].x, rows[4].y, rows[4].z)
        self.plane = -self.normal / rows[4].w  # m · p = 1 for its points p
        self.across = mi.Vector3f(rows[5].x, rows[5].y, rows[5].z)
        self.table, self.first = batch.transmittance, n * COSINES

    def passed(self, cosine: mi.Float) -> mi.Float:
        """Share of light at this cosine that passes the surface."""
        place = dr.clip(cosine, 0, 1) * (COSINES - 1)
        below = dr.minimum(mi.UInt32(place), COSINES - 2)
        low, high = (dr.gather(mi.Float, self.table, self.first + below + step) for step in (0, 1))
        return dr.lerp(low, high, place - mi.Float(below))

    def towards_camera(self, at: mi.Point3f, distance: mi.Float) -> tuple[mi.Float, mi.Float]:
        """What belongs to a wall point and the camera: factors of the diffuse part and of the gloss."""
        cosine = -dr.dot(at, self.normal) / distance
        bright = self.brightness + dr.dot(self.dimming, at)
        diffuse = self.passed(cosine) * self.base * bright
        gloss = self.gloss * _smith(cosine, self.alpha) / (4 * dr.maximum(cosine, 1e-4))
        front = cosine > 0
        return dr.select(front, diffuse, 0), dr.select(front, gloss, 0)

    def lobe(self, back: mi.Vector3f, to: mi.Vector3f, diffuse: mi.Float, gloss: mi.Float) -> mi.Float:
        """BSDF between the camera (direction `back`) and `to`, times the cosine of `to`, 1/sr.

        Source: Walter et al. 2007 (Beckmann's facets, Smith's shadowing); base of Mitsuba's ``roughplastic``.
        """
        cosine = dr.dot(to, self.normal)
        between = back + to
        half = between * dr.rsqrt(dr.squared_norm(between))
        facet = dr.maximum(dr.dot(half, self.normal), 1e-4)
        inverse2 = dr.rcp(dr.square(facet))
        roughness2 = dr.rcp(dr.square(self.alpha))
        density = dr.exp((1 - inverse2) * roughness2) * roughness2 * dr.square(inverse2) * dr.inv_pi
        incidence = dr.clip(dr.dot(back, half), 0, 1)
        shine = density * _smith(cosine, self.alpha) * _fresnel(incidence) * gloss
        return dr.select(cosine > 0, diffuse * self.passed(cosine) * cosine + shine, 0)

    def hides(self, at: mi.Point3f, point: mi.Point3f) -> mi.Bool:
        """Whether the occluder is between two points."""
        before, behind = dr.dot(at - self.corner, self.across), dr.dot(point - self.corner, self.across)
        share = before / dr.select(before == behind, 1, before - behind)
        where = at + share * (point - at) - self.corner
        u, v = dr.dot(where, self.one), dr.dot(where, self.two)
        return (before * behind < 0) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)


def _smith(cosine: mi.Float, alpha: mi.Float) -> mi.Float:
    """Share of the facets that is not in shadow (Walter et al. 2007, eq. 27)."""
    inner = dr.clip(cosine, 1e-4, 1 - 1e-6)
    a = inner * dr.rsqrt(1 - dr.square(inner)) / alpha
    fit = (3.535 * a + 2.181 * dr.square(a)) / (1 + 2.276 * a + 2.577 * dr.square(a))
    return dr.select(a >= 1.6, 1, fit)


def _fresnel(cosine: mi.Float) -> mi.Float:
    """Reflectance of an unpolarised ray (Walter et al. 2007, eq. 22)."""
    g = dr.sqrt(_INDEX**2 - 1 + dr.square(cosine))
    p_over_s = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    return dr.square((g - cosine) / (g + cosine)) * (1 + dr.square(p_over_s)) / 2
