"""The relay wall's material: Mitsuba's rough plastic returns less light than its reflectance says."""

import numpy as np
import pytest

from scenegen import preset_from_dict, sample_scene
from scenegen.mitsuba_description import seen_description

NODES = 80


def directional_albedo(roughness, cosine):
    """Share of the light from one direction that the wall returns, by quadrature over the hemisphere."""
    import drjit as dr
    import mitsuba as mi

    preset = preset_from_dict({"relay_wall": {"roughness": [roughness]}}, "test")
    bsdf = mi.load_dict(dict(seen_description(sample_scene(preset, 0))["relay_wall_bsdf"]))
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    z, turn = np.meshgrid((nodes + 1) / 2, 2 * np.pi * (np.arange(NODES) + 0.5) / NODES)
    sine = np.sqrt(1 - z**2)
    outgoing = [mi.Float(part.ravel()) for part in (sine * np.cos(turn), sine * np.sin(turn), z)]
    hit = dr.zeros(mi.SurfaceInteraction3f, z.size)
    hit.wi = dr.opaque(mi.Vector3f, [float(np.sqrt(1 - cosine**2)), 0.0, float(cosine)])  # one kernel for all
    values = np.array(bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(*outgoing))).reshape(
        z.shape
    )  # with cosine
    return (values * weights / 2).sum() * 2 * np.pi / NODES


def albedo(roughness):
    """The same, as a mean over light from all directions."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    cosines = (nodes + 1) / 2
    return sum(w * c * directional_albedo(roughness, c) for w, c in zip(weights, cosines, strict=True))


@pytest.mark.parametrize(("roughness", "expected"), [(0.3, 0.87), (1.0, 0.50)])
def test_rough_plastic_of_reflectance_1_has_the_albedo_that_the_docs_say(variant, roughness, expected):
    assert albedo(roughness) == pytest.approx(expected, abs=0.005)  # both have two digits


def test_a_diffuse_wall_returns_its_reflectance(variant):
    import mitsuba as mi

    preset = preset_from_dict({"relay_wall": {"material": "diffuse", "reflectance": 0.7}}, "test")
    bsdf = mi.load_dict(dict(seen_description(sample_scene(preset, 0))["relay_wall_bsdf"]))
    hit = mi.SurfaceInteraction3f()
    hit.wi = mi.Vector3f(0.0, 0.6, 0.8)
    value = np.array(bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(0.8, 0.0, 0.6)))
    np.testing.assert_allclose(value, 0.7 * 0.6 / np.pi, rtol=1e-5)
