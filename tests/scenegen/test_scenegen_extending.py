"""A dataset that grows: more scenes later, interrupted work, and folders that are refused."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from night_commands import night_here, refusal
from scene_folders import contents, identities, of_seed_5

from scenegen import (
    DatasetError,
    RenderingRecord,
    SamplingError,
    load_preset,
    open_dataset,
    preset_from_dict,
    scene_id,
    write_index,
    write_rendering_record,
)
from scenegen.dataset import MEASURED_GENERATOR
from scenegen.making.generation import generate
from scenegen.making.target import check_target


def test_extending_equals_making_at_once_and_touches_no_scene_that_is_there(maker, tmp_path):
    generate(tmp_path / "once", of_seed_5(20), maker, lambda: None)
    generate(tmp_path / "grown", of_seed_5(9), maker, lambda: None)
    before = identities(tmp_path / "grown" / "scenes")
    generate(tmp_path / "grown", of_seed_5(20), maker, lambda: None)
    after = identities(tmp_path / "grown" / "scenes")
    assert {name: after[name] for name in before} == before
    assert contents(tmp_path / "grown") == contents(tmp_path / "once")


def test_making_a_dataset_again_keeps_the_record_of_its_renders(maker, tmp_path):
    dataset = generate(tmp_path, of_seed_5(3), maker, lambda: None)
    rendering = RenderingRecord(
        *("many-light", "both", 3, {"error": 0.01}, 24, 18, {"mitsuba": "3.9"}, 3, 0.008, 0.01)
    )
    write_rendering_record(dataset.renders, rendering)
    for count in (3, 5):
        generate(tmp_path, of_seed_5(count), maker, lambda: None)
        assert open_dataset(tmp_path).rendering == rendering


def test_an_interrupted_extension_goes_on_or_is_taken_back(maker, tmp_path):
    generate(tmp_path, of_seed_5(4), maker, lambda: None)
    four = contents(tmp_path)

    class StopHereError(Exception):
        pass

    made = []

    def stop_after_six():
        made.append(1)
        if len(made) == 6:
            raise StopHereError

    with pytest.raises(StopHereError):
        generate(tmp_path, of_seed_5(9), maker, stop_after_six)
    assert len(open_dataset(tmp_path).ids()) == 4
    assert (tmp_path / "scenes" / scene_id(5)).exists()
    generate(tmp_path, of_seed_5(4), maker, lambda: None)
    assert contents(tmp_path) == four
    made.clear()
    with pytest.raises(StopHereError):
        generate(tmp_path, of_seed_5(9), maker, stop_after_six)
    generate(tmp_path, of_seed_5(9), maker, lambda: None)
    generate(tmp_path / "once", of_seed_5(9), maker, lambda: None)
    once = contents(tmp_path / "once")
    assert {name: data for name, data in contents(tmp_path).items() if not name.startswith("once")} == once


@pytest.mark.parametrize("count", [3, 9])
@pytest.mark.parametrize("damage", ["no scene.json", "no JSON", "another seed", "another index"])
def test_a_folder_beside_a_finished_dataset_that_is_not_its_own_is_refused(maker, tmp_path, damage, count):
    root = tmp_path / "data"
    generate(root, of_seed_5(3), maker, lambda: None)
    file = root / "scenes" / scene_id(7) / "scene.json"
    file.parent.mkdir()
    ours = json.loads((root / "scenes" / scene_id(1) / "scene.json").read_text())
    if damage == "no JSON":
        file.write_text("{")
    elif damage == "another seed":
        file.write_text(json.dumps(ours | {"index": 7, "dataset_seed": 6}))
    elif damage == "another index":
        file.write_text(json.dumps(ours))
    with pytest.raises(DatasetError, match=rf"{scene_id(7)} is none of the dataset's scenes"):
        generate(root, of_seed_5(count), maker, lambda: None)
    assert file.parent.exists()
    file.write_text(json.dumps(ours | {"index": 7}))
    check_target(root, of_seed_5(count))


@pytest.mark.parametrize(
    ("name", "put"),
    [
        ("notes.txt", lambda file: file.write_text("mine")),
        ("my pictures", lambda file: file.mkdir()),
        ("relay_wall.ply", lambda file: file.symlink_to("/etc/passwd")),
    ],
)
@pytest.mark.parametrize("place", ["a scene", "a surplus scene", "a surplus scene of an unfinished dataset"])
def test_files_of_the_user_in_a_scene_folder_are_refused_by_name(maker, tmp_path, place, name, put):
    generate(tmp_path, of_seed_5(2), maker, lambda: None)
    damaged = tmp_path / "scenes" / scene_id(0) / "scene.xml"
    damaged.write_text("damaged")
    folder = tmp_path / "scenes" / scene_id(1)
    if place != "a scene":
        folder = shutil.copytree(folder, folder.with_name(scene_id(7)))
        scene = json.loads((folder / "scene.json").read_text())
        (folder / "scene.json").write_text(json.dumps(scene | {"index": 7}))
        if place != "a surplus scene":
            (tmp_path / "dataset.json").unlink()
    (folder / name).unlink(missing_ok=True)
    put(folder / name)
    before = sorted(str(file) for file in tmp_path.rglob("*"))
    with pytest.raises(DatasetError, match=rf"NIGHT did not make .*{folder.name}/{name}.*move") as refused:
        generate(tmp_path, of_seed_5(2), maker, lambda: None)
    assert "\n" not in str(refused.value)
    assert sorted(str(file) for file in tmp_path.rglob("*")) == before
    assert damaged.read_text() == "damaged"


def test_a_mesh_too_many_is_not_deleted(maker, tmp_path):
    generate(tmp_path, of_seed_5(2), maker, lambda: None)
    file = tmp_path / "scenes" / scene_id(1) / "hidden_object_1.ply"  # this scene has one object
    file.write_text("mine")
    with pytest.raises(DatasetError, match=r"NIGHT did not make .*hidden_object_1.ply"):
        generate(tmp_path, of_seed_5(2), maker, lambda: None)
    assert file.read_text() == "mine"


def test_many_files_of_the_user_are_counted(maker, tmp_path):
    generate(tmp_path, of_seed_5(2), maker, lambda: None)
    for number in range(5):
        (tmp_path / "scenes" / scene_id(1) / f"{number}.txt").touch()
    command = ("night-gen", "scenes", tmp_path, "--seed", 5, "--count", 2)
    sentence = refusal(*command, "--preset", "paper")
    assert re.search(r"0.txt, .*1.txt, .*2.txt and 2 more", sentence)
    assert refusal(*command) == sentence  # a dataset brings its own preset


def test_a_dataset_grows_by_its_own_preset(maker, tmp_path):
    (tmp_path / "my.toml").write_text("[dataset]\ncount = 2\nseed = 5\n[camera]\nwidth = 24\nheight = 18\n")
    root = tmp_path / "data"
    for command in (("--preset", tmp_path / "my.toml"), ("--count", 3)):
        done = night_here("night-gen", "scenes", root, *command)
        assert done.returncode == 0, done.stderr
    assert len(open_dataset(root).ids()) == 3
    assert open_dataset(root).preset.camera.width == 24
    assert "already holds 3 scenes" in refusal("night-gen", "scenes", root, "--count", 2)


def test_fewer_scenes_than_there_are_are_refused_with_the_number_there_is(maker, tmp_path):
    generate(tmp_path, preset_from_dict({"dataset": {"count": 3}}, "three"), maker, lambda: None)
    command = ["night-gen", "scenes", tmp_path, "--preset", "paper", "--count"]
    message = refusal(*command, 2)
    assert "already holds 3 scenes" in message
    assert "--count 3 or more" in message
    assert "another preset or seed" in refusal(*command, 3, "--seed", 1)
    assert len(open_dataset(tmp_path).ids()) == 3


def test_captures_are_not_replaced_by_drawn_scenes(maker, tmp_path):
    dataset = generate(tmp_path, of_seed_5(2), maker, lambda: None)
    write_index(tmp_path, replace(dataset.index, generator=MEASURED_GENERATOR))
    before = contents(tmp_path)
    for command in ((), ("--count", 5)):
        assert "holds captures of a camera" in refusal("night-gen", "scenes", tmp_path, *command)
    assert contents(tmp_path) == before


def test_two_processes_do_not_make_scenes_in_one_folder(maker, tmp_path):
    refused = []

    def other_number():
        with pytest.raises(DatasetError, match="another night-gen is making scenes in") as error:
            generate(tmp_path / "data", of_seed_5(3), maker, lambda: None)
        refused.append(error)

    made = generate(tmp_path / "data", of_seed_5(6), maker, other_number)
    assert len(refused) == 6
    assert len(made.ids()) == 6
    assert all(made.scene(scene).seed for scene in made.ids())  # every folder is there
    assert sorted(entry.name for entry in made.root.iterdir()) == ["dataset.json", "scenes"]


def test_a_refused_preset_leaves_no_folder(maker, tmp_path):
    in_the_wall = {"location_m": {"x": [0, 0]}}

    with pytest.raises(SamplingError):
        generate(
            tmp_path / "data" / "in" / "here", of_seed_5(1, hidden_object=in_the_wall), maker, lambda: None
        )
    assert not (tmp_path / "data").exists()
    (tmp_path / "data").mkdir()  # the user's own
    with pytest.raises(SamplingError):
        generate(tmp_path / "data", of_seed_5(1, hidden_object=in_the_wall), maker, lambda: None)
    assert (tmp_path / "data").is_dir()


def test_the_index_says_by_what_the_scenes_were_made(maker, tmp_path):
    index = generate(tmp_path, of_seed_5(1), maker, lambda: None).index
    assert set(index.packages) == {"night-nlos", "bpy", "numpy", "trimesh"}
    assert index.packages["numpy"] == np.__version__
    assert index.packages["trimesh"] == trimesh.__version__
    assert index.blender_version.startswith(index.packages["bpy"])


def test_a_dataset_is_replaced_by_one_of_another_preset_when_that_is_wanted(maker, tmp_path):
    data, file = tmp_path / "data", tmp_path / "wider.toml"
    before = of_seed_5(4)
    generate(data, before, maker, lambda: None)
    for name in ("renders/000001/itof.exr", "shards/000000/mask.npy"):
        (data / name).parent.mkdir(parents=True)
        (data / name).write_bytes(bytes(1000))
    there = contents(data)
    file.write_text("[dataset]\ncount = 3\nseed = 5\n[camera]\nhorizontal_fov_deg = 55.5\n")
    command = ("night-gen", "scenes", data, "--preset", file, "--replace")
    said = refusal(*command)
    assert said.startswith(f"this would delete 4 scenes and 1 render in {data}, ")
    assert "to make them again with dataset.count = 3, " in said
    assert "camera.horizontal_fov_deg = 55.5" in said
    assert contents(data) == there
    for name in ("scenes/000003", "renders", "renders/000001", "renders/000001/more", "shards/000000"):
        note = data / name / "notes.exr"
        note.parent.mkdir(exist_ok=True)
        note.write_text("mine")
        assert f"NIGHT did not make {note}" in refusal(*command, "--yes")
        note.unlink()
    assert contents(data) == there

    done = night_here(*command, "--yes")
    assert done.returncode == 0, done.stderr
    generate(tmp_path / "new", load_preset(file), maker, lambda: None)
    assert contents(data) == contents(tmp_path / "new")
    again = night_here(*command, "--count", "5")  # more scenes of the same preset: nothing is lost
    assert again.returncode == 0, again.stderr


def test_captures_are_never_replaced(maker, tmp_path):
    dataset = generate(tmp_path, of_seed_5(3), maker, lambda: None)
    write_index(tmp_path, replace(dataset.index, generator=MEASURED_GENERATOR))
    with pytest.raises(DatasetError, match="holds captures of a camera"):
        generate(tmp_path, of_seed_5(2), maker, lambda: None, replacing=True)
