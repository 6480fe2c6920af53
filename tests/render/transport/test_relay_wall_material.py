"""The relay wall's material: Mitsuba's rough plastic returns less light than its reflectance says."""

import numpy as np
import pytest
from many_light_scenes import FREQUENCIES_HZ, Corner, relative, rough_plastic

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


def textured(periods):
    """A diffuse wall whose reflectance has this many waves over each triangle, in both directions."""
    import mitsuba as mi

    wave = np.sin(2 * np.pi * periods * np.arange(256) / 256)
    picture = (0.6 + 0.3 * wave[:, None] * wave)[..., None].astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True}
    return {"type": "twosided", "nested": {"type": "diffuse", "reflectance": texture}}


@pytest.mark.parametrize(
    "wall", [lambda: textured(8), lambda: rough_plastic(0.05)], ids=["waves", "highlight"]
)
def test_pixels_over_which_the_walls_brightness_varies_get_more_nodes(variant, tmp_path, wall):
    from render.transport.film.pixels import Grid, gauss_rule
    from render.transport.passes.direct_pass import direct_order, gather_direct
    from render.transport.passes.direct_samples import direct_phasors_of, sample_direct

    scene, grid = Corner(wall_bsdf=wall()).load(tmp_path), Grid(12, 9)

    def image(order):
        rule = gauss_rule(order)
        points = grid.points(np.arange(12 * 9), rule.pixel_nodes)
        z = direct_phasors_of(sample_direct(scene, points.reshape(-1, 2), 1), FREQUENCIES_HZ)
        return np.einsum("pnf,n->pf", z.reshape(12 * 9, rule.count, -1), rule.pixel_weights).reshape(
            9, 12, -1
        )

    exact = image(48)
    found = relative(gather_direct(scene, grid, FREQUENCIES_HZ, 1, edge_divisions=7).phasors, exact)
    assert found.max() < 2.5e-6  # 1 % of a hidden signal of 2e-4
    assert found.max() < relative(image(direct_order(12, FREQUENCIES_HZ)), exact).max() / 4
