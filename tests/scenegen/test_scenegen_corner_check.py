"""Corners that cannot be are refused before anything is made, each by name, with numbers and what to do."""

from dataclasses import replace
from functools import partial

import pytest
import trimesh
from night_commands import refusal

from disk.preset_files import PresetError
from scenegen import load_preset, make_dataset, preset_from_dict, sample_scene
from scenegen.corner_check import refuse_impossible_corner
from scenegen.geometry_check import refusal as refusal_of
from scenegen.making.meshes import with_meshes
from scenegen.possible_scenes import sample_valid_scene

# In the paper's corner, the middle wall is 3.3 m wide, in the plane y = 0; the relay wall is in x = 0.
IMPOSSIBLE = {
    "walls that cross": (
        {"middle_wall": {"location_m": [1.6, 0.0, 2.0]}},
        r"the middle wall crosses the relay wall and reaches 0.05 m behind it: .* smaller middle_wall.size_m",
    ),
    "a closed gap": (
        {"middle_wall": {"location_m": [1.65, 0.0, 2.0]}},
        r"the middle wall touches the relay wall, so that there is no gap .*: move middle_wall.location_m",
    ),
    "a camera behind the wall": (
        {"camera": {"location_m": [-0.5, -1.0, 1.65]}},
        r"camera.location_m is 0\.5 m behind the front of the relay wall, .*: move the camera or turn",
    ),
    "cameras that are moved behind the wall": (
        {"camera": {"location_m": [0.2, -1.0, 1.65]}, "camera_spread": {"location_m": 0.3}},
        r"camera.location_m, moved by camera_spread.location_m, is 0\.1 m behind the front of the relay wall",
    ),
    "a camera beside the wall": (
        {"camera": {"location_m": [1.0, -9.0, 1.65], "rotation_deg": [90.0, 0.0, 90.0]}},
        r"its axis meets the plane of the wall 0.35 m and 9 m from the middle .* ends at 2 m and 4 m: turn",
    ),
    "a camera that is turned away": (
        {"camera": {"rotation_deg": [90.0, 0.0, 230.0]}},
        r"sees nothing of the relay wall, because its axis is 140 degrees from the direction",
    ),
    "a camera behind the middle wall": (
        {"middle_wall": {"rotation_deg": [90.0, 0.0, 90.0], "location_m": [0.5, -1.0, 2.0]}},
        "the middle wall hides all of the relay wall from the camera: move middle_wall.location_m",
    ),
    "a projector that is turned away": (
        {"projector": {"rotation_deg": [90.0, 0.0, 230.0]}},
        "the projector lights nothing of the relay wall that the camera sees",
    ),
    "a region that no lit point sees": (
        {"camera": {"rotation_deg": [90, 0, 130]}, "middle_wall": {"location_m": [1.7, 0, 2]}},
        r"no lit point of the relay wall sees the region .* edge is 0.05 m from the relay wall, hides it",
    ),
    "objects behind the relay wall": (
        {"hidden_object": {"location_m": {"x": [-1.0, -0.3]}}},
        r"hidden_object.location_m is at least 0.3 m behind the front of the relay wall: move it",
    ),
    "objects in view of the camera": (
        {"hidden_object": {"location_m": {"y": [-0.9, -0.5]}}},
        r"the camera at \[1.0, -1.0, 1.65\] sees every place of hidden_object.location_m beside the middle",
    ),
    "a camera in the middle wall": (
        {"camera": {"location_m": [1.0, 0.0, 1.65]}},
        r"the camera at \[1.0, 0.0, 1.65\] is in the plane of the middle wall, which hides nothing",
    ),
    "a camera on the relay wall": (
        {"camera": {"location_m": [0.0, -1.0, 1.65]}},
        r"camera.location_m is 0 m behind the front of the relay wall",
    ),
    "objects in view of the projector": (
        {"projector": {"location_m": [1.0, 2.5, 1.65], "rotation_deg": [90.0, 0.0, 130.0]}},
        r"the projector at \[1.0, 2.5, 1.65\] sees every place of hidden_object.location_m",
    ),
}


