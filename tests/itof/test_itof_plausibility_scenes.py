"""Valid measurements of many kinds of scenes are not suspected, and every defect of each is found."""

import numpy as np
import pytest
from wall_measurements import DEFECTS, expected_wall_of, noise, phasors_of

from itof.wall.plausibility import check_measurement

SMALL = {"width": 40, "height": 30}
NEAR = {"location_m": {"x": [0.75, 1.0], "y": [0.6, 0.9], "z": [1.45, 1.85]}}
LARGE = {"size_m": {"sphere": [0.9, 0.9, 0.9], "cube": [0.7, 0.7, 0.7]}}
AT_RIGHT = {"horizontal_fov_deg": 45.0, "location_m": [1.3, -1.2, 1.5], "rotation_deg": [85.0, 0.0, 60.0]}
PRESETS = {
    "demo": {"dataset": {"count": 7}, "camera": SMALL},
    "larger image": {"dataset": {"count": 7, "seed": 1}, "camera": {"width": 80, "height": 60}},
    "bright hidden light": {"dataset": {"count": 7}, "camera": SMALL, "hidden_object": NEAR | LARGE},
    "faint, and the wall ends in the image": {
        "dataset": {"count": 7},
        "camera": {"width": 48, "height": 27, "horizontal_fov_deg": 75.0},
        "hidden_object": {"reflectance": 0.1},
    },
    "another camera": {"dataset": {"count": 7}, "camera": {"width": 30, "height": 40} | AT_RIGHT},
    "a diffuse wall at five frequencies": {
        "dataset": {"count": 7},
        "camera": SMALL,
        "relay_wall": {"material": "diffuse"},
        "itof": {"frequencies_hz": [20e6, 50e6, 60e6, 80e6, 100e6]},
    },
    "two frequencies": {"dataset": {"count": 7}, "camera": SMALL, "itof": {"frequencies_hz": [15e6, 70e6]}},
    "one frequency": {"dataset": {"count": 7}, "camera": SMALL, "itof": {"frequencies_hz": [20e6]}},
}
IN_CI = ("demo", "faint, and the wall ends in the image", "one frequency")
# Told by any number of frequencies.
ALWAYS = {
    *("noise", "random phases", "ones", "one phase", "darkness", "no amplitude", "conjugated", "negative"),
    *("real and imaginary exchanged", "real part negative", "quarter turn", "columns", "half a turn"),
    *("column by column", "5 cm farther", "5 cm nearer", "much noise"),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name in IN_CI else pytest.mark.thorough)
        for name in PRESETS
    ],
)
def test_valid_measurements_are_not_suspected_and_defects_are_found(make_dataset, variant, name):
    from render.options import ManyLightOptions
    from render.rendering import Renderer
    from render.settings import RenderSettings

    dataset = make_dataset(PRESETS[name])
    settings = RenderSettings(product="itof", options=ManyLightOptions(error=0.02), device="cpu")
    renderer = Renderer(dataset, settings)
    for scene_id in dataset.ids():
        renderer.render(scene_id)
    wall = expected_wall_of(dataset)
    for index, scene_id in enumerate(dataset.ids()):
        z = phasors_of(dataset, scene_id)
        grain = noise(z.shape, index)
        for valid in (z, z * (1 + 0.01 * grain), z + 0.01 * np.abs(z).mean() * grain):
            assert check_measurement(valid, wall).findings == (), scene_id
        for defect in DEFECTS if z.shape[-1] == 3 else ALWAYS:
            spoil, code, words = DEFECTS[defect]
            with np.errstate(invalid="ignore"):  # the phase of a dark pixel
                spoilt = np.nan_to_num(np.ascontiguousarray(spoil(z, wall)))
            findings = check_measurement(spoilt, wall).findings
            text = f"{defect}, {scene_id}: {findings}"
            assert any(finding.refused for finding in findings), text
            if name != "bright hidden light":  # where an offset of 20 mrad may pass for another wall
                assert code in [finding.code for finding in findings], text
                assert words in text
