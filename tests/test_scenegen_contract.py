"""Files of a dataset that break their contract: which error each reader raises, and that it names the key."""

import json
import shutil

import pytest

from scenegen import (
    RECORD_FILE,
    ContractError,
    DatasetError,
    PresetError,
    open_dataset,
    read_record,
    scene_from_json,
    scene_id,
)


@pytest.fixture(scope="module")
def two_scenes(make_dataset):
    return make_dataset({"dataset": {"count": 2}})


@pytest.fixture
def copy(two_scenes, tmp_path):
    """A dataset that a test may damage."""
    return open_dataset(shutil.copytree(two_scenes.root, tmp_path / "data"))


def without(key):
    return lambda text: json.dumps({name: value for name, value in json.loads(text).items() if name != key})


def changed(**keys):
    return lambda text: json.dumps(json.loads(text) | keys)


DAMAGES = [
    (lambda text: text[: len(text) // 2], "the file: Invalid JSON"),
    (lambda text: "[]", "the file"),
    (changed(lens=1), "unknown key lens"),
]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        *DAMAGES,
        (without("camera"), "key camera is missing"),
        (changed(max_bounces=0), r"max_bounces: .* \(got 0\)"),
        (changed(split="holiday"), "split"),
    ],
)
def test_a_damaged_scene_json_is_a_dataset_error_that_names_file_and_key(copy, damage, words):
    file = copy.scene_folder(scene_id(1)) / "scene.json"
    file.write_text(damage(file.read_text()))
    with pytest.raises(DatasetError, match=words) as caught:
        copy.scene(scene_id(1))
    assert str(file) in str(caught.value)
    with pytest.raises(ContractError, match=words):
        scene_from_json(file.read_text(), str(file))


def test_a_scene_json_that_is_no_text_is_a_dataset_error(copy):
    (copy.scene_folder(scene_id(0)) / "scene.json").write_bytes(b"\xff\xfe")
    with pytest.raises(DatasetError, match=r"scene\.json cannot be read"):
        copy.scene(scene_id(0))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (DAMAGES[0][0], "cannot be read as JSON"),
        (DAMAGES[1][0], "schema version None"),
        (DAMAGES[2][0], "unknown key lens"),
        (without("preset"), "key preset is missing"),
        (changed(seed=-1), r"seed: .* \(got -1\)"),
    ],
)
def test_a_damaged_dataset_json_is_a_dataset_error_that_names_file_and_key(copy, damage, words):
    file = copy.root / "dataset.json"
    file.write_text(damage(file.read_text()))
    with pytest.raises(DatasetError, match=words) as caught:
        open_dataset(copy.root)
    assert str(file) in str(caught.value)


def test_a_damaged_render_record_is_no_record(tmp_path):
    for text in ("{", "{}", '{"recipe": "x", "attributes": {}, "files": {}, "more": 1}'):
        (tmp_path / RECORD_FILE).write_text(text)
        assert read_record(tmp_path) is None


def test_errors_of_files_and_of_presets_are_of_different_kinds():
    assert not issubclass(PresetError, ContractError | DatasetError)
    assert not any(issubclass(kind, PresetError) for kind in (ContractError, DatasetError))
