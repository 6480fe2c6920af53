"""``night-render export``: scenes that are not good, places that cannot be written, and full disks."""

import dataclasses
import json
import os
import shutil

import h5py
import numpy as np
import pytest
from full_disk import file_size_limit
from night_commands import night_here, refusal
from render_records import record_anew
from synthetic_dataset import edit_image, write_synthetic_dataset, write_synthetic_render

from render.products.conversion import ExportError
from render.products.dataset_export import export_dataset
from scenegen import FailureRecord, open_dataset, read_record, write_failure, write_record
from scenegen.render_folder import BadRender, write_bad_render

# What may be wrong with scene 000004.


def not_rendered(dataset, folder):
    shutil.rmtree(folder)


def given_up(dataset, folder):
    recipe = read_record(folder).recipe
    (folder / "render.json").unlink()
    write_failure(folder, FailureRecord(recipe=recipe, attempts=2, reason="the light is out"), "log")


def found_bad(dataset, folder):
    record = read_record(folder)
    (folder / "render.json").unlink()
    write_bad_render(folder, BadRender(record.recipe, record.files, ("dark",)))


def bad_again(dataset, folder):
    record = read_record(folder)
    write_bad_render(folder, BadRender(record.recipe, record.files, ("dark",)))


def rendered_otherwise(dataset, folder):
    record = read_record(folder)
    write_record(folder, dataclasses.replace(record, recipe=record.recipe.replace("0.05", "0.04")))


def damaged(dataset, folder):
    with (folder / "itof.exr").open("r+b") as file:
        file.seek(-50, os.SEEK_END)
        file.write(b"damage")


def damaged_truth(dataset, folder):
    (folder / "mirrored.exr").write_bytes((folder / "itof.exr").read_bytes())


def not_finite(dataset, folder):
    edit_image(
        folder / "itof.exr", hidden_50MHz_Im=lambda values: np.where(values == values[0, 0], np.nan, values)
    )
    record_anew(folder)


def parts_that_do_not_add_up(dataset, folder):
    edit_image(folder / "itof.exr", hidden_20MHz_Re=lambda values: values * 2)
    record_anew(folder)


def scene_edited(dataset, folder):
    file = dataset.scene_folder("000004") / "scene.json"
    file.write_text(file.read_text().replace('"irradiance": 1.0', '"irradiance": 2.0'))


def scene_gone(dataset, folder):
    shutil.rmtree(dataset.scene_folder("000004"))


def no_file(dataset, folder):
    (folder / "itof.exr").unlink()
    (folder / "itof.exr").mkdir()


WRONG = [  # how, the reason in the file, and words of the sentence
    (not_rendered, "not rendered", "it is not rendered: run night-render"),
    (given_up, "given up", "it could not be rendered (the light is out): run night-render"),
    (found_bad, "found bad", "its render was found bad (dark): run night-render"),
    (bad_again, "found bad", "found bad (dark): it was rendered twice to the same bytes, please report"),
    (rendered_otherwise, "other settings", "rendered with other settings than the dataset"),
    (damaged, "damaged", "itof.exr is not the file that night-render wrote"),
    (damaged_truth, "damaged", "mirrored.exr is not the file that night-render wrote"),
    (not_finite, "damaged", "hidden.50MHz.Im holds NaN or infinity"),
    (parts_that_do_not_add_up, "damaged", "direct and hidden part do not add up"),
    (scene_edited, "damaged", "are not those that were rendered: run night-gen scenes"),
    (scene_gone, "damaged", "is missing or empty: run night-gen scenes"),
    (no_file, "damaged", "itof.exr is not the file that night-render wrote"),
]


