"""Every public function takes a path as text or as a `pathlib.Path`: mypy proves that both work."""

import importlib
import inspect
import re
import subprocess
import sys

import pytest
import trimesh
from night_commands import night
from scene_folders import contents

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
