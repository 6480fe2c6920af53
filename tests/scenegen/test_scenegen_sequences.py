"""Sequences: one object on a path, all else drawn once; and objects that fit nowhere, refused by name."""

from dataclasses import replace

import numpy as np
import pytest
from night_commands import night_here, refusal
from scene_folders import contents

from disk import PresetError
from scenegen import SamplingError, open_dataset, preset_from_dict
from scenegen.corner_check import refuse_impossible_corner
from scenegen.geometry_check import refusal as geometry_refusal
from scenegen.possible_scenes import possible_scenes
from scenegen.sampling import sample_scene

PATH_M = [[1.0, 0.7, 1.6], [1.2, 0.9, 1.7], [1.2, 1.1, 1.5]]
STILL = {"x": 0, "y": 0, "z": 0}
SMALL = {"shape": "cube", "size_m": 1e-3, "rotation_deg": STILL}
MOVING = """
[dataset]
count = 5
frame_rate_hz = 10
[[object]]
shape = "sphere"
size_m = 0.2
path_m = [[1.0, 0.7, 1.6], [1.2, 1.1, 1.6]]
"""


def sequence(table, count=9, rate_hz=10, **others):
    dataset = {"count": count, "frame_rate_hz": rate_hz}
    return preset_from_dict({"dataset": dataset, "object": [table], **others}, "a test")


def test_an_object_is_on_its_path_at_equal_steps_of_time_and_all_else_is_drawn_once():
    table = {
        "shape": "cube",
        "size_m": 0.2,
        "path_m": PATH_M,
        "path_deg": [[0, 0, -90], [0, 0, 90]],
        "beside": [{"shape": "sphere", "size_m": 0.1, "offset_m": {"y": [0.2, 0.3]}}],
    }
    preset = sequence(
        table,
        camera_spread={"location_m": 0.02},
        hidden_object={"least_reflectance": 0.2, "size_factor": [0.8, 1.2]},
        relay_wall={"least_reflectance": 0.5},
    )
    scene = possible_scenes(preset, geometry_refusal)
    frames = [scene(index) for index in range(9)]
    cubes, spheres = zip(*(frame.hidden_objects for frame in frames), strict=True)
    for axis in range(3):  # waypoints at frames 0, 4 and 8
        expected = np.interp(range(9), [0, 4, 8], [place[axis] for place in PATH_M])
        np.testing.assert_allclose([cube.location_m[axis] for cube in cubes], expected, rtol=1e-15)
    assert [cubes[frame].location_m for frame in (0, 4, 8)] == [tuple(place) for place in PATH_M]
    turns = [cube.rotation_deg[2] for cube in cubes]
    np.testing.assert_allclose(turns, np.linspace(-90, 90, 9), rtol=1e-15)
    offsets = [np.subtract(s.location_m, c.location_m) for s, c in zip(spheres, cubes, strict=True)]
    np.testing.assert_allclose(offsets, [offsets[0]] * 9, atol=1e-15)
    still = [
        (f.camera, f.emitter, f.relay_wall, f.attempt, c.size_m, c.reflectance, s.rotation_deg, s.size_m)
        for f, c, s in zip(frames, cubes, spheres, strict=True)
    ]
    assert still == [still[0]] * 9
    assert {frame.split for frame in frames} == {"test"}
    assert len({frame.seed for frame in frames}) == 9  # the renderer's noise is not drawn once
    assert preset.places_m.z == (1.5, 1.7)
    other = possible_scenes(replace(preset, dataset=replace(preset.dataset, seed=1)), geometry_refusal)(0)
    assert other.camera != frames[0].camera


def test_two_objects_have_paths_of_their_own():
    other_m, turns_deg = [[1.2, 1.2, 1.9], [1.0, 1.0, 1.9]], [[0, 0, 0], [0, 0, 80]]
    beside = SMALL | {"path_m": other_m, "path_deg": turns_deg}
    del beside["rotation_deg"]
    preset = sequence(
        SMALL | {"path_m": PATH_M, "beside": [beside]}, hidden_object={"size_factor": [0.5, 0.6]}
    )
    frames = [sample_scene(preset, index).hidden_objects for index in range(9)]
    for which, path_m in ((0, [PATH_M[0], PATH_M[-1]]), (1, other_m)):
        assert [frames[place][which].location_m for place in (0, 8)] == [tuple(each) for each in path_m]
    middle = frames[4][1]
    np.testing.assert_allclose([*middle.location_m, *middle.rotation_deg], [1.1, 1.1, 1.9, 0, 0, 40])


def test_a_draw_must_fit_all_frames():
    # A bar of 0.6 m near the edge of the shadow: only some turns of it stay hidden along the path.
    near = [[0.68, 0.9, 1.6], [1.2, 0.9, 1.6]]
    preset = sequence({"shape": "parallelepiped", "size_m": 0.6, "path_m": near}, count=5)
    scene = possible_scenes(preset, geometry_refusal)
    frames = [scene(index) for index in range(5)]
    assert [geometry_refusal(frame) for frame in frames] == [None] * 5
    (attempt,) = {frame.attempt for frame in frames}
    assert attempt > 0
    for earlier in range(attempt):
        refused = [geometry_refusal(sample_scene(preset, index, earlier)) for index in range(5)]
        assert any(refused)