@pytest.mark.parametrize(("tables", "words"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_corners_are_refused_by_name(tables, words):
    with pytest.raises(PresetError, match=words):
        refuse_impossible_corner(preset_from_dict(tables, "test"))


def test_the_commands_and_python_refuse_them_before_they_write_anything(closed_form_scenes, tmp_path):
    preset = tmp_path / "closed.toml"
    preset.write_text("[middle_wall]\nlocation_m = [1.6, 0.0, 2.0]\n")
    said = refusal("night-gen", "scenes", tmp_path / "data", "--preset", preset)
    assert said.startswith("the middle wall crosses the relay wall and reaches 0.05 m behind it")
    fresh = ("night-train", closed_form_scenes.root, "--fresh", preset, "--out", tmp_path / "run")
    assert "crosses the relay wall" in refusal(*fresh)
    with pytest.raises(PresetError, match="crosses the relay wall"):
        make_dataset(tmp_path / "data", preset, progress=False)
    assert list(tmp_path.iterdir()) == [preset]


@pytest.mark.parametrize(
    "name", ["paper", "demo", "judge", "train", "any-corner", "judge-any-corner", "generalist"]
)
def test_every_corner_of_the_presets_is_possible(name):
    """Also those of random cameras, as if each were the only one."""
    preset = load_preset(name)
    refuse_impossible_corner(preset)
    one_corner = replace(preset, camera_spread=type(preset.camera_spread)())
    for index in range(0 if preset.is_one_corner else 60):
        refuse_impossible_corner(replace(one_corner, camera=sample_scene(preset, index).camera))


def test_light_may_also_go_over_a_wall_that_leaves_no_gap():
    low = {"size_m": [3.3, 1.3], "location_m": [1.65, 0.0, 0.65]}
    hidden = {"location_m": {"z": [0.3, 0.5]}, "shapes": ["cube"], "composite_fraction": 0.0}
    hidden |= {"size_m": {"cube": [0.2, 0.2, 0.2]}}
    camera = {"location_m": [1.0, -1.0, 0.5], "rotation_deg": [100.0, 0.0, 50.0]}
    preset = preset_from_dict({"middle_wall": low, "hidden_object": hidden, "camera": camera}, "test")
    refuse_impossible_corner(preset)
    sample_valid_scene(preset, 0, refusal_of)


def test_light_on_a_part_of_the_region_is_enough():
    """The places that the camera sees and those in the dark are most of this region."""
    tables = {
        "middle_wall": {"size_m": [3.4, 2.1], "location_m": [2.0, 0.0, 2.0]},
        "camera": {"location_m": [0.4, -1.5, 1.6], "rotation_deg": [90, 0, 65], "horizontal_fov_deg": 40},
        "hidden_object": {
            "location_m": {"x": [0.3, 1.7], "y": [0.2, 1.5], "z": [1.6, 1.6]},
            "size_m": {"cube": [0.2, 0.2, 0.2]},
        },
    }
    tables["hidden_object"] |= {"shapes": ["cube"], "composite_fraction": 0.0}
    preset = preset_from_dict(tables, "test")
    refuse_impossible_corner(preset)
    sample_valid_scene(preset, 0, refusal_of)


def test_of_cameras_that_are_spread_the_one_in_the_middle_may_see_the_region():
    """It sees past the edge of the middle wall, and cameras that are farther from the relay wall do not."""
    hidden = {"location_m": {"x": [0.55, 0.58], "y": [0.3, 0.3]}, "size_m": {"cube": [0.05, 0.05, 0.05]}}
    hidden |= {"shapes": ["cube"], "composite_fraction": 0.0}
    with pytest.raises(PresetError, match="sees every place"):
        refuse_impossible_corner(preset_from_dict({"hidden_object": hidden}, "test"))
    spread = preset_from_dict({"hidden_object": hidden, "camera_spread": {"location_m": 0.5}}, "test")
    refuse_impossible_corner(spread)
    sample_valid_scene(spread, 0, refusal_of)


def test_a_spot_is_enough_light():
    spot = {"horizontal_fov_deg": 0.05, "rotation_deg": [90.0, 0.0, 62.0], "dots": [1, 1]}
    refuse_impossible_corner(preset_from_dict({"projector": spot}, "test"))


@pytest.mark.parametrize("gap_m", [0.01, 0.1])
def test_a_narrow_gap_is_a_gap(gap_m):
    refuse_impossible_corner(
        preset_from_dict({"middle_wall": {"location_m": [1.65 + gap_m, 0.0, 2.0]}}, "test")
    )


def test_the_centre_of_a_meshs_box_may_be_in_view(tmp_path):
    """Half of this tetrahedron's box is empty, and the middle of the box is not in the tetrahedron."""
    places = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    corner = trimesh.Trimesh(places, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    corner.export(tmp_path / "tetrahedron.ply")
    shapes = {"shapes": ["mesh:tetrahedron.ply"], "composite_fraction": 0.0}
    place = {"location_m": {"x": [1.15, 1.15], "y": [-0.02, -0.02], "z": [1.6, 1.6]}}
    preset = preset_from_dict({"hidden_object": shapes | place | {"size_m": {"mesh": 0.3}}}, "test")
    _, meshes = with_meshes(preset, tmp_path)
    refuse_impossible_corner(preset, meshes)
    sample_valid_scene(preset, 0, partial(refusal_of, meshes=meshes))
