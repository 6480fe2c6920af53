"""The judge of the batched engine: scenes of two presets against many lights at 0.5 %."""

import numpy as np
import pytest
from numpy.linalg import norm

from disk.preset_files import read_settings
from itof import TransientLayout
from render.batch.light import BatchedLight

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 80, 60
REFERENCE = 0.005  # error of the many lights


def hidden_of(dataset, scene_id, variant):
    from render.options import ManyLightOptions
    from render.transport.many_light import ManyLight
    from render.transport.method import View
    from render.transport.scene_loading import load_scene

    view = View(TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0), HZ, 3, 5)
    method = ManyLight(ManyLightOptions(error=REFERENCE), variant)
    return method.expose(load_scene(dataset, scene_id), view).phasors().hidden


@pytest.mark.parametrize(
    "count", [pytest.param(21, marks=pytest.mark.long), pytest.param(252, marks=pytest.mark.thorough)]
)
@pytest.mark.parametrize("preset", ["judge", "judge-any-corner"])
def test_scenes_are_within_the_wanted_error_and_none_is_brighter_or_darker(
    make_dataset, variant, preset, count
):
    dataset = make_dataset(read_settings("presets", preset)[0] | {"dataset": {"count": count, "seed": 31}})
    scenes = [dataset.scene(scene_id) for scene_id in dataset.ids()]
    expected = [hidden_of(dataset, scene_id, variant) for scene_id in dataset.ids()]
    for wanted in (0.04, 0.01):
        found = BatchedLight(HZ, WIDTH, HEIGHT, error=wanted, device="cpu").images(scenes).hidden
        pairs = list(zip(found, expected, strict=True))
        errors = np.array([norm(a - b) / norm(b) for a, b in pairs])
        scales = [np.vdot(b, a).real / np.vdot(b, b).real for a, b in pairs]
        allowed = 0.05 * count + 2 * (0.05 * 0.95 * count) ** 0.5  # 5 % and two standard deviations
        assert np.count_nonzero(errors > np.hypot(wanted, REFERENCE)) <= allowed
        # 0.3 %, and two standard errors of the mean of scales that scatter by half the wanted error
        assert abs(np.mean(scales) - 1) < 0.003 + wanted / count**0.5
