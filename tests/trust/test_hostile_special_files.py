"""Pipes in the place of files, and text of files that would command a terminal, in a stranger's dataset."""

import json
import os

import pytest
from night_commands import refusal

from commandline.results import tell
from disk import NightError, PresetError
from disk.plain_file import read_plain
from itof.capture.sidecar_files import load_sidecar
from itof.sensor.cameras import load_sensor
from model.judging.exposure_results import files_of_exposures
from model.judging.report_files import files_of_report
from model.prediction.prediction_files import files_of_prediction
from model.refinement.work import read_result
from model.run_folder.history import HISTORY_FILE, read_history
from model.run_folder.run_config import RunError
from model.settings.presets import training_preset
from render.farm.batch_system import check_cluster_file
from render.farm.claims import attempts_of
from render.farm.inventory import Inventory
from render.products.card import read_card
from render.products.croissant import has_no_other_croissant
from render.settings import settings_for
from scenegen import DatasetError, load_preset, open_dataset, read_rendering_record
from scenegen.scene_folder import SceneFolderError, read_scene_folder


def pipe_at(path):
    path.unlink(missing_ok=True)
    path.parent.mkdir(exist_ok=True)
    os.mkfifo(path)


def test_a_plain_file_is_read_and_nothing_else(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(b"12345")
    assert read_plain(file, 5) == b"12345"
    with pytest.raises(OSError, match="it has 5 bytes, more than 4"):
        read_plain(file, 4)
    pipe_at(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero"):
        with pytest.raises(OSError, match="it is no plain file"):
            read_plain(path, 5)


def special_file(kind, path):
    """A file that must not be read: a pipe, a device, or one of 3 GB that takes no place on the disk."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as stream:
            stream.truncate(3 * 10**9)


SETTINGS = {
    "preset": load_preset,
    "sensor": load_sensor,
    "sidecar": load_sidecar,
    "training": training_preset,
    "cluster": check_cluster_file,
}


@pytest.mark.parametrize("kind", ["pipe", "device", "sparse"])
@pytest.mark.parametrize("read", SETTINGS.values(), ids=SETTINGS)
def test_settings_that_are_no_file_of_their_size_are_refused_and_not_read(read, kind, tmp_path):
    special_file(kind, tmp_path / "mine.toml")
    with pytest.raises(
        NightError, match=r"mine\.toml cannot be read: it (is no plain file|has 3000000000 bytes)"
    ):
        read(tmp_path / "mine.toml")


@pytest.mark.parametrize("kind", ["pipe", "device", "sparse"])
def test_json_of_a_dataset_that_is_no_file_of_its_size_is_refused_and_not_read(kind, pipeline_copy):
    dataset = open_dataset(pipeline_copy / "data")
    special_file(kind, dataset.scene_folder("000000") / "scene.json")
    with pytest.raises(NightError, match=r"scene\.json (cannot be read: it (is no|has 3)|is a symbol)"):
        dataset.scene("000000")
    special_file(kind, dataset.root / "README.md")
    special_file(kind, dataset.root / "croissant.json")
    assert not read_card(dataset).is_ours
    assert not has_no_other_croissant(dataset)
    special_file(kind, dataset.root / "dataset.json")
    with pytest.raises(DatasetError, match=r"dataset\.json cannot be read: it (is no plain|has 3000000000)"):
        open_dataset(dataset.root)


ENCODINGS = {
    "utf-16": "UTF-16",
    "utf-16-le": "UTF-16",
    "utf-16-be": "UTF-16",
    "utf-32": "UTF-32",
    "utf-32-be": "UTF-32",
    "latin-1": "not UTF-8, but perhaps Windows-1252 or Latin-1",
}


def test_settings_are_read_with_a_byte_order_mark(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[dataset]\ncount = 7  # f\u00fcr uns\n", encoding="utf-8-sig")
    assert load_preset(file).dataset.count == 7
    file.write_text("jobqueue:\n  slurm:\n    cores: 1\n    memory: 1GB\n", encoding="utf-8-sig")
    assert not check_cluster_file(file)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_settings_in_another_encoding_are_refused_by_its_name(encoding, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("count = 7  # f\u00fcr uns\n", encoding=encoding)
    with pytest.raises(PresetError) as refused:
        load_preset(file)
    assert str(refused.value) == f"{file} cannot be read: it is {ENCODINGS[encoding]}: save it as UTF-8 text"


def test_json_is_read_with_a_byte_order_mark_and_refused_in_another_encoding(pipeline_copy):
    data = pipeline_copy / "data"
    for file in (data / "dataset.json", data / "scenes" / "000000" / "scene.json"):
        text = file.read_text()
        file.write_text(text, encoding="utf-8-sig")
        assert open_dataset(data).scene("000000").id == "000000"
        file.write_text(text, encoding="utf-16")
        with pytest.raises(
            DatasetError, match=rf"{file.name} cannot be read: it is UTF-16: save it as UTF-8"
        ):
            open_dataset(data).scene("000000")
        file.write_text(text)


def test_pipes_among_the_files_of_a_run_are_not_waited_for(tmp_path):
    pipe_at(tmp_path / ".claims" / "000000")
    assert attempts_of(tmp_path, "000000", "run") == 0
    assert read_rendering_record(tmp_path) is None
    pipe_at(tmp_path / "rendering.json")
    with pytest.raises(OSError, match="it is no plain file"):
        read_rendering_record(tmp_path)


def test_a_pipe_for_the_record_of_the_renders_is_named(pipeline_copy):
    file = pipeline_copy / "data" / "renders" / "rendering.json"
    pipe_at(file)
    assert refusal("night-render", "status", pipeline_copy / "data").startswith(
        f"{file}: it is no plain file"
    )


@pytest.mark.parametrize("special", ["pipe", "/dev/zero"])
def test_a_history_that_is_no_plain_file_is_refused(special, tmp_path):
    if special == "pipe":
        pipe_at(tmp_path / HISTORY_FILE)
    else:
        (tmp_path / HISTORY_FILE).symlink_to(special)
    with pytest.raises(RunError, match="it is no plain file"):
        read_history(tmp_path)


@pytest.mark.parametrize("written", [files_of_report, files_of_exposures, files_of_prediction])
def test_pipes_among_earlier_results_are_not_waited_for(written, tmp_path):
    for name in ("metrics.json", "exposures.json", "prediction.json"):
        pipe_at(tmp_path / name)
    assert written(tmp_path) == {}


def test_pipes_among_refined_scenes_are_not_waited_for(tmp_path):
    pipe_at(tmp_path / "scenes" / "000000.json")
    assert read_result(tmp_path, "000000") is None


def test_a_class_with_control_characters_is_refused(pipeline_copy):
    file = pipeline_copy / "data" / "dataset.json"
    index = json.loads(file.read_text())
    index["scenes"][1]["object_class"] = "cube\x1b]0;title\x07"
    file.write_text(json.dumps(index))
    assert "scenes.1.object_class: String should match pattern" in refusal(
        "night-render", "status", pipeline_copy / "data"
    )


def test_text_of_files_commands_no_terminal(capsys):
    tell(["failed: 000001: \x1b]0;title\x07\nsecond line"], {}, False)
    assert capsys.readouterr().out == "failed: 000001: \\x1b]0;title\\x07\nsecond line\n"


@pytest.mark.parametrize("special", ["pipe", "/dev/zero"])
def test_a_render_that_is_no_plain_file_is_damaged(special, pipeline_copy):
    folder = pipeline_copy / "data" / "renders" / "000000"
    record = json.loads((folder / "render.json").read_text())
    record["files"]["itof.exr"]["bytes"] = 0
    (folder / "render.json").write_text(json.dumps(record))
    (folder / "itof.exr").unlink()
    if special == "pipe":
        pipe_at(folder / "itof.exr")
    else:
        (folder / "itof.exr").symlink_to(special)
    dataset = open_dataset(pipeline_copy / "data")
    assert Inventory(dataset, settings_for(dataset, {})).state("000000") == "damaged"


def test_a_pipe_in_the_place_of_a_new_scene_is_not_waited_for(pipeline_copy):
    data = pipeline_copy / "data"
    pipe_at(data / "scenes" / "999999" / "scene.json")
    assert "999999" in refusal("night-gen", "scenes", data)


def test_a_scene_folder_of_any_size_is_not_read(tmp_path):
    for number, length in enumerate((2**20, 2**20, 2**20, 2**20, 2**30 - 2**22 + 1)):
        with (tmp_path / f"hidden_object_{number}.ply").open("wb") as stream:
            stream.truncate(length)  # without blocks on the disk
    with pytest.raises(SceneFolderError, match=r"larger than a scene can be \(up to hidden_object_4\.ply\)"):
        read_scene_folder(tmp_path)
