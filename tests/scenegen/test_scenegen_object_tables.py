"""The tables [[object]]: sizes, axes, places and reflectances of the user's meshes and of shapes."""

import json
import logging

import numpy as np
import pytest
import trimesh
from night_commands import night_here, refusal

from disk import OutsideError, PresetError
from scenegen import Preset, load_preset, open_dataset, preset_from_dict, sample_scene
from scenegen.depth_range import largest_mirrored_depth_m, largest_radius_m
from scenegen.making.meshes import with_meshes
from scenegen.triangles import scene_triangles

PERSON_CM = (40.0, 180.0, 30.0)  # along x, y, z of the file: y is up
UPRIGHT = {"x": 0, "y": 0, "z": [-90, 90]}


@pytest.fixture
def folder(tmp_path):
    """Folder with a box as tall as a person in centimetres, y up, and the same box as GLB in metres."""
    box = trimesh.creation.box(PERSON_CM)
    box.export(tmp_path / "person.obj")
    box.apply_scale(0.01).export(tmp_path / "person.glb")
    return tmp_path


def read(folder, *tables, **hidden):
    return with_meshes(preset_from_dict({"object": list(tables), "hidden_object": hidden}, "a test"), folder)


def said(caplog, folder, *tables, **hidden):
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        read(folder, *tables, **hidden)
    return [record.getMessage() for record in caplog.records]


def test_a_mesh_has_the_size_of_its_unit_and_stands_on_its_up_axis(folder):
    table = {"file": "person.obj", "unit": "cm", "up": "y"}
    for given in (table, {"file": "person.glb"}):  # GLB: metres, y up
        preset, meshes = read(folder, given)
        (listed,) = preset.object
        assert (listed.size_m, listed.unit, listed.up) == (pytest.approx(1.8), None, "y")
        mesh = meshes[f"mesh:{given['file']}"]
        sides = 1.8 * np.ptp(mesh.vertices, axis=0)
        np.testing.assert_allclose(sides, [0.4, 0.3, 1.8], rtol=1e-6)
        turned = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
        assert turned.volume > 0  # turned and not mirrored: its outside is still outside
        part = sample_scene(preset, 0).hidden_objects[0]
        assert part.size_m == pytest.approx((1.8, 1.8, 1.8))
        assert read(folder, given)[0] == preset
        assert with_meshes(preset, folder)[0] == preset  # as it is in dataset.json


def test_a_mesh_on_its_back_or_in_another_unit_is_noticed_with_its_numbers(folder, caplog):
    table = {"file": "person.obj", "unit": "cm", "rotation_deg": UPRIGHT}
    (back,) = said(caplog, folder, table)
    assert "is 180 long along y and 30 high along z" in back
    assert 'needs up = "y"' in back
    assert said(caplog, folder, table | {"up": "y"}) == []
    assert said(caplog, folder, table | {"up": "z"}) == []
    tumbling = {key: value for key, value in table.items() if key != "rotation_deg"}
    assert said(caplog, folder, tumbling) == []
    (size,) = said(caplog, folder, table | {"up": "y", "unit": "m"})
    assert 'longest side of 180 m: unit = "cm" makes it 1.8 m or unit = "mm" makes' in size
    trimesh.load(folder / "person.glb").apply_scale(1e-3).export(folder / "small.glb")
    (size,) = said(caplog, folder, {"file": "small.glb"})
    assert "longest side of 0.0018 m: give its size_m" in size


def test_objects_have_places_sizes_and_reflectances_of_their_own():
    preset = preset_from_dict(
        {
            "object": [
                {
                    "shape": "cube",
                    "size_m": 0.2,
                    "location_m": {"x": 1.2, "y": [0.9, 1.1], "z": 1.4},
                    "rotation_deg": UPRIGHT,
                    "beside": [
                        {
                            "shape": "cylinder",
                            "size_m": [0.1, 0.2, 1.7],
                            "offset_m": {"y": -0.5},
                            "reflectance": 0.25,
                        }
                    ],
                },
                {"shape": "sphere", "reflectance": 0.5},
            ],
            "hidden_object": {"reflectance": 0.8, "empty_fraction": 0.2},
        },
        "a test",
    )
    scenes = [sample_scene(preset, index) for index in range(50)]
    by_class = {
        name: [s for s in scenes if s.object_class == name] for name in {s.object_class for s in scenes}
    }
    assert {name: len(some) for name, some in by_class.items()} == {
        "cube + cylinder": 20,
        "sphere": 20,
        "no_object": 10,
    }
    for scene in by_class["cube + cylinder"]:
        cube, cylinder = scene.hidden_objects
        assert cube.size_m == pytest.approx((0.2, 0.2, 0.2))
        assert cylinder.size_m == (0.1, 0.2, 1.7)
        assert (cube.location_m[0], cube.location_m[2], *cube.rotation_deg[:2]) == (1.2, 1.4, 0, 0)
        assert 0.9 <= cube.location_m[1] <= 1.1
        np.testing.assert_allclose(
            np.subtract(cylinder.location_m, cube.location_m), [0, -0.5, 0], atol=1e-12
        )
        assert (cube.reflectance, cylinder.reflectance) == (0.8, pytest.approx(0.2))
    assert {scene.hidden_objects[0].reflectance for scene in by_class["sphere"]} == {0.4}
    assert preset.places_m.y == (0.5, 1.3)
    assert preset.shapes == ("cube", "cylinder", "sphere")
    assert largest_radius_m(preset) == pytest.approx(np.hypot(0.2, 1.7) / 2)


