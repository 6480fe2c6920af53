"""The trained networks that come with the program: found by name, whole, described, as good as they say."""

import json
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measurements import write_npz
from night_commands import night, night_here, refusal

import model
from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.run_folder.shipped import run_folder
from scenegen import load_preset

ROOT = Path(__file__).parents[3]
MOST_BYTES = 40e6  # of all of them
RUNS = model.shipped_runs()
# Scenes that a network is for, and what 16 of them must give. Its card says more; single scenes scatter by
# 0.1 and 1 to 2 cm, their mean by a quarter of that.
ONE_CORNER = ("judge", 0.82, 0.04)  # preset, smallest mIoU, largest MAE in metres
MANY_CORNERS = ("judge-any-corner", 0.76, 0.05)
SCENES = {"any-corner": MANY_CORNERS}

pytestmark = pytest.mark.usefixtures("one_thread")


def measurement(predictor):
    """The light of the run's wall, with some hidden light."""
    direct = predictor.reference
    return direct + 2e-3 * np.abs(direct) * np.exp(0.7j)


def test_the_script_of_its_card_writes_the_preset_of_any_corner(tmp_path):
    file = tmp_path / "any-object.toml"
    subprocess.run([sys.executable, ROOT / "benchmarks" / "random_objects.py", file], check=True)
    trained_on = load("any-corner", "cpu").config.fresh.preset
    assert replace(load_preset(file), dataset=trained_on.dataset) == trained_on


def test_there_is_one_and_all_together_are_small():
    assert "night-40x30" in RUNS
    files = [file for folder in RUNS.values() for file in folder.iterdir()]
    assert sum(file.stat().st_size for file in files) < MOST_BYTES


@pytest.mark.parametrize("name", RUNS)
def test_each_is_a_run_with_a_card_that_calibrates_itself(name):
    predictor = load(name, "cpu")
    assert predictor.config.inputs.self_calibrates
    card = (RUNS[name] / "README.md").read_text()
    for words in ("Training data", "Command", "Results", "Limits"):
        assert f"## {words}\n" in card
    assert {file.name for file in RUNS[name].iterdir()} == {
        *("run.json", "best.safetensors", "history.csv", "README.md")
    }


@pytest.mark.parametrize("name", RUNS)
def test_the_wheel_has_them(name):
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    assert files[f"share/night/weights/{name}"] == [f"data/weights/{name}/*"]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "night-40x30" else pytest.mark.long) for name in RUNS]
)
def test_the_command_finds_it_by_name(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    predictor = load(name, "cpu")
    write_npz(tmp_path / "m.npz", phasors=measurement(predictor))
    done = night_here("night-eval", "predict", name, "m.npz", "--out", "out", "--device", "cpu")
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "prediction.json").read_text())
    assert record["run"] == str(RUNS[name].resolve())
    expected_m = record["images"][0]["expected_mae_m"]
    assert (expected_m is None) == ("warning: " in done.stderr)  # most networks see no object in this light
    told = "after the warning, its error is unknown"
    assert f"; {told if expected_m is None else f'expected MAE {100 * expected_m:.1f} cm'}" in done.stdout


def test_a_folder_comes_before_a_network_of_its_name(seeing_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = next(iter(RUNS))
    assert run_folder(name) == RUNS[name]
    Path(name).symlink_to(seeing_run)
    assert load(name, "cpu").config == load(seeing_run, "cpu").config


def test_a_missing_run_names_those_that_there_are(tmp_path):
    with pytest.raises(RunError, match=f"there is no folder nowhere: .* or give one of .*{next(iter(RUNS))}"):
        load("nowhere", "cpu")
    told = refusal("night-eval", "predict", "nowhere", tmp_path / "m.npz", "--out", tmp_path / "out")
    assert "or give one of " in told


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if "40x30" in name else pytest.mark.thorough) for name in RUNS]
)
def test_it_finds_objects_in_scenes_that_nobody_trained_on(name, tmp_path):
    config = load(name, "cpu").config
    size = f"{config.image_width}x{config.image_height}"
    preset, least_miou, largest_mae_m = SCENES.get(name, ONE_CORNER)
    new = tmp_path / "new"
    for command in (
        ("night-gen", "scenes", new, "--preset", preset, "--count", 16, "--seed", 20261122),
        ("night-render", new, "--product", "itof", "--resolution", size, "--error", 0.04),
        ("night-eval", name, new, "--out", tmp_path / "report"),
    ):
        done = night(*command)
        assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "report" / "metrics.json").read_text())
    assert metrics["prediction"]["miou"]["mean"] > least_miou
    assert metrics["prediction"]["depth_mae_m"]["mean"] < largest_mae_m
