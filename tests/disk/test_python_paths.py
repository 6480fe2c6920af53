"""Every public function takes a path as text or as a `pathlib.Path`."""

import dataclasses
import importlib
import inspect
import re
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from exported_scene import HEIGHT, WIDTH
from measurements import assert_same
from night_commands import night
from scene_folders import contents

import disk
import itof
import model
import render
import scenegen

PACKAGES = ("scenegen", "itof", "render", "model")
# A dataset is made by `open_dataset` and `make_dataset`; its `root` is always a Path.
MADE_BY_US = {"scenegen.Dataset.__init__.root"}


def public_functions():
    """(name, function) of all public functions, and methods of public classes."""
    for package in map(importlib.import_module, PACKAGES):
        for name in sorted(package.__all__):
            offered = getattr(package, name)
            if inspect.isclass(offered):
                for method, function in inspect.getmembers(offered, is_function):
                    if method == "__init__" or not method.startswith("_"):
                        yield f"{package.__name__}.{name}.{method}", function
            elif inspect.isfunction(offered):
                yield f"{package.__name__}.{name}", offered


def is_function(member):
    return inspect.isfunction(member) or inspect.ismethod(member)


def annotations(function):
    """Text of the annotation of each parameter."""
    parameters = inspect.signature(function).parameters.values()
    return {parameter.name: str(parameter.annotation) for parameter in parameters}


def test_no_public_function_takes_only_objects_as_paths():
    found = [
        (f"{name}.{parameter}", text)
        for name, function in public_functions()
        for parameter, text in annotations(function).items()
    ]
    assert len(found) > 200
    assert [
        (name, text) for name, text in found if re.search(r"\bPath\b", text) and name not in MADE_BY_US
    ] == []
    takes_paths = [name for name, text in found if "PathLike" in text]
    assert {"scenegen.open_dataset.root", "itof.read_image.path", "model.load.run"} <= set(takes_paths)
    # Words that mean a path are never text alone.
    paths = r"\.(path|file|folder|root|out|run|renders|measurement_file|name_or_file)$"
    assert [name for name, text in found if re.search(paths, name) and text == "str"] == []


def test_scenes_and_records_are_found_by_text(transient_dataset, tmp_path):
    root, folder = str(transient_dataset.root), str(transient_dataset.render_folder("000000"))
    assert scenegen.open_dataset(root) == transient_dataset
    assert scenegen.read_record(folder) == scenegen.read_record(transient_dataset.render_folder("000000"))
    assert scenegen.read_failure(folder) is None
    assert disk.inside(root, "scenes") == transient_dataset.root / "scenes"
    hashes, file = disk.FileHashes(folder), f"{folder}/itof.exr"
    hashes.learn(file, disk.sha256_of(file))
    assert hashes.sha256(file) == disk.sha256_of(file)
    new, failure = str(tmp_path / "new"), scenegen.FailureRecord(recipe="r", attempts=1, reason="none")
    scenegen.write_failure(new, failure, "log")
    assert scenegen.read_failure(new) == failure
    scenegen.remove_failure(new)
    record = scenegen.read_record(folder)
    bad = scenegen.BadRender(recipe=record.recipe, files=record.files, problems=("wrong",))
    scenegen.write_bad_render(new, bad)
    assert scenegen.read_bad_render(new) == bad
    scenegen.forget_bad_render(new, dataclasses.replace(record, recipe="another"))
    scenegen.write_record(new, record)
    scenegen.write_index(new, transient_dataset.index)
    assert {file.name for file in (tmp_path / "new").iterdir()} == {"render.json", "dataset.json"}


def test_presets_are_found_by_objects(tmp_path):
    (tmp_path / "my.toml").write_text("[dataset]\ncount = 5\n")
    assert scenegen.load_preset(tmp_path / "my.toml") == scenegen.load_preset(str(tmp_path / "my.toml"))
    (tmp_path / "net.toml").write_text("[network]\nwidth = 3\n")
    found = model.training_preset(tmp_path / "net.toml")
    assert found == ({"network": {"width": 3}}, str(tmp_path / "net.toml"))


@pytest.mark.long
def test_images_and_exports_are_read_and_written_at_text(transient_dataset, tmp_path):
    folder = str(transient_dataset.render_folder("000000"))
    made = render.convert_to_itof(transient_dataset, "000000", str(tmp_path / "new"))
    assert itof.read_image(str(made)).phasors()[0].shape == (HEIGHT, WIDTH, 3)
    render.export_tal(transient_dataset, "000000", str(tmp_path / "capture.hdf5"))
    render.write_movie(f"{folder}/transient.exr", str(tmp_path / "light.gif"))
    truth = itof.DepthMap.read(f"{folder}/mirrored.exr")
    truth.write(str(tmp_path / "truth.exr"), {})
    np.testing.assert_array_equal(itof.DepthMap.read(tmp_path / "truth.exr").mask, truth.mask)
    assert {file.name for file in tmp_path.iterdir()} == {"new", "capture.hdf5", "light.gif", "truth.exr"}


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_runs_are_used_at_text(finished_run, exr, tmp_path):
    assert (
        model.run_settings(str(finished_run))["network"]["width"]
        == model.load(str(finished_run)).config.settings.network.width
    )
    for kind in (str, type(tmp_path)):
        out = kind(tmp_path / kind.__name__)
        model.predict_file(kind(finished_run), kind(exr), out, device="cpu", progress=False)
    assert_same(tmp_path / "str", tmp_path / type(tmp_path).__name__)


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_runs_are_made_and_judged_at_text(closed_form_scenes, tmp_path):
    run, report = str(tmp_path / "run"), str(tmp_path / "report")
    settings = model.settings_from_dict(
        {"network": {"width": 2}, "run": {"max_epochs": 1, "device": "cpu", "progress": False}}, "here"
    )
    model.train(closed_form_scenes, run, settings)
    model.evaluate(run, closed_form_scenes, report, device="cpu", progress=False)
    model.export_onnx(run, str(tmp_path / "net.onnx"))
    assert {file.name for file in tmp_path.iterdir()} == {"run", "report", "net.onnx"}


@pytest.mark.long
def test_a_dataset_is_made_in_one_call_also_from_a_script_that_guards_nothing(tmp_path):
    (tmp_path / "my.toml").write_text(
        '[dataset]\ncount = 2\n[hidden_object]\nshapes = ["mesh:box.ply"]\ncomposite_fraction = 0.0\n'
    )
    trimesh.creation.box().export(tmp_path / "box.ply")
    script = tmp_path / "script.py"
    script.write_text(
        "from scenegen import make_dataset\n"
        f"dataset = make_dataset('made', {str(tmp_path / 'my.toml')!r}, progress=False)\n"
        "import sys\nassert 'bpy' not in sys.modules\nprint(dataset.sentence())\n"
    )
    (tmp_path / "cwd").mkdir()
    done = subprocess.run(
        [sys.executable, script], cwd=tmp_path / "cwd", capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("2 scenes in made")
    made = night("night-gen", "scenes", tmp_path / "other", "--preset", tmp_path / "my.toml")
    assert made.returncode == 0, made.stderr
    assert contents(tmp_path / "other") == contents(tmp_path / "cwd" / "made")
