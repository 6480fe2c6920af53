"""Presets and sampling: the contract of keys, the paper's counts, and independence of order and number."""

from collections import Counter

import matplotlib.pyplot as plt
import numpy as np
import pytest

from disk import PresetError
from scenegen import (
    Preset,
    SamplingError,
    camera_axes,
    leaks,
    load_preset,
    preset_from_dict,
    sample_scene,
    sample_valid_scene,
    scene_from_json,
    scene_to_json,
)
from scenegen.plan import plot_plan


@pytest.fixture(scope="module")
def paper_scenes(paper):
    return [sample_scene(paper, index) for index in range(1344)]


def test_every_key_defaults_to_the_papers_value(paper):
    assert preset_from_dict({}, "empty") == paper == Preset()


def test_the_paper_has_192_scenes_of_each_class_split_1075_to_269(paper_scenes):
    assert set(Counter(scene.object_class for scene in paper_scenes).values()) == {192}
    splits = Counter(scene.split for scene in paper_scenes)
    assert splits == {"train": 860, "validation": 215, "test": 269}
    tests = Counter(scene.object_class for scene in paper_scenes if scene.split == "test")
    assert set(tests.values()) <= {38, 39}


def test_no_test_object_shares_its_location_or_orientation_with_another_split(paper_scenes):
    assert leaks(paper_scenes) == []


def test_a_leak_is_found():
    preset = preset_from_dict(
        {
            "dataset": {"count": 14},
            "hidden_object": {"location_m": {"x": [1, 1], "y": [1, 1], "z": [1.5, 1.5]}},
        },
        "fixed place",
    )
    found = leaks(sample_scene(preset, index) for index in range(14))
    assert found
    assert "location_m" in found[0]


def test_a_scene_is_the_same_whether_20_or_20000_are_made():
    few = preset_from_dict({"dataset": {"count": 20}}, "few")
    many = preset_from_dict({"dataset": {"count": 20_000}}, "many")
    assert [sample_scene(few, i) for i in range(20)] == [sample_scene(many, i) for i in range(20)]


def test_seed_zero_is_a_seed_and_other_seeds_give_other_scenes():
    zero, one = (preset_from_dict({"dataset": {"seed": seed}}, "seeds") for seed in (0, 1))
    places = {sample_scene(preset, 17).hidden_objects[0].location_m for preset in (zero, one)}
    assert len(places) == 2
    assert sample_scene(zero, 17) == sample_scene(zero, 17)


def test_samples_fill_the_ranges_of_the_paper(paper_scenes):
    first = [scene.hidden_objects[0] for scene in paper_scenes]
    for values, (low, high) in [
        ([part.location_m[0] for part in first], (1.0, 1.3)),
        ([part.location_m[1] for part in first], (0.5, 1.3)),
        ([part.location_m[2] for part in first], (1.25, 1.95)),
        ([part.rotation_deg[1] for part in first], (-90.0, 90.0)),
    ]:
        # All of 1344 values miss a hundredth of the range with the probability 0.99^1344 = 1e-6.
        assert low <= min(values) < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < max(values) <= high
        # The mean of 1344 uniform values has the standard deviation (high - low) / sqrt(12 * 1344).
        assert np.mean(values) == pytest.approx((low + high) / 2, abs=5 * (high - low) / np.sqrt(12 * 1344))
    roughness = Counter(scene.relay_wall.roughness for scene in paper_scenes)
    assert sorted(roughness) == [round(0.30 + 0.05 * step, 2) for step in range(15)]


def test_every_split_has_every_roughness(paper, paper_scenes):
    for split in ("train", "validation", "test"):
        seen = {scene.relay_wall.roughness for scene in paper_scenes if scene.split == split}
        assert seen == set(paper.relay_wall.roughness), split


def test_mirrored_objects_are_about_3_m_away(paper, paper_scenes):
    centres_m = np.array([scene.hidden_objects[0].location_m for scene in paper_scenes]) * [-1, 1, 1]
    # The centre of the ranges, mirrored at x = 0, is 2.87 m from the camera. Spread across the line of sight
    # adds at most its mean square over twice the distance: (0.09 + 0.64 + 0.49) / 12 / 5.7 = 2 cm. The mean
    # of 1344 distances, which lie within 0.8 m, has a standard deviation below 1 cm.
    away_m = np.linalg.norm(centres_m - paper.camera.location_m, axis=1)
    assert away_m.mean() == pytest.approx(np.hypot(2.15, 1.9), abs=0.05)


