"""Objects of one scene with different reflectances, and a mesh that was measured in its unit."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm

from itof import read_image
from render.batch.light import BatchedLight
from render.rendering import Renderer
from render.settings import settings_for
from scenegen import MEASUREMENT_FILE
from scenegen.mitsuba_description import mirrored_description, seen_description

DARK = 0.25


@pytest.fixture(scope="module")
def dataset(make_dataset):
    """One scene: a bright cube, and a dark sphere half a metre beside it."""
    beside = {"shape": "sphere", "size_m": 0.4, "offset_m": {"y": 0.5}, "reflectance": DARK}
    place = {"x": 1.1, "y": 0.6, "z": 1.5}
    return make_dataset(
        {
            "dataset": {"count": 1},
            "camera": {"width": 32, "height": 24},
            "object": [{"shape": "cube", "size_m": 0.4, "location_m": place, "beside": [beside]}],
        }
    )


def test_each_object_reflects_as_it_says_by_both_methods(dataset):
    (scene_id,) = dataset.ids()
    scene = dataset.scene(scene_id)
    given = {"device": "cpu", "product": "itof", "method": "many-light", "error": 0.01}
    (record,) = Renderer(dataset, settings_for(dataset, given)).render_all([scene_id])
    assert not isinstance(record, Exception)
    hidden, frequencies_hz = read_image(dataset.render_folder(scene_id) / MEASUREMENT_FILE).phasors("hidden")
    light = BatchedLight(frequencies_hz, 32, 24, error=0.02, device="cpu")
    both = light.images([scene]).hidden[0]
    assert norm(both - hidden) / norm(hidden) < np.hypot(0.02, 0.01)  # the errors asked for
    cube, sphere = scene.hidden_objects
    alike = light.images([replace(scene, hidden_objects=(cube, replace(sphere, reflectance=1.0)))]).hidden[0]
    assert norm(alike - hidden) / norm(hidden) > 0.1  # so that the test can fail


def test_materials_are_shared_unless_reflectances_differ(dataset):
    scene = dataset.scene("000000")
    for described in (seen_description(scene), mirrored_description(scene)):
        materials = {n: part for n, part in described.items() if n.startswith("hidden") and "_bsdf" in n}
        own = {name: part["bsdf"]["reflectance"]["value"] for name, part in materials.items()}
        assert own == {"hidden_object_0_bsdf": 1.0, "hidden_object_1_bsdf": DARK}
    cube, sphere = scene.hidden_objects
    same = replace(scene, hidden_objects=(cube, replace(sphere, reflectance=1.0)))
    assert "hidden_object_bsdf" in seen_description(same)
