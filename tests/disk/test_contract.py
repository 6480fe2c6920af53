"""Files of a dataset that break their contract: which error each reader raises, and that it names the key."""

import json
import shutil
from dataclasses import is_dataclass
from typing import Annotated, get_args, get_origin, get_type_hints

import pytest

from disk import ContractError, PresetError
from itof.capture.sidecar import Sidecar
from itof.sensor.settings import SensorSettings
from model.settings.train_settings import TrainSettings
from scenegen import (
    RECORD_FILE,
    DatasetError,
    Preset,
    open_dataset,
    preset_from_dict,
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
        (changed(max_bounces=0), r"max_bounces must be .* \(got 0\)"),
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
        (changed(seed=-1), r"seed must be .* \(got -1\)"),
    ],
)
def test_a_damaged_dataset_json_is_a_dataset_error_that_names_file_and_key(copy, damage, words):
    file = copy.root / "dataset.json"
    file.write_text(damage(file.read_text()))
    with pytest.raises(DatasetError, match=words) as caught:
        open_dataset(copy.root)
    assert str(file) in str(caught.value)


HERTZ, GIVE = "must be 1e+06 to 1e+10 Hz", "give Hz, as 20e6 for 20 MHz"


@pytest.mark.parametrize(
    ("section", "key", "value", "sentence"),
    [
        ("dataset", "count", "five", "dataset.count must be a whole number (got 'five')"),
        ("dataset", "count", 2.5, "dataset.count must be a whole number (got 2.5)"),
        ("dataset", "count", 0, "dataset.count must be greater than or equal to 1 (got 0)"),
        ("itof", "frequencies_hz", [20, 50, 60], f"itof.frequencies_hz.0 {HERTZ} (got 20): {GIVE}"),
        ("itof", "frequencies_hz", [20e6, 60], f"itof.frequencies_hz.1 {HERTZ} (got 60): {GIVE}"),
        ("itof", "frequencies_hz", [20e3], f"itof.frequencies_hz.0 {HERTZ} (got 20000): {GIVE}"),
        ("transient", "bin_width_m", 1e-300, "transient.bin_width_m must be 0.0001 to 1000 m (got 1e-300)"),
        ("camera", "location_m", "here", "camera.location_m must be a list of values in [ ] (got 'here')"),
        ("camera", "location_m", [1, 2], "camera.location_m has too few values: only 2"),
        ("camera", "location_m", [1, 2, 3, 4], "camera.location_m has 4 values instead of at most 3"),
        ("camera", "location_m", [1, 2, "3"], "camera.location_m.2 must be a number (got '3')"),
        ("relay_wall", "roughness", [], "relay_wall.roughness has 0 values instead of at least 1"),
        ("relay_wall", "material", "wood", "relay_wall.material must be 'rough' or 'diffuse' (got 'wood')"),
        (
            "hidden_object",
            "location_m",
            3,
            "hidden_object.location_m must be a table of keys and values (got 3)",
        ),
    ],
)
def test_what_a_value_must_be_is_said_without_types_of_python(section, key, value, sentence):
    with pytest.raises(PresetError) as refused:
        preset_from_dict({section: {key: value}}, "mine.toml")
    assert str(refused.value) == f"mine.toml: {sentence}"


def unbounded(hint, place):
    """Keys of the numbers in a type of settings that have no least or no largest value."""
    if get_origin(hint) is Annotated:
        kind, *marks = get_args(hint)
        limits = [each for mark in marks for each in getattr(mark, "metadata", [mark])]
        ends = {
            end for each in limits for end in ("least", "most", "ge", "gt", "le", "lt") if hasattr(each, end)
        }
        if kind in (float, int):
            if not (ends & {"least", "ge", "gt"} and ends & {"most", "le", "lt"}):
                yield place
        else:
            yield from unbounded(kind, place)
    elif is_dataclass(hint):
        for name, each in get_type_hints(hint, include_extras=True).items():
            yield from unbounded(each, f"{place}.{name}")
    elif hint in (float, int):
        yield place
    else:
        for each in get_args(hint):
            yield from unbounded(each, place)


@pytest.mark.parametrize("settings", [Preset, SensorSettings, Sidecar, TrainSettings])
def test_every_number_of_a_toml_file_has_bounds(settings):
    assert list(unbounded(settings, settings.__name__)) == []


def test_a_camera_whose_projector_would_need_a_huge_image_is_refused():
    with pytest.raises(PresetError, match="need a larger common divisor than 1, because the projector"):
        preset_from_dict({"camera": {"width": 99_999, "height": 100_000}}, "mine.toml")
    preset_from_dict({"camera": {"width": 80_000, "height": 60_000}}, "mine.toml")


def test_a_damaged_render_record_is_no_record(tmp_path):
    for text in ("{", "{}", '{"recipe": "x", "attributes": {}, "files": {}, "more": 1}'):
        (tmp_path / RECORD_FILE).write_text(text)
        assert read_record(tmp_path) is None


def test_errors_of_files_and_of_presets_are_of_different_kinds():
    assert not issubclass(PresetError, ContractError | DatasetError)
    assert not any(issubclass(kind, PresetError) for kind in (ContractError, DatasetError))