def test_the_farthest_depth_is_that_of_an_object_beside_another():
    def farthest_m(offset_m):
        place = {"x": 1.2, "y": 0.9, "z": 1.65}
        beside = [{"shape": "sphere", "size_m": 0.1, "offset_m": {"y": offset_m}}]
        table = {"shape": "sphere", "size_m": 0.1, "location_m": place, "beside": beside}
        return largest_mirrored_depth_m(preset_from_dict({"object": [table]}, "a test"))

    # mirrored at x = 0, the camera is at (-1, -1, 1.65)
    assert farthest_m(0.5) == pytest.approx(np.hypot(2.2, 2.4) + 0.05)
    assert farthest_m(-0.5) == pytest.approx(np.hypot(2.2, 1.9) + 0.05)


def test_one_shape_or_mesh_needs_no_word_about_composites():
    preset = preset_from_dict({"hidden_object": {"shapes": ["cube"]}}, "a test")
    assert {sample_scene(preset, index).object_class for index in range(20)} == {"cube"}
    assert Preset().hidden_object.pair_fraction == Preset().hidden_object.composite_fraction


@pytest.mark.parametrize(
    ("table", "why"),
    [
        ({}, "either a file or a shape"),
        ({"file": "a.ply", "shape": "cube"}, "either a file or a shape"),
        ({"shape": "teapot"}, "no such shape"),
        ({"shape": "cube", "unit": "cm"}, "for a mesh file, not for a shape"),
        ({"file": "a.ply", "unit": "cm", "size_m": 1.0}, "the unit of the mesh or its size_m, not both"),
        ({"file": "a.ply", "size_m": [0.1, 0.2, 0.3]}, "a mesh keeps its shape: size_m is its longest side"),
        ({"shape": "cube", "size_m": [0.1, 0.2]}, r"object\.0\.size_m has too few values: only 2"),
        ({"shape": "cube", "size_m": [0.1, 0.2, -1]}, r"object\.0\.size_m\.2 must be 0\.0001 to 1000 m"),
        ({"shape": "cube", "size_m": -1}, r"object\.0\.size_m must be 0\.0001 to 1000 m"),
        ({"shape": "cube", "size_m": "big"}, r"object\.0\.size_m must be a number"),
        ({"shape": "cube", "size_m": {"x": 1}}, r"object\.0\.size_m must be a number"),
        ({"file": "/a.ply"}, "relative to the preset's own folder"),
        ({"file": "a.ply", "unit": "inch"}, r"object.*unit"),
        ({"file": "a.ply", "up": "y", "beside": [{"file": "a.ply", "up": "z"}]}, "has one up axis"),
    ],
)
def test_impossible_tables_are_refused_by_name(table, why):
    with pytest.raises(PresetError, match=why):
        preset_from_dict({"object": [table]}, "a test")


def test_files_that_cannot_be_are_named(folder):
    with pytest.raises(OutsideError):
        read(folder, {"file": "../person.obj"})
    unread = preset_from_dict({"object": [{"file": "person.obj", "unit": "cm"}]}, "a test")
    with pytest.raises(PresetError, match=r"person.obj has its size from its mesh, which is not read here"):
        sample_scene(unread, 0)
    (folder / "my.toml").write_text('[[object]]\nfile = "other.stl"\n')
    assert "other.stl is missing" in refusal(
        "night-gen", "scenes", folder / "d", "--preset", folder / "my.toml"
    )
    (folder / "my.toml").write_text('[[object]]\nfile = "person.obj"\nunit = "m"\n')
    trimesh.load(folder / "person.obj").apply_scale(100).export(folder / "person.obj")
    message = refusal("night-gen", "scenes", folder / "d", "--preset", folder / "my.toml")
    assert "a mesh of [[object]] in its unit" in message
    assert "got 18000" in message


def test_a_dataset_of_tables_is_made_again_with_the_same_bytes(folder):
    (folder / "my.toml").write_text(
        '[dataset]\ncount = 2\n[[object]]\nfile = "person.obj"\nunit = "mm"\nup = "y"\n'
        "rotation_deg = { x = 0, y = 0, z = 0 }\n"
    )
    for _ in range(2):
        done = night_here("night-gen", "scenes", folder / "data", "--preset", folder / "my.toml")
        assert done.returncode == 0, done.stderr
    dataset = open_dataset(folder / "data")
    assert json.loads((folder / "data" / "dataset.json").read_text())["preset"]["object"][0]["size_m"] == 0.18
    mesh = dataset.scene_folder("000000") / "hidden_object_0.ply"
    vertices, _ = scene_triangles(mesh.read_bytes(), str(mesh))
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.04, 0.03, 0.18], atol=1e-6)
    assert load_preset("paper").object == ()
