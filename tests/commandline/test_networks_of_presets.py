"""``night-train --for``: from a preset of scenes to a judged network."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from measurements import write_npz
from training_runs import config_of

from itof.wall.wall_view import WallView
from scenegen import load_preset
from scenegen.pose import wall_geometry
from scenegen.sampling import walls_of

pytestmark = pytest.mark.long
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


# In a process of its own: one that has loaded Blender, as the tests may have, starts no other with it.
FEW_SCENES = """
import sys
from dataclasses import replace
import cli
from commandline import networks_of_presets
networks_of_presets._SCENES = replace(networks_of_presets._SCENES, count=9)
if __name__ == "__main__":
    cli.night_train(sys.argv[1:])
"""


def night_train(folder, *words):
    """The command, whose dataset has nine scenes only."""
    command = [sys.executable, "-c", FEW_SCENES, *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_one_command_makes_scenes_a_network_and_a_report_and_repeats_itself_to_the_bit(tmp_path):
    (tmp_path / "mine.toml").write_text(SMALL)
    done = night_train(tmp_path, "--for", "mine.toml", "--out", "net", *QUICK)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    assert "the training starts from new weights, because options give input and network" in said
    assert "32 samples in about " in said
    assert "(--max-epochs 2 --set run.epoch_scenes=16 repeats it, " in said
    assert "nobody has measured what error so few samples leave (no object: " in said
    assert "test split, 3 scenes" in said
    assert (tmp_path / "net-report" / "index.html").is_file()
    assert config_of(tmp_path / "net")["settings"]["run"]["max_epochs"] == 2
    refused = night_train(tmp_path, "--for", "mine.toml", "--out", "net")
    assert (refused.returncode, "net exists already: resume it" in refused.stderr) == (2, True)
    refused = night_train(tmp_path, "--for", "mine.toml", "--out", "net", "--resume", "--budget", "1min")
    assert (refused.returncode, "the run has its length already" in refused.stderr) == (2, True)
    (tmp_path / "other.toml").write_text(SMALL.replace("cube", "cone"))
    shutil.copytree(tmp_path / "net-scenes", tmp_path / "new-scenes")
    refused = night_train(tmp_path, "--for", "other.toml", "--out", "new", *QUICK)
    assert (refused.returncode, "holds scenes of another preset: remove it" in refused.stderr) == (2, True)
    weights = (tmp_path / "net" / "best.safetensors").read_bytes()
    # Whatever an interruption left of it: nothing, or the whole run.
    for resume in ((), ("--resume",)):
        if not resume:
            shutil.rmtree(tmp_path / "net")
        again = night_train(tmp_path, "--for", "mine.toml", "--out", "net", *QUICK, "--json", *resume)
        assert again.returncode == 0, again.stderr
        assert json.loads(again.stdout)["run"] == "net"
        assert (tmp_path / "net" / "best.safetensors").read_bytes() == weights


def test_a_budget_becomes_epochs_and_the_nearest_network_is_never_spoilt(tmp_path):
    paper = load_preset("paper")
    view = WallView(**wall_geometry(paper.camera, walls_of(paper)[0]))
    hz = paper.itof.frequencies_hz
    write_npz(
        tmp_path / "corner.npz",
        phasors=view.direct_phasors(40, 30, hz),
        frequencies_hz=np.array(hz),
        horizontal_fov_deg=60.0,
    )
    given = (
        "--for",
        "corner.npz",
        "--gap",
        0.7,
        "--out",
        "net",
        "--set",
        "run.fresh_error=0.2",
        "--no-progress",
    )
    refused = night_train(tmp_path, *given, "--budget", "0.1s")
    assert refused.returncode == 2
    assert "a budget of 0.1 s is too small: one epoch of 32 scenes takes " in refused.stderr
    assert not (tmp_path / "net").exists()
    done = night_train(tmp_path, *given, "--max-epochs", 1, "--set", "run.epoch_scenes=16")
    assert done.returncode == 0, done.stderr
    assert (
        "starts from night-40x30, which is for one corner, 20, 50, 60 MHz and images of 40x30" in done.stdout
    )
    assert "; before the training, it has " in done.stdout
    assert "middle wall and hidden region are the paper's, to the right" in done.stderr
    assert config_of(tmp_path / "net")["started_from"]["run"] == "night-40x30"
    losses = [line.split(",")[3] for line in (tmp_path / "net" / "history.csv").read_text().splitlines()[1:]]
    assert len(losses) == 2  # of the start, and of the epoch
