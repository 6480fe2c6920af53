"""What importing does: it loads no more than is needed, and has no other effect."""

import ast
import importlib
import json
import subprocess
import sys

import pytest
from source_tree import ROOMS, ROOT, files, sources

HEAVY = {"mitsuba", "drjit", "mitransient", "bpy", "torch"}
PACKAGES = [room for room in ROOMS if f"{room}/__init__.py" in files()]
LAZY = ("disk", "scenegen", "itof", "render", "model")


def loaded_by(code, tmp_path, **environment):
    """Names of all modules that a fresh process has loaded at the end of `code`; it may print nothing."""
    done = subprocess.run(
        [
            sys.executable,
            "-W",
            "error",
            "-c",
            f"{code}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))",
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={"PATH": "", "HOME": str(tmp_path), "MPLCONFIGDIR": str(tmp_path / "mpl")} | environment,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    return set(json.loads(done.stdout))


def of(package, modules):
    return {module for module in modules if f"{module}.".startswith(f"{package}.")}


@pytest.mark.long
@pytest.mark.parametrize("room", ROOMS)
def test_importing_does_nothing_but_import(room, tmp_path):
    code = f"import {room}\nfor name in getattr({room}, '__all__', ()): getattr({room}, name)"
    modules = loaded_by(code, tmp_path)
    assert modules & (HEAVY - {"torch"} if room in ("model", "night_nlos") else HEAVY) == set()
    assert {entry.name for entry in tmp_path.iterdir()} <= {"mpl"}


def test_settings_and_plans_load_no_machinery(tmp_path):
    modules = loaded_by("import cli, model.settings, render.settings", tmp_path)
    assert modules & HEAVY == set()
    ours = {name for name in of("model", modules) if not name.startswith("model.settings")}
    assert ours == {"model", "model.refinement", "model.refinement.settings"}
    assert of("render", modules) == {"render", "render.settings", "render.options", "render.backend"}
    plan = loaded_by("import render.farm.plan", tmp_path)
    assert plan & HEAVY == set()
    assert of("render", plan) & {"render.transport", "render.rendering", "render.products"} == set()


def test_a_capture_is_checked_without_a_network_a_file_library_or_pictures(tmp_path):
    modules = loaded_by("import itof.capture.checking, itof.capture.importing", tmp_path)
    assert modules & {*HEAVY, "h5py", "matplotlib", "scipy.io"} == set()


def test_the_process_that_reads_a_measurement_loads_little(tmp_path):
    modules = loaded_by("import itof.files.measurement_child", tmp_path)
    assert modules & {*HEAVY, "pydantic", "scipy", "tqdm"} == set()


@pytest.mark.long
def test_using_a_network_does_not_load_what_training_needs(finished_run, tmp_path):
    code = (
        f"import model\npredictor = model.load({str(finished_run)!r}, 'cpu')\n"
        "assert predictor.predict(predictor.reference).mask.ndim == 2\n"
        "model.predict_file, model.export_onnx"
    )
    modules = loaded_by(code, tmp_path)
    assert "torch" in modules
    assert of("model.data", modules) | of("model.training", modules) | of("model.judging", modules) == set()


@pytest.mark.parametrize(
    "package", [package for package in PACKAGES if package not in (*LAZY, "commandline")]
)
def test_a_package_says_what_it_offers(package):
    tree = sources()[f"{package}/__init__.py"]
    assert ast.get_docstring(tree)
    assert sorted(declared(tree)) == sorted(imported(tree))


@pytest.mark.parametrize("package", LAZY)
def test_a_lazy_package_offers_the_names_of_its_stub(package):
    stub = ast.parse((ROOT / package / "__init__.pyi").read_text())
    assert sorted(declared(stub)) == sorted(imported(stub))
    module = importlib.import_module(package)
    assert sorted(module.__all__) == sorted(declared(stub))
    for name in module.__all__:
        home = getattr(getattr(module, name), "__module__", package)  # a constant has none
        assert home.split(".")[0] in (package, "types", "typing")


def declared(tree):
    """Names in `__all__`."""
    return next(
        [element.value for element in node.value.elts]
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    )


def imported(tree):
    return [alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]


@pytest.mark.parametrize(
    "file", [file for file in files() if file.endswith("/__init__.py") and file.count("/") == 2]
)
def test_a_wing_says_what_lives_there_and_imports_nothing(file):
    tree = sources()[file]
    assert ast.get_docstring(tree)
    assert len(tree.body) == 1
