"""What an installation without the extras can do, and what it says of the rest."""

import ast
import re
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from night_commands import refusal
from source_tree import ROOT, sources

from itof.wall.expected_wall import ExpectedWall

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PARTS = ("cluster", "export", "onnx", "render", "report", "scenes")
COMMANDS = {
    "cluster": ("night-render", "{data}"),
    "report": ("night-eval", "night-40x30", "{data}", "--out", "{out}"),
    "render": ("night-render", "{data}"),
    "scenes": ("night-gen", "preview", "{data}"),
    "onnx": ("night-eval", "export", "night-40x30", "--out", "{out}.onnx"),
}
# Without the packages of all extras: every public name is loaded, a network predicts, another is trained.
WITHOUT_EXTRAS = """
import importlib.metadata, pathlib, sys
blocked, installed = sys.argv[1].split(","), importlib.metadata.distribution
def distribution(name):
    if name in blocked:
        raise importlib.metadata.PackageNotFoundError(name)
    return installed(name)
importlib.metadata.distribution = distribution
sys.modules.update(dict.fromkeys(blocked))
sys.path.append(sys.argv[2])
import cli, itof, model, night_nlos, render, scenegen
for package in (itof, model, night_nlos, render, scenegen):
    for name in package.__all__:
        getattr(package, name)
words = "predict night-40x30 corner.npz --out predicted --device cpu --force"
cli.night_eval(words.split(), standalone_mode=False)
words = "--out run --max-epochs 1 --width 2 --device cpu --set input.channels.bounce_images=false"
from synthetic_dataset import write_synthetic_dataset
write_synthetic_dataset(pathlib.Path("scenes"))
cli.night_train(["scenes", *words.split()], standalone_mode=False)
"""


def packages_of(extra):
    """Names by which the packages of an extra that is not installed anyway are imported."""
    base, found = (
        [re.match(r"[\w-]+", each)[0].replace("-", "_") for each in packages]
        for packages in (PROJECT["dependencies"], PROJECT["optional-dependencies"][extra])
    )
    return [name for name in found if name not in base]


def test_the_packages_that_the_code_asks_for_are_those_of_the_extras():
    asked = {}
    for tree in sources().values():
        for call in ast.walk(tree):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "need":
                extra, packages = (ast.literal_eval(argument) for argument in call.args[:2])
                asked.setdefault(extra, set()).update(packages)
    assert {extra: sorted(packages) for extra, packages in asked.items()} == {
        extra: packages_of(extra) for extra in PARTS
    }
    assert PROJECT["optional-dependencies"]["all"] == [f"night-nlos[{','.join(PARTS)}]"]


@pytest.mark.parametrize("extra", COMMANDS)
def test_a_command_without_its_extra_ends_with_the_line_that_installs_it(
    extra, seven_scenes, tmp_path, monkeypatch
):
    first = packages_of(extra)[0]
    monkeypatch.setitem(sys.modules, first, None)
    command = [word.format(data=seven_scenes, out=tmp_path / "out") for word in COMMANDS[extra]]
    assert f"needs the package {first}: pip install 'night-nlos[{extra}]'" in refusal(*command)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_all_names_load_and_networks_predict_and_learn_without_the_extras(tmp_path):
    wall = ExpectedWall.of_plane([-0.5, 0.1, 0.6], 40, 30, (20e6, 50e6, 60e6), 60.0)
    np.savez(tmp_path / "corner.npz", phasors=wall.direct, frequencies_hz=[20e6, 50e6, 60e6])
    blocked = [name for extra in PARTS for name in packages_of(extra)]
    blocked.remove("jinja2")  # torch needs it, too
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS, ",".join(blocked), ROOT / "tests/support"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "predicted" / "000000.exr").is_file()
    assert (tmp_path / "run" / "best.safetensors").is_file()
