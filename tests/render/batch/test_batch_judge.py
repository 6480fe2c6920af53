"""The judge of the batched engine: scenes of two presets, and meshes, against many lights at 0.5 %."""

import numpy as np
import pytest
from numpy.linalg import norm
from ring_scenes import RING, scenes_with_rings

from disk.preset_files import read_settings
from itof import TransientLayout
from render.batch.scene_lights import SceneLights
from scenegen.scene_folder import read_scene_folder

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 80, 60
REFERENCE = 0.005  # error of the many lights
MESHES = {"shapes": [RING, "cube", "cone", "concave_plane"], "composite_fraction": 0.5}


def hidden_of(dataset, scene_id, variant):
    from render.options import ManyLightOptions
    from render.transport.many_light import ManyLight
    from render.transport.method import View
    from render.transport.scene_loading import load_scene

    view = View(TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0), HZ, 3, 5)
    method = ManyLight(ManyLightOptions(error=REFERENCE), variant)
    return method.expose(load_scene(dataset, scene_id), view).phasors().hidden


@pytest.mark.parametrize(
    "count", [pytest.param(14, marks=pytest.mark.long), pytest.param(168, marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize(
    ("preset", "objects"), [("judge", {}), ("judge-any-corner", {}), ("judge-any-corner", MESHES)]
)
def test_scenes_are_within_the_wanted_error_and_none_is_brighter_or_darker(
    tmp_path, variant, preset, objects, count
):
    tables, _ = read_settings("presets", preset)
    tables = tables | {
        "dataset": {"count": count, "seed": 31},
        "hidden_object": tables.get("hidden_object", {}) | objects,
    }
    dataset = scenes_with_rings(tmp_path, tables)
    scenes = [(dataset.scene(each), read_scene_folder(dataset.scene_folder(each))) for each in dataset.ids()]
    expected = [hidden_of(dataset, scene_id, variant) for scene_id in dataset.ids()]
    for wanted in (0.04, 0.01):
        lights = SceneLights(HZ, WIDTH, HEIGHT, error=wanted, device="cpu").of(scenes)
        pairs = [(lights[each].hidden, hidden) for each, hidden in zip(dataset.ids(), expected, strict=True)]
        errors = np.array([norm(a - b) / norm(b) for a, b in pairs])
        scales = [np.vdot(b, a).real / np.vdot(b, b).real for a, b in pairs]
        allowed = 0.05 * count + 2 * (0.05 * 0.95 * count) ** 0.5  # 5 % and two standard deviations
        assert np.count_nonzero(errors > np.hypot(wanted, REFERENCE)) <= allowed
        # 0.3 %, and two standard errors of the mean of scales that scatter by half the wanted error
        assert abs(np.mean(scales) - 1) < 0.003 + wanted / count**0.5
