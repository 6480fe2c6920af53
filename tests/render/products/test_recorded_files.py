"""Rendered files that differ from their record are refused before anything parses them."""

import json
import shutil

import pytest
from previews import grey_view
from render_records import problems, record_anew

from disk import OutsideError
from model.data.renders import read_render
from render.products.conversion import convert_to_itof, open_transient
from render.products.tal_export import export_tal
from render.products.tiles import is_rendered, read_tile
from scenegen import RenderFileError, read_record, recorded_file, write_rendering_record
from scenegen.rendering_record import RenderingRecord

SCENE = "000000"
FILES = ("itof.exr", "mirrored.exr", "transient.exr", "mirrored_transient.exr")
READERS = {
    "tile": (("itof.exr", "mirrored.exr"), lambda data, out: read_tile(data, SCENE, grey_view(None, 4, 3))),
    "training": (("itof.exr", "mirrored.exr"), lambda data, out: read_render(data, SCENE)),
    "phasors": (("transient.exr",), lambda data, out: convert_to_itof(data, SCENE, out)),
    "capture": (("transient.exr",), lambda data, out: export_tal(data, SCENE, out / "x.hdf5")),
    "movie": (("transient.exr",), lambda data, out: open_transient(data, SCENE)),
}


def rendered_by(data):
    """Note that night-render has rendered the dataset."""
    write_rendering_record(
        data.renders,
        RenderingRecord(
            method="many-light",
            product="both",
            max_bounces=3,
            options={},
            width=24,
            height=18,
            packages={},
            scene_count=1,
            hidden_error_median=None,
            hidden_error_max=None,
        ),
    )


@pytest.mark.parametrize("reader", READERS)
def test_a_changed_file_is_not_parsed(transient_copy, tmp_path, reader):
    names, read = READERS[reader]
    folder = transient_copy.render_folder(SCENE)
    read(transient_copy, tmp_path)
    for name in names:
        whole = (folder / name).read_bytes()
        for content in (b"no image".ljust(len(whole)), whole[:-1], whole[:-1] + b"?", b""):
            (folder / name).write_bytes(content)
            words = rf"scene {SCENE}: .*{name} is not the file that night-render wrote .*: run night-render"
            with pytest.raises(RenderFileError, match=words):
                read(transient_copy, tmp_path)
        (folder / name).write_bytes(whole)


@pytest.mark.parametrize("name", FILES)
def test_verification_does_not_parse_a_changed_file_either(transient_copy, name):
    file = transient_copy.render_folder(SCENE) / name
    file.write_bytes(b"no image".ljust(file.stat().st_size))
    assert problems(transient_copy, SCENE) == [f"{name} is not what was written (its SHA-256 differs)"]


def test_verification_does_not_parse_a_file_that_the_record_does_not_name(transient_copy):
    file = transient_copy.render_folder(SCENE) / "render.json"
    record = json.loads(file.read_text())
    del record["files"]["itof.exr"]
    file.write_text(json.dumps(record))
    file.with_name("itof.exr").write_bytes(b"no image")
    assert problems(transient_copy, SCENE) == ["itof.exr is not in render.json"]


@pytest.mark.parametrize("reader", READERS)
def test_a_file_that_cannot_be_read_although_it_is_the_recorded_one_says_what_to_do(
    transient_copy, tmp_path, reader
):
    names, read = READERS[reader]
    file = transient_copy.render_folder(SCENE) / names[0]
    file.write_bytes(file.read_bytes()[:-1])
    record_anew(file.parent)
    words = rf"{names[0]} is damaged or no EXR file \(.*\): delete it and render it again$"
    with pytest.raises(ValueError, match=words):
        read(transient_copy, tmp_path)


def test_a_scene_without_a_record_is_unfinished_if_night_render_made_the_dataset(transient_copy, tmp_path):
    (transient_copy.render_folder(SCENE) / "render.json").unlink()
    assert is_rendered(transient_copy, SCENE)  # perhaps another program did
    for _, read in READERS.values():
        read(transient_copy, tmp_path)
    rendered_by(transient_copy)
    assert not is_rendered(transient_copy, SCENE)
    for reader, (_, read) in READERS.items():
        if reader != "tile":
            with pytest.raises(RenderFileError, match=r"unfinished or were found damaged .*run night-render"):
                read(transient_copy, tmp_path)
    assert read_tile(transient_copy, SCENE, grey_view(None, 4, 3)).measured is None


def test_a_record_names_no_other_files(transient_copy):
    file = transient_copy.render_folder(SCENE) / "render.json"
    record = json.loads(file.read_text())
    for name in ("../000001/itof.exr", "/etc/passwd", "scene.json", "itof.exr\n", ""):
        file.write_text(json.dumps(record | {"files": record["files"] | {name: record["files"]["itof.exr"]}}))
        assert read_record(file.parent) is None
    del record["files"]["transient.exr"]
    file.write_text(json.dumps(record))
    with pytest.raises(
        RenderFileError, match=r"transient\.exr is not among the files that render\.json names"
    ):
        open_transient(transient_copy, SCENE)


def test_a_link_out_of_the_folder_is_not_followed(transient_copy, tmp_path):
    file = transient_copy.render_folder(SCENE) / "transient.exr"
    shutil.copy(file, tmp_path / "elsewhere.exr")
    file.unlink()
    file.symlink_to(tmp_path / "elsewhere.exr")
    with pytest.raises(OutsideError, match=r"transient\.exr is a symbolic link"):
        recorded_file(transient_copy, SCENE, "transient.exr")
    assert "symbolic link" in problems(transient_copy, SCENE)[0]