@pytest.mark.parametrize(("spoil", "reason", "words"), WRONG)
def test_a_scene_that_is_not_good_is_refused_or_left_out(
    rendered_copy, exported, tmp_path, spoil, reason, words
):
    dataset, out = open_dataset(rendered_copy), tmp_path / "x" / "out.h5"
    spoil(dataset, dataset.render_folder("000004"))
    sentence = refusal("night-render", "export", rendered_copy, "--out", out)
    assert sentence.startswith("scene 000004: ")
    assert sentence.count("000004: ") == 1
    assert words in sentence
    assert "leave out such scenes with --partial" in sentence
    assert not out.parent.exists() or list(out.parent.iterdir()) == []

    done = night_here("night-render", "export", rendered_copy, "--out", out, "--partial")
    assert done.returncode == 0, done.stderr
    first = done.stdout.splitlines()[0]
    assert first.startswith("left out: scene 000004: ")
    assert words in first
    kept = [0, 1, 2, 3, 5, 6]
    with h5py.File(out) as file, h5py.File(exported) as whole:
        assert json.loads(file["left_out"].asstr()[()]) == {"000004": reason}
        for name in set(whole) - {"splits", "frequencies_hz", "preset", "provenance", "left_out"}:
            np.testing.assert_array_equal(file[name][()], whole[name][()][kept])
        rows = np.concatenate([file[f"splits/{split}"][()] for split in ("train", "validation", "test")])
        assert sorted(rows) == list(range(6))
    assert str(rendered_copy).encode() not in out.read_bytes()


def test_scenes_of_another_size_or_recipe_than_the_first_one_are_refused(rendered_copy, tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "foreign", count=3)
    write_synthetic_render(dataset, dataset.scene("000001"), 12, 7)
    with pytest.raises(ExportError, match=r"scene 000001: its images are not those .*phasors 7x12x3"):
        export_dataset(dataset, tmp_path / "x.h5")
    assert export_dataset(dataset, tmp_path / "x.h5", partial=True).arrays["mask"] == (2, 14, 24)
    (rendered_copy / "renders" / "rendering.json").unlink()
    record = read_record(rendered_copy / "renders" / "000003")
    other = dataclasses.replace(record, recipe=record.recipe.replace("0.05", "0.04"))
    write_record(rendered_copy / "renders" / "000003", other)
    with pytest.raises(ExportError, match="scene 000003: it is rendered with other settings"):
        export_dataset(open_dataset(rendered_copy), tmp_path / "y.h5")


def test_several_scenes_without_renders_are_counted_in_one_sentence(three_missing, tmp_path):
    sentence = refusal("night-render", "export", three_missing, "--out", tmp_path / "x.h5")
    assert sentence.startswith("scene 000004: it is not rendered")
    assert "(2 more scenes cannot be exported)" in sentence


def test_a_dataset_without_any_good_scene_is_refused(seven_scenes, tmp_path):
    for options in ((), ("--partial",)):
        sentence = refusal("night-render", "export", seven_scenes, "--out", tmp_path / "x.h5", *options)
        assert "scene 000000: it is not rendered" in sentence
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("there.h5", "there.h5 exists already: give another name, or delete it"),
        ("folder.h5", "folder.h5 exists already"),
        ("link.h5", "link.h5 exists already"),
        ("there.zarr", "there.zarr exists already: give another name, or delete it"),
        ("x.mat", "the ending '.mat' is unknown: give a name that ends in .h5 or .zarr"),
        ("x", "the ending '' is unknown"),
        ("there.h5/x.h5", "cannot write"),
        ("there.h5/x.zarr", "cannot write"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused(seven_renders, tmp_path, name, words):
    (tmp_path / "there.h5").write_text("mine")
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "there.zarr").mkdir()
    (tmp_path / "link.h5").symlink_to("nowhere")
    before = sorted(tmp_path.iterdir())
    assert words in refusal("night-render", "export", seven_renders, "--out", tmp_path / name)
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "there.h5").read_text() == "mine"


def test_a_file_that_found_no_room_is_named_and_leaves_nothing(exported, seven_renders, tmp_path):
    dataset, whole = open_dataset(seven_renders), exported.stat().st_size
    for limit in (0, 1, 600, 3000, whole // 2, whole - 1):
        out = tmp_path / str(limit) / "x.h5"
        with file_size_limit(limit), pytest.raises(ExportError) as refused:
            export_dataset(dataset, out)
        assert str(refused.value) == f"cannot write {out}: File too large"
        assert list(out.parent.iterdir()) == []
