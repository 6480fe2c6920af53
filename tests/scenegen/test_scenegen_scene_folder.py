"""The digest of a scene folder, and what is no scene folder."""

import dataclasses
import hashlib
import os
import shutil

import pytest
from scene_folders import of_seed_5

from disk import ContractError, NightError
from scenegen import sample_scene, scene_to_json
from scenegen.making.generation import generate
from scenegen.scene_folder import (
    SceneFolderError,
    differences,
    digest_of,
    folder_digest,
    is_scene_file,
    read_scene_folder,
    scene_of,
)


@pytest.fixture(scope="module")
def made(maker, tmp_path_factory):
    return generate(tmp_path_factory.mktemp("made"), of_seed_5(3), maker, lambda: None)


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made.scene_folder("000001"), tmp_path / "scenes" / "000001")


def test_the_dataset_has_the_digest_of_every_scene_folder(made):
    for scene_id in made.ids():
        files = read_scene_folder(made.scene_folder(scene_id))
        assert all(is_scene_file(name) for name in files)
        expected = hashlib.sha256(b"".join(name.encode() + b"\0" + files[name] for name in sorted(files)))
        assert made.entry(scene_id).sha256 == digest_of(files) == expected.hexdigest()
        assert folder_digest(made.scene_folder(scene_id)) == expected.hexdigest()


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("relay_wall.ply", lambda file: file.symlink_to(file.parent / "scene.json")),
        ("relay_wall.ply", lambda file: file.symlink_to("/etc/passwd")),
        ("sub", lambda file: file.mkdir()),
        ("pipe", os.mkfifo),
    ],
)
def test_a_scene_folder_holds_regular_files_alone(folder, name, make):
    (folder / name).unlink(missing_ok=True)
    make(folder / name)
    for read in (folder_digest, read_scene_folder):
        with pytest.raises(SceneFolderError, match=f"{name} is .*regular"):
            read(folder)
    assert name in differences(folder)


def test_a_file_larger_than_memory_is_not_read(folder):
    with (folder / "relay_wall.ply").open("r+b") as stream:
        stream.truncate(2**40)  # takes no space
    with pytest.raises(SceneFolderError, match=r"is larger than a scene can be \(up to relay_wall\.ply\)"):
        folder_digest(folder)


def test_a_file_name_that_is_no_text_is_hashed_and_named(folder):
    before = folder_digest(folder)
    (folder / os.fsdecode(b"\xff.ply")).write_bytes(b"")
    assert folder_digest(folder) != before
    assert "is not one of its files" in differences(folder)


@pytest.mark.parametrize("empty", [True, False])
def test_a_folder_without_files_is_no_scene(tmp_path, empty):
    if empty:
        (tmp_path / "000001").mkdir()
    with pytest.raises(SceneFolderError, match=r"000001 is missing or empty: run night-gen scenes again"):
        read_scene_folder(tmp_path / "000001")


def test_a_scene_json_of_another_folder_is_refused(folder, made):
    shutil.copy(made.scene_folder("000002") / "scene.json", folder / "scene.json")
    with pytest.raises(ContractError, match="describes scene 000002"):
        scene_of(read_scene_folder(folder), folder)
    with pytest.raises(NightError, match="describes scene 000002"):
        type(made)(folder.parent.parent, made.index).scene("000001")


def edit_scene_json(folder):
    file = folder / "scene.json"
    file.write_text(file.read_text().replace('"irradiance": 1.0', '"irradiance": 2.0'))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / "emitter.pfm").unlink(), "emitter.pfm is missing"),
        (lambda folder: (folder / "notes.txt").write_text("mine"), "notes.txt is not one of its files"),
        (lambda folder: (folder / "hidden_object_7.ply").touch(), "hidden_object_7.ply is not one"),
        (lambda folder: (folder / "scene.json").write_text("{"), "scene.json: "),
        (lambda folder: (folder / "scene.xml").write_text("<scene/>"), "scene.xml or scene.json was changed"),
        (edit_scene_json, "scene.xml or scene.json was changed"),
        (lambda folder: (folder / "emitter.pfm").write_bytes(b"Pf"), "emitter.pfm was changed"),
        (lambda folder: (folder / "relay_wall.ply").write_bytes(b"ply"), "scene.json or a mesh"),
    ],
)
def test_what_differs_is_named_as_far_as_the_files_tell(folder, damage, words):
    damage(folder)
    assert words in differences(folder)


def test_a_scene_of_a_huge_image_needs_no_huge_image_to_be_compared(folder, paper):
    scene = scene_of(read_scene_folder(folder), folder)
    huge = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=99991, height=100000))
    (folder / "scene.json").write_text(scene_to_json(huge))
    assert "emitter.pfm was changed" in differences(folder)  # it would have 40 GB


@pytest.mark.parametrize("value", ["1e300", "-1e7", "Infinity", "NaN"])
def test_a_scene_far_outside_of_any_room_is_refused(folder, value):
    file = folder / "scene.json"
    text = file.read_text()
    head, emitter, tail = text.partition('"emitter"')
    changed = tail.replace('"location_m": [\n      1.0', f'"location_m": [\n      {value}', 1)
    assert changed != tail
    file.write_text(head + emitter + changed)
    with pytest.raises(ContractError, match=r"scene\.json"):
        scene_of(read_scene_folder(folder), folder)


def test_the_sampled_scene_is_the_one_in_the_folder(made):
    assert made.scene("000000") == sample_scene(of_seed_5(3), 0)
