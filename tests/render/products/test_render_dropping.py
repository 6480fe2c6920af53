"""Deletion of transients: it asks, checks what stays, and a kill leaves no record without its files."""

import os
import pty
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from kill_points import names
from night_commands import refusal, words
from render_records import problems
from render_runs import results

from disk.byte_size import size
from render.products.conversion import ExportError
from render.products.transient_deletion import delete_transients, transient_bytes
from render.products.verification import verify
from scenegen import open_dataset, read_record


@pytest.fixture
def folder(transient_copy):
    """Render folder of the scene that has transients."""
    return transient_copy.render_folder("000000")


def test_a_scene_without_its_transients_stays_a_whole_render(transient_copy, folder):
    before, images = read_record(folder), (folder / "itof.exr").read_bytes()
    found = sum((folder / name).stat().st_size for name in ("transient.exr", "mirrored_transient.exr"))
    assert transient_bytes(transient_copy, ["000000"]) == found
    assert delete_transients(transient_copy, ["000000"]) == found
    assert {f.name for f in folder.iterdir()} == {"itof.exr", "mirrored.exr", "render.json"}
    assert (folder / "itof.exr").read_bytes() == images
    kept = {name: before.files[name] for name in ("itof.exr", "mirrored.exr")}
    assert read_record(folder) == replace(before, files=kept)
    assert problems(transient_copy) == []
    assert delete_transients(transient_copy, ["000000"]) == 0


@pytest.mark.parametrize("name", ["itof.exr", "mirrored.exr"])
@pytest.mark.parametrize("damage", ["truncated", "missing", "another"])
def test_transients_stay_where_the_images_are_not_whole(transient_copy, folder, name, damage):
    file = folder / name
    if damage == "truncated":
        file.write_bytes(file.read_bytes()[:-100])
    elif damage == "missing":
        file.unlink()
    else:  # a good image, and not the one that was rendered
        file.write_bytes((folder / ("mirrored.exr" if name == "itof.exr" else "itof.exr")).read_bytes())
    with pytest.raises(ExportError, match=rf"{name} is missing or not what was rendered"):
        delete_transients(transient_copy, ["000000"])
    assert (folder / "transient.exr").is_file()
    assert "transient.exr" in read_record(folder).files


def test_transients_of_scenes_without_a_record_stay(transient_copy, folder):
    with pytest.raises(ExportError, match="1 of 2 scenes, first 000001, are not rendered"):
        delete_transients(transient_copy, ["000000", "000001"])
    (folder / "render.json").write_text("{")
    with pytest.raises(ExportError, match="1 of 1 scenes, first 000000, are not rendered"):
        delete_transients(transient_copy, ["000000"])
    assert (folder / "transient.exr").is_file()


def test_one_damaged_scene_keeps_the_transients_of_all(rendered_copy):
    dataset = open_dataset(rendered_copy)
    file = dataset.render_folder("000006") / "itof.exr"
    file.write_bytes(file.read_bytes()[:-1])
    before = dataset.rendering, transient_bytes(dataset, dataset.ids())
    sentence = refusal("night-render", "drop-transients", rendered_copy, "--yes")
    assert "scene 000006: itof.exr is missing or not what was rendered" in sentence
    assert (dataset.rendering, transient_bytes(dataset, dataset.ids())) == before


def test_what_an_interrupted_deletion_left_is_deleted_by_the_next(transient_copy, folder):
    kept = (folder / "transient.exr").read_bytes()
    delete_transients(transient_copy, ["000000"])
    (folder / "transient.exr").write_bytes(kept)  # the record was written, the file not yet deleted
    assert delete_transients(transient_copy, ["000000"]) == len(kept)
    assert not (folder / "transient.exr").exists()


def test_without_a_terminal_nothing_is_deleted_unless_told_so(transient_copy, folder):
    found = size(transient_bytes(transient_copy, ["000000"]))
    sentence = refusal("night-render", "drop-transients", transient_copy.root, "--only", "000000")
    assert sentence == (
        f"this would delete the transients of 1 scene, {found}, which only rendering brings back: "
        "give --yes to delete without a question"
    )
    assert (folder / "transient.exr").is_file()


@pytest.mark.long
@pytest.mark.parametrize(
    ("answer", "said", "code"),
    [("n", "nothing was deleted", 2), ("\x04", "nothing was deleted", 2), ("y", "freed", 0)],
)
def test_on_a_terminal_the_command_asks(transient_copy, folder, answer, said, code):
    terminal, end = pty.openpty()
    command = words("night-render", "drop-transients", transient_copy.root, "--only", "000000")
    with subprocess.Popen(command, stdin=end, stdout=end, stderr=end) as process:
        os.close(end)
        output = b""
        while b"[y/N]" not in output:
            output += os.read(terminal, 1000)
        os.write(terminal, answer.encode() + b"\n")
        output = b""
        while said.encode() not in output:
            output += os.read(terminal, 1000)
    os.close(terminal)
    assert process.returncode == code
    assert (folder / "transient.exr").is_file() == (code != 0)


CAMPAIGN = """
import itertools, os, shutil, sys
from pathlib import Path
from kill_points import CHANGES, killed_before
from render.products.transient_deletion import delete_transients
from scenegen import open_dataset

def copied(source, target):
    # Locks are changed in place, images are not.
    (os.link if source.endswith(".exr") else shutil.copy2)(source, target)

for number in itertools.count():
    copy = Path(sys.argv[2], str(number))
    shutil.copytree(sys.argv[1], copy, copy_function=copied)
    dataset = open_dataset(copy)
    if not killed_before(number, CHANGES, lambda: delete_transients(dataset, dataset.ids())):
        break
"""


@pytest.mark.thorough
def test_a_kill_leaves_no_record_without_its_files_and_the_next_call_goes_on(seven_renders, tmp_path):
    tests = Path(__file__).parents[2] / "support"
    subprocess.run([sys.executable, "-c", CAMPAIGN, seven_renders, tmp_path], check=True, cwd=tests)
    copies = sorted(tmp_path.iterdir(), key=lambda copy: int(copy.name))
    whole = results(copies.pop())  # of the one that was not killed
    assert not any("transient" in name for name in whole)
    assert len(copies) > 7 * 4
    for copy in copies:
        dataset = open_dataset(copy)
        records = [read_record(dataset.render_folder(scene_id)) for scene_id in dataset.ids()]
        lacking = [len(record.files) for record in records if len(record.files) < 4]
        assert not lacking or dataset.rendering.product == "itof"  # else they would be rendered again
        report = verify(dataset, dataset.ids())
        assert (report.checked, report.problems, report.damaged_scenes) == (7, {}, {})
        delete_transients(dataset, dataset.ids())
        assert results(copy) == whole
        assert names(copy / "renders" / "000000") == ["itof.exr", "mirrored.exr", "render.json"]
