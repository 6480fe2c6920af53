"""Scenes without an object, and objects of other sizes: the batched engine, many lights, files and checks."""

import numpy as np
import pytest
from night_commands import night_here
from numpy.linalg import norm
from ring_scenes import RING, scenes_with_rings

from itof import DepthMap, read_image
from render.batch.light import BatchedLight
from render.rendering import Renderer
from render.settings import settings_for
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, open_dataset, preset_from_dict
from scenegen.geometry_check import refusal
from scenegen.possible_scenes import sample_valid_scene

TABLES = {
    "dataset": {"count": 6, "seed": 1},
    "camera": {"width": 32, "height": 24},
    "transient": {"bin_count": 400, "bin_width_m": 0.05},
    "ground_truth": {"mirror_occluders": True},
    "hidden_object": {
        "shapes": ["cube", RING],
        "composite_fraction": 0.34,
        "size_factor": [0.3, 2.0],
        "empty_fraction": 0.4,
    },
}
LIGHTS = 0.02  # error of the many-light renders


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Folder of two empty corners, two cubes or rings of other sizes and two composites."""
    return scenes_with_rings(tmp_path_factory.mktemp("sizes"), TABLES).root


@pytest.fixture(scope="module")
def rendered(scenes):
    """The records of many-light renders by id; the dataset has transients, too."""
    dataset = open_dataset(scenes)
    given = {"device": "cpu", "method": "many-light", "product": "both", "error": LIGHTS}
    made = Renderer(dataset, settings_for(dataset, given)).render_all(dataset.ids())
    return dict(zip(dataset.ids(), made, strict=True))


@pytest.fixture(scope="module")
def light():
    return BatchedLight((20e6, 50e6, 60e6), 32, 24, error=0.03, device="cpu")


def of_class(dataset, *, empty):
    return [each for each in dataset.ids() if (dataset.scene(each).hidden_objects == ()) == empty]


def test_the_engine_has_the_light_of_objects_of_any_size_and_none_of_empty_corners(scenes, rendered):
    dataset = open_dataset(scenes)
    given = settings_for(dataset, {"device": "cpu", "product": "itof", "error": 0.03, "method": "batched"})
    engine = Renderer(dataset, given)
    sources = [engine._read(each) for each in dataset.ids()]
    found = engine._lights(sources)
    assert found.keys() == set(dataset.ids())  # none is left to many lights
    for each, made in found.items():
        image = read_image(dataset.render_folder(each) / MEASUREMENT_FILE)
        truth = DepthMap.read(dataset.render_folder(each) / GROUND_TRUTH_FILE)
        hidden, _ = image.phasors("hidden")
        np.testing.assert_array_equal(made.radial_depth_m > 0, truth.mask)
        if dataset.scene(each).hidden_objects:
            assert norm(made.hidden - hidden) / norm(hidden) < np.hypot(0.03, LIGHTS)  # the errors of both
            assert truth.mask.any()
        else:
            for nothing in (made.hidden, hidden, truth.mask, truth.phasor):
                assert not nothing.any()
            assert np.array_equal(image.phasors()[0], image.phasors("direct")[0])
            assert made.error == 0


def test_an_empty_corner_is_the_same_alone_and_beside_objects(light):
    preset = preset_from_dict({"hidden_object": {"empty_fraction": 0.5, "size_factor": [0.5, 1.5]}}, "x")
    scenes = [sample_valid_scene(preset, index, refusal) for index in range(4)]
    assert [bool(scene.hidden_objects) for scene in scenes] == [False, True] * 2
    together = light.images(scenes)
    for place, scene in enumerate(scenes):
        alone = light.images([scene])
        for name in ("direct", "hidden", "radial_depth_m", "error"):
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[place]), name


def test_files_of_empty_corners_are_checked_and_drawn_like_all_others(scenes, rendered, tmp_path):
    dataset = open_dataset(scenes)
    empty, *_ = of_class(dataset, empty=True)
    assert night_here("night-render", "verify", scenes).stdout.startswith("6 scenes checked: 6 good")
    drawn = night_here("night-render", "plot", scenes, empty, "--out", tmp_path / "plot.png")
    assert ": 0 of the light is hidden light" in drawn.stdout
    with_light, *_ = of_class(dataset, empty=False)
    mesh = dataset.scene_folder(with_light) / "hidden_object_0.ply"
    moved = tmp_path / "hidden_object_0.ply"
    mesh.rename(moved)
    try:
        found = night_here("night-render", "verify", scenes)
        assert found.returncode == 1  # a mesh that is missing does not make an empty corner
    finally:
        moved.rename(mesh)
