"""``night-train --for``: from a preset of scenes to a judged network."""

import json
import shutil
from dataclasses import replace

import pytest
from night_commands import night_here, refusal
from training_runs import config_of

from commandline import networks_of_presets

pytestmark = [pytest.mark.long, pytest.mark.usefixtures("one_thread")]
SMALL = """
[hidden_object]
shapes = ["cube", "sphere"]
[camera]
width = 16
height = 12
[itof]
frequencies_hz = [20e6, 60e6]
"""
QUICK = ("--width", 4, "--batch-size", 8, "--max-epochs", 2, "--set", "run.epoch_scenes=16")
QUICK += ("--set", "input.channels.bounce_images=false", "--set", "run.workers=1", "--no-progress")


@pytest.fixture
def few_scenes(monkeypatch):
    few = replace(networks_of_presets._SCENES, count=9)
    monkeypatch.setattr(networks_of_presets, "_SCENES", few)


@pytest.mark.usefixtures("few_scenes")
def test_one_command_makes_scenes_a_network_and_a_report_and_repeats_itself_to_the_bit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(SMALL)
    done = night_here("night-train", "--for", "mine.toml", "--out", "net", *QUICK)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "the training starts from new weights, because options give input and network" in said
    assert "32 samples in about " in said
    assert "(--max-epochs 2 --set run.epoch_scenes=16 repeats it, " in said
    assert "expect an MAE of about " in said
    assert "test split, 3 scenes" in said
    assert (tmp_path / "net-report" / "index.html").is_file()
    assert config_of(tmp_path / "net")["settings"]["run"]["max_epochs"] == 2
    assert "net exists already: resume it" in refusal("night-train", "--for", "mine.toml", "--out", "net")
    weights = (tmp_path / "net" / "best.safetensors").read_bytes()
    # Whatever an interruption left of it: nothing, or the whole run.
    for resume in ((), ("--resume",)):
        if not resume:
            shutil.rmtree(tmp_path / "net")
        again = night_here("night-train", "--for", "mine.toml", "--out", "net", *QUICK, "--json", *resume)
        assert again.returncode == 0, again.stderr
        assert json.loads(again.stdout)["run"] == "net"
        assert (tmp_path / "net" / "best.safetensors").read_bytes() == weights


@pytest.mark.usefixtures("few_scenes")
def test_a_budget_becomes_epochs_and_the_nearest_network_is_never_spoilt(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text("[camera]\nwidth = 40\nheight = 30\n")
    given = ("--for", "mine.toml", "--out", "net", "--set", "run.fresh_error=0.2", "--no-progress")
    told = refusal("night-train", *given, "--budget", "0.1s")
    assert "a budget of 0.1 s is too small: one epoch of 256 scenes takes " in told
    assert not (tmp_path / "net").exists()
    done = night_here("night-train", *given, "--max-epochs", 1, "--set", "run.epoch_scenes=16")
    assert done.returncode == 0, done.stderr
    assert (
        "starts from night-40x30, which is for one corner, 20, 50, 60 MHz and images of 40x30" in done.stdout
    )
    assert "; before the training, it has " in done.stdout
    assert config_of(tmp_path / "net")["started_from"]["run"] == "night-40x30"
    losses = [line.split(",")[3] for line in (tmp_path / "net" / "history.csv").read_text().splitlines()[1:]]
    assert len(losses) == 2  # of the start, and of the epoch
