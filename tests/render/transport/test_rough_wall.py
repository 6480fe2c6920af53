"""The renderer's own material of a rough wall is Mitsuba's, and renders with either are the same."""

import numpy as np
import pytest

from itof import TransientLayout, read_image
from render.options import ManyLightOptions
from render.rendering import Renderer
from render.settings import RenderSettings
from render.transport.kernels.rough_wall import register_rough_wall
from render.transport.many_light import ManyLight
from render.transport.method import View
from render.transport.scene_loading import load_scene
from scenegen.mitsuba_description import ROUGH_WALL

COUNT = 5000


def directions(rng):
    """Unit vectors on both sides of the wall, some at grazing incidence."""
    import mitsuba as mi

    z, turn = rng.uniform(-0.2, 1, COUNT), rng.uniform(0, 2 * np.pi, COUNT)
    ring = np.sqrt(1 - z**2)
    return mi.Vector3f(*(mi.Float(part) for part in (ring * np.cos(turn), ring * np.sin(turn), z)))


def uniform(reflectance):
    return {"type": "spectrum", "value": reflectance}


def picture():
    import mitsuba as mi

    pixels = np.random.default_rng(1).random((4, 5, 1)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "wrap_mode": "clamp"}


@pytest.fixture
def hits(variant):
    import drjit as dr
    import mitsuba as mi

    rng = np.random.default_rng(2)
    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi, leaving = directions(rng), directions(rng)
    si.uv = mi.Point2f(mi.Float(rng.random(COUNT)), mi.Float(rng.random(COUNT)))
    return si, leaving, mi.Float(rng.random(COUNT)), si.uv.yx


@pytest.mark.parametrize(
    ("roughness", "base"),
    [
        (0.05, lambda: uniform(0.5)),
        (0.3, picture),
        (0.55, lambda: uniform(1.0)),
        (1.0, lambda: uniform(0.5)),
        (1.0, picture),
    ],
)
def test_the_material_is_mitsubas(variant, hits, roughness, base):
    import mitsuba as mi

    si, leaving, *random = hits
    context = mi.BSDFContext()
    theirs, ours = (
        mi.load_dict({"type": plugin, "alpha": roughness, "diffuse_reflectance": base()})
        for plugin in (ROUGH_WALL, register_rough_wall(variant))
    )
    assert ours.flags() == theirs.flags()
    values = [np.array(bsdf.eval(context, si, leaving).x) for bsdf in (ours, theirs)]
    assert (values[1] > 0).mean() > 0.5
    np.testing.assert_allclose(*values, rtol=2e-5, atol=1e-9)
    front = np.array((si.wi.z > 0) & (leaving.z > 0))
    densities = [np.array(bsdf.pdf(context, si, leaving)) for bsdf in (ours, theirs)]
    np.testing.assert_allclose(densities[0][front], densities[1][front], rtol=2e-5, atol=1e-9)
    assert not densities[0][~front].any()  # Mitsuba has some where nothing is reflected
    (found, weight), (expected, expected_weight) = (b.sample(context, si, *random) for b in (ours, theirs))
    lit = np.array(expected_weight.x) > 0
    assert lit.mean() > 0.5
    # Quotients of value and density, each of which may be off by 2e-5.
    np.testing.assert_allclose(np.array(weight.x), np.array(expected_weight.x), rtol=4e-5, atol=1e-6)
    np.testing.assert_array_equal(np.array(found.wo)[:, lit], np.array(expected.wo)[:, lit])
    kinds = [np.array(each.sampled_component)[lit] for each in (found, expected)]
    np.testing.assert_array_equal(*kinds)


@pytest.mark.parametrize(
    ("max_bounces", "darkening"),
    [
        pytest.param(3, {}, id="even"),
        pytest.param(4, {"least_reflectance": 0.3}, id="darker", marks=pytest.mark.long),
    ],
)
def test_files_have_the_phasors_of_mitsubas_material(make_dataset, variant, max_bounces, darkening):
    preset = {
        "dataset": {"count": 1, "seed": 3},
        "camera": {"width": 16, "height": 12},
        "hidden_object": {"composite_fraction": 1.0},
        "relay_wall": {"roughness": [0.4], **darkening},
    }
    dataset = make_dataset(preset)
    options = ManyLightOptions(lights=128)
    Renderer(dataset, RenderSettings(options=options, device="cpu", max_bounces=max_bounces)).render("000000")
    image = read_image(dataset.render_folder("000000") / "itof.exr")
    frequencies_hz = dataset.preset.itof.frequencies_hz
    view = View(
        TransientLayout(16, 12, 2400, 0.01, 0.0), frequencies_hz, max_bounces, dataset.scene("000000").seed
    )
    expected = ManyLight(options, variant).expose(load_scene(dataset, "000000"), view).phasors()
    hidden = np.linalg.norm(expected.hidden, axis=(0, 1))  # (F,)
    for part in ("direct", "hidden"):
        found, _ = image.phasors(part)
        error = np.linalg.norm(found - getattr(expected, part), axis=(0, 1))
        assert np.all(error < 1e-3 * hidden), part  # a tenth of the default --error