def test_composites_join_two_different_shapes_within_their_ranges(paper_scenes):
    pairs = [scene.hidden_objects for scene in paper_scenes if scene.object_class == "composite"]
    offsets = np.array([np.subtract(b.location_m, a.location_m) for a, b in pairs])
    turns = np.array([np.subtract(b.rotation_deg, a.rotation_deg) for a, b in pairs])
    assert all(a.shape != b.shape for a, b in pairs)
    assert offsets.min() >= -0.12 - 1e-12
    assert offsets.max() <= 0.15 + 1e-12
    assert np.abs(turns).max() <= 45 + 1e-9


def test_cameras_turn_beyond_a_whole_turn():
    def cameras(z_deg):
        data = {"camera": {"rotation_deg": [90, 0, z_deg]}, "camera_spread": {"rotation_deg": 60}}
        return [sample_scene(preset_from_dict(data, "x"), index).camera for index in range(40)]

    for one, other in zip(cameras(-310), cameras(50), strict=True):
        assert max(map(abs, one.rotation_deg)) <= 360
        np.testing.assert_allclose(camera_axes(one), camera_axes(other), atol=1e-12)
    assert min(one.rotation_deg[2] for one in cameras(-310)) < -350  # some are near the end of the range
    assert max(one.rotation_deg[2] for one in cameras(-310)) > -10  # and some beyond it


def test_a_diffuse_wall_has_no_roughness():
    preset = preset_from_dict({"relay_wall": {"material": "diffuse"}}, "diffuse")
    assert sample_scene(preset, 0).relay_wall.roughness is None


def test_a_mesh_is_a_shape_like_any_other_in_a_box_of_half_a_metre():
    shapes = ["cube", "mesh:animals/bunny.ply", "mesh:../teapot.obj"]
    preset = preset_from_dict({"hidden_object": {"shapes": shapes}}, "meshes")
    scenes = [sample_scene(preset, index) for index in range(70)]
    assert set(Counter(scene.object_class for scene in scenes)) == {*shapes, "composite"}
    parts = [part for scene in scenes for part in scene.hidden_objects]
    assert {part.size_m for part in parts} == {(0.5, 0.5, 0.5)}  # the paper's cube has that size too
    for scene in scenes:
        assert scene_from_json(scene_to_json(scene), "here") == scene


def test_scene_json_round_trips(paper_scenes):
    for scene in paper_scenes[:20]:
        assert scene_from_json(scene_to_json(scene), "here") == scene


def test_a_refused_sample_is_replaced_by_the_next_of_its_own_stream(paper):
    refused = sample_scene(paper, 4)
    kept = sample_valid_scene(paper, 4, lambda scene: "no" if scene == refused else None)
    assert kept == sample_scene(paper, 4, attempt=1)
    assert kept.hidden_objects != refused.hidden_objects
    assert (kept.object_class, kept.split, kept.seed) == (refused.object_class, refused.split, refused.seed)


