"""The wheel, installed outside of the tree; the container's commands."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from night_commands import PRESET, TRAINING
from source_tree import ROOT

PACKAGES = ("commandline", "disk", "processes", "scenegen", "itof", "render", "model")
PACKED = {*PACKAGES, "data", "cli.py", "night_nlos.py", "pyproject.toml", "README.md", "LICENSE"}


def not_packed(folder, names):
    """What the wheel is built without, as a function of `shutil.copytree`."""
    return [name for name in names if name == "__pycache__" or (Path(folder) == ROOT and name not in PACKED)]


def run(*command, cwd):
    """Run a command to its end, without modules of other places."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.long
def test_the_four_commands_of_the_wheel_run_outside_of_the_tree(tmp_path):
    source, out, home = (tmp_path / name for name in ("source", "wheels", "elsewhere"))
    shutil.copytree(ROOT, source, ignore=not_packed)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    offline = ("--no-deps", "--no-index")
    run(*pip, "wheel", *offline, "--no-build-isolation", "-w", out, source, cwd=tmp_path)
    (wheel,) = out.iterdir()
    names = zipfile.ZipFile(wheel).namelist()
    shipped = [file.relative_to(ROOT / "data") for file in (ROOT / "data").rglob("*") if file.is_file()]
    assert [file for file in shipped if not any(name.endswith(f"share/night/{file}") for name in names)] == []
    for package in PACKAGES:
        assert f"{package}/py.typed" in names

    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv", cwd=tmp_path)
    python = tmp_path / "venv/bin/python"
    run(*pip, "--python", python, "install", *offline, wheel, cwd=tmp_path)
    own = tmp_path / "venv/lib/python3.11/site-packages"
    # Dependencies come from here; what pip has installed in the new place goes first.
    (own / "dependencies.pth").write_text("\n".join(p for p in sys.path if Path(p).name == "site-packages"))
    home.mkdir()
    (home / "preset.toml").write_text(PRESET)
    code = "import cli, itof, night_nlos; print(cli.__file__, itof.__file__, night_nlos.__version__)"
    cli_file, itof_file, version = run(python, "-c", code, cwd=home).split()
    assert Path(cli_file).is_relative_to(own)
    assert Path(itof_file).is_relative_to(own)
    assert version in wheel.name
    for command in (
        ("night-gen", "scenes", "data", "--preset", "preset.toml"),
        ("night-render", "data", "--product", "itof", "--error", "0.04"),
        ("night-train", "data", "--out", "run", *TRAINING, "--device", "cpu"),
        ("night-eval", "run", "data", "--out", "report", "--device", "cpu"),
    ):
        run(python.with_name(command[0]), *command[1:], cwd=home)
    assert (home / "report/index.html").is_file()


def test_the_container_runs_the_commands_of_the_readme():
    shown = re.search(r"^```sh\n(make .*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)[1]
    commands = [line.split("#")[0].strip() for line in shown.splitlines()]
    container = (ROOT / "Dockerfile").read_text()
    assert re.findall(r"^#   docker run --rm night (.*)$", container, re.M) == commands
    assert f'CMD ["{commands[0].replace(" ", chr(34) + ", " + chr(34))}"]' in container