@pytest.mark.parametrize(
    ("path_m", "words"),
    [
        # From the camera at (1, -1), the middle wall's edge at (0.7, 0) hides a point (x, 0.6) if x > 0.52.
        (
            [[1.01, 0.6, 1.6], [0.21, 0.6, 1.6]],
            r"frame 000025, 2.5 s .* cube \S+ shows beside the middle wall",
        ),
        # x = 1.01 - 0.06 i is below the clearance of 1 mm plus half a side first at i = 17.
        ([[1.01, 3.0, 1.6], [-1.39, 3.0, 1.6]], r"frame 000017, 1.7 s .* cube \S+ reaches through the relay"),
    ],
)
def test_a_path_into_view_or_through_a_wall_is_refused_with_its_first_impossible_frame(path_m, words):
    wall = {"size_m": [4.6 if "relay" in words else 3.3, 4.0], "location_m": [2.35, 0.0, 2.0]}
    with pytest.raises(SamplingError, match=words):
        refuse_impossible_corner(sequence(SMALL | {"path_m": path_m}, count=41, middle_wall=wall))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"object": [SMALL | {"path_m": PATH_M}]}, "give dataset.frame_rate_hz, too"),
        ({"dataset": {"frame_rate_hz": 10}}, r"give one table \[\[object\]\]"),
        ({"dataset": {"frame_rate_hz": 10}, "object": [SMALL, SMALL]}, r"give one table \[\[object\]\]"),
        (
            {"dataset": {"frame_rate_hz": 10}, "object": [SMALL], "hidden_object": {"empty_fraction": 0.1}},
            "no hidden_object.empty_fraction",
        ),
        ({"dataset": {"frame_rate_hz": 0}, "object": [SMALL]}, "frame_rate_hz must be 0.001 to 1e.06 Hz"),
        ({"object": [SMALL | {"path_deg": [[0, 0, 0]] * 2}]}, "give path_deg or rotation_deg, not both"),
        ({"object": [SMALL | {"beside": [SMALL | {"path_m": PATH_M}]}]}, "give dataset.frame_rate_hz, too"),
        (
            {"object": [SMALL | {"beside": [SMALL | {"path_m": PATH_M, "offset_m": {"y": 1}}]}]},
            "give path_m or offset_m, not both",
        ),
        ({"object": [{"shape": "cube", "path_m": [[1, 1, 1]]}]}, "path_m"),
        ({"object": [{"shape": "cube", "path_m": [[1, 1], [1, 1]]}]}, "path_m"),
    ],
)
def test_impossible_sequences_are_refused_by_key(data, words):
    with pytest.raises(PresetError, match=words):
        preset_from_dict(data, "a test")


def test_a_sequence_is_made_again_with_the_same_bytes_and_its_number_of_frames_stays(tmp_path):
    (tmp_path / "moving.toml").write_text(MOVING)
    command = ["night-gen", "scenes", tmp_path / "data", "--preset", tmp_path / "moving.toml"]
    made = []
    for _ in range(2):
        done = night_here(*command)
        assert done.returncode == 0, done.stderr
        made.append(contents(tmp_path / "data"))
    assert "5 scenes in" in done.stdout
    assert "0 train, 0 validation, 5 test" in done.stdout
    assert "leak" not in done.stderr
    assert made[0] == made[1]
    meshes = {made[0][f"scenes/{index:06d}/relay_wall.ply"] for index in range(5)}
    assert len(meshes) == 1
    dataset = open_dataset(tmp_path / "data")
    assert [dataset.scene(name).hidden_objects[0].location_m[0] for name in dataset.ids()] == pytest.approx(
        [1.0, 1.05, 1.1, 1.15, 1.2]
    )
    assert "of another preset, seed or number of frames" in refusal(*command, "--count", 9)
    again = night_here(*command, "--count", 3, "--replace", "--yes")
    assert again.returncode == 0, again.stderr
    dataset = open_dataset(tmp_path / "data")
    assert [dataset.scene(name).hidden_objects[0].location_m[0] for name in dataset.ids()] == pytest.approx(
        [1.0, 1.1, 1.2]
    )


def test_an_object_of_one_of_several_tables_that_fits_nowhere_is_refused_before_anything_is_made(tmp_path):
    fits = '[[object]]\nshape = "sphere"\nsize_m = 0.2\n'
    large = '[[object]]\nshape = "cone"\nsize_m = 0.2\n[[object.beside]]\nshape = "cube"\nsize_m = 2.5\n'
    (tmp_path / "my.toml").write_text(f"[dataset]\ncount = 6\n{fits}{fits}{large}")
    for command in (("scenes", tmp_path / "out", "--preset"), ("corner", "--out", tmp_path / "c.png")):
        done = night_here("night-gen", *command, tmp_path / "my.toml")
        assert done.returncode == 2
        assert "scene 2: none of 1000 draws fits the room (the last: cube (hidden_object_1) " in done.stderr
    assert not (tmp_path / "out").exists()
    refuse_impossible_corner(preset_from_dict({"object": [{"shape": "sphere"}]}, "a test"))
    unread = preset_from_dict({"object": [{"file": "a.ply", "size_m": 0.4}]}, "a test")
    refuse_impossible_corner(unread)  # where a mesh is not read, it is not judged