def test_a_preset_without_room_is_refused_by_reason(paper):
    with pytest.raises(SamplingError, match=r"scene 4: none of 1000 draws fits the room .* too big"):
        sample_valid_scene(paper, 4, lambda scene: "too big")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"dataset": {"cuont": 5}}, "unknown key dataset.cuont"),
        ({"lens": {}}, "unknown key lens"),
        ({"hidden_object": {"location_m": {"w": [0, 1]}}}, "unknown key hidden_object.location_m.w"),
        ({"camera": {"width": 3.5}}, "camera.width"),
        ({"camera": {"width": "320"}}, "camera.width"),
        ({"camera": 3}, "camera"),
        ({"dataset": {"count": 0}}, "dataset.count"),
        ({"dataset": {"test_fraction": 1.5}}, "dataset.test_fraction"),
        ({"hidden_object": {"location_m": {"x": [2, 1]}}}, "hidden_object.location_m.x: range .* is empty"),
        ({"hidden_object": {"location_m": {"x": [1]}}}, "hidden_object.location_m.x"),
        ({"hidden_object": {"shapes": ["teapot"]}}, "hidden_object.shapes.*teapot"),
        ({"hidden_object": {"shapes": ["mesh:"]}}, "name of a mesh file"),
        ({"hidden_object": {"shapes": ["mesh:a\nb.ply"]}}, "name of a mesh file"),
        ({"hidden_object": {"shapes": ["mesh:/home/me/bunny.ply"]}}, "relative to the preset's own folder"),
        ({"hidden_object": {"shapes": ["mesh:C:\\bunny.ply"]}}, "relative to the preset's own folder"),
        ({"hidden_object": {"size_m": {"mesh": 0.0}}}, "hidden_object.size_m.mesh"),
        ({"hidden_object": {"shapes": ["cube"]}, "object": [{"shape": "cube"}]}, "not both"),
        ({"hidden_object": {"shapes": ["cube", "cube"]}}, "twice"),
        ({"relay_wall": {"material": "velvet"}}, "relay_wall.material"),
        ({"relay_wall": {"roughness": [0.0]}}, "relay_wall.roughness"),
        ({"transient": {"bin_width_m": float("nan")}}, "transient.bin_width_m"),
        ({"itof": {"frequencies_hz": [50e6, 20e6]}}, "ascend"),
        ({"itof": {"frequencies_hz": [0.1]}}, "itof.frequencies_hz"),
        ({"itof": {"frequencies_hz": [15e9]}}, "itof.frequencies_hz.0 must be 1e\\+06 to 1e\\+10 Hz"),
        ({"transient": {"bin_width_m": 2.5}}, "itof.frequencies_hz must stay below 59.9585 MHz"),
        ({"transient": {"bin_width_m": 1e-300}}, "transient.bin_width_m"),
        ({"transient": {"bin_count": 10_000_001}}, "transient.bin_count"),
        ({"transient": {"bin_count": 6_710_887}}, "camera.width times transient.bin_count"),
        ({"transient": {"start_opl_m": 1e9}}, "transient.start_opl_m"),
        ({"dataset": {"count": 1_000_001}}, "dataset.count"),
        ({"dataset": {"seed": 2**63}}, "dataset.seed"),
        ({"camera": {"height": 10**12}}, "camera.height"),
        ({"camera": {"horizontal_fov_deg": 179.9}}, "camera.horizontal_fov_deg"),
        ({"camera": {"location_m": [1e38, 0, 0]}}, "camera.location_m.0"),
        ({"camera": {"rotation_deg": [0, 361, 0]}}, "camera.rotation_deg.1"),
        (
            {"camera": {"location_m": [0, -999, 1]}, "camera_spread": {"location_m": 1.5}},
            "camera_spread.location_m moves camera.location_m out of -1000 to 1000 metres",
        ),
        ({"relay_wall": {"size_m": [4, 1e300]}}, "relay_wall.size_m.1"),
        ({"middle_wall": {"location_m": [0, 0, -1001]}}, "middle_wall.location_m.2"),
        ({"hidden_object": {"location_m": {"x": [0, 1e300]}}}, "hidden_object.location_m.x.1"),
        ({"hidden_object": {"rotation_deg": {"x": [-1e9, 0]}}}, "hidden_object.rotation_deg.x.0"),
        ({"hidden_object": {"composite_offset_m": [-1e9, 0]}}, "hidden_object.composite_offset_m.0"),
        ({"hidden_object": {"composite_rotation_deg": [0, 400]}}, "hidden_object.composite_rotation_deg.1"),
        ({"hidden_object": {"size_m": {"cube": [1e-300, 1, 1]}}}, "hidden_object.size_m.cube.0"),
    ],
)
def test_a_preset_against_the_contract_is_refused_by_name(data, words):
    with pytest.raises(PresetError, match=words):
        preset_from_dict(data, "my.toml")


def test_a_frequency_is_refused_from_exactly_half_the_speed_of_light_over_the_bin_width():
    def preset_with(frequency_hz):
        return preset_from_dict(
            {"transient": {"bin_width_m": 0.5}, "itof": {"frequencies_hz": [frequency_hz]}}, "my.toml"
        )

    assert preset_with(np.nextafter(299_792_458.0, 0)).itof.frequencies_hz[0] < 299_792_458.0
    with pytest.raises(PresetError, match="must stay below"):
        preset_with(299_792_458.0)


def test_a_missing_preset_names_those_there_are():
    with pytest.raises(PresetError, match=r"no preset nowhere.*demo.*paper"):
        load_preset("nowhere")


def test_a_file_that_is_no_toml_is_refused(tmp_path):
    (tmp_path / "bad.toml").write_text("[dataset\ncount = 3")
    with pytest.raises(PresetError, match="cannot be read as TOML"):
        load_preset(str(tmp_path / "bad.toml"))


@pytest.mark.parametrize("text", [f"a = 0x{'F' * 4000}", f"[{'.'.join('a' * 2000)}]"], ids=["long", "deep"])
def test_toml_that_is_no_json_is_refused(tmp_path, text):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(PresetError, match=f"{file}: "):
        load_preset(file)


def test_from_above_every_object_is_where_its_scene_has_it(paper_scenes):
    scenes = paper_scenes[:40]
    figure = plot_plan(scenes)
    plt.close(figure)
    lines = {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
    assert set(lines) == {
        "relay wall",
        "lit and seen",
        "middle wall",
        "camera",
        *(s.object_class for s in scenes),
    }
    spheres = [s.hidden_objects[0].location_m[:2] for s in scenes if s.object_class == "sphere"]
    np.testing.assert_array_equal(lines["sphere"], spheres)
    (x, y), *_ = lines["camera"]
    assert (x, y) == scenes[0].camera.location_m[:2]
    assert np.abs(lines["lit and seen"][:, 0]).max() < 1e-9  # on the relay wall, in the plane x = 0
