"""Runs at half their size, which predict as before."""

import json
import shutil

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from safetensors.torch import load_file
from training_runs import edit_weights, settings

from model.prediction.predictor import load
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def compacted(finished_run, tmp_path_factory):
    out = tmp_path_factory.mktemp("compact") / "small"
    done = night_here("night-eval", "compact", finished_run, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["bytes"] == sum(file.stat().st_size for file in out.iterdir())
    return out


def test_weights_are_rounded_to_16_bits_and_nothing_else_changes(compacted, finished_run):
    assert {file.name for file in compacted.iterdir()} == {"run.json", "history.csv", "best.safetensors"}
    for name in ("run.json", "history.csv"):
        assert (compacted / name).read_bytes() == (finished_run / name).read_bytes()
    before, after = (load_file(run / "best.safetensors") for run in (finished_run, compacted))
    for name, weight in before.items():
        assert after[name].dtype == torch.float16
        # Half floats have 11 binary digits; the smallest steps are 2^-24.
        np.testing.assert_allclose(after[name].float(), weight, rtol=2**-11, atol=2**-25)
    size = (compacted / "best.safetensors").stat().st_size
    assert size < 0.6 * (finished_run / "best.safetensors").stat().st_size


def test_predictions_are_the_same_to_rounding(compacted, finished_run, phasors):
    before, after = (load(run, "cpu").predict(phasors) for run in (finished_run, compacted))
    change = np.abs(before.phasor - after.phasor) / np.abs(before.phasor).max()
    assert (change > 2e-3).mean() < 0.01  # but for components at the dead zone, which become 0 or 0.05
    assert {weight.dtype for weight in load(compacted).network.state_dict().values()} == {torch.float32}


def test_a_history_that_is_no_history_is_not_published(finished_run, tmp_path):
    run = shutil.copytree(finished_run, tmp_path / "run")
    (tmp_path / "private.txt").write_text("private")
    (run / "history.csv").unlink()
    (run / "history.csv").symlink_to(tmp_path / "private.txt")
    message = refusal("night-eval", "compact", run, "--out", tmp_path / "small")
    assert message.startswith(f"{run / 'history.csv'} is damaged")
    assert not (tmp_path / "small").exists()


def test_a_training_starts_from_a_compact_run(compacted, closed_form_scenes, tmp_path):
    chosen = settings(max_epochs=1)
    train(closed_form_scenes, tmp_path / "next", chosen, start_from=compacted)
    assert load(tmp_path / "next").config.started_from is not None


def test_a_compact_run_cannot_be_resumed_and_stays_as_it_is(compacted, closed_form_scenes):
    before = {file.name: file.read_bytes() for file in compacted.iterdir()}
    message = refusal("night-train", closed_form_scenes.root, "--out", compacted, "--resume")
    assert "has weights but no checkpoint" in message
    assert f"--from {compacted} and another --out" in message
    assert {file.name: file.read_bytes() for file in compacted.iterdir()} == before


def test_runs_that_cannot_be_compacted_are_refused(finished_copy, compacted, tmp_path):
    assert "exists already" in refusal("night-eval", "compact", finished_copy, "--out", compacted)
    edit_weights(finished_copy, lambda name, weight: weight * 1e6)
    assert "too large for 16 bits" in refusal("night-eval", "compact", finished_copy, "--out", tmp_path / "o")
    assert not (tmp_path / "o").exists()
    (finished_copy / "best.safetensors").unlink()
    assert "has no best.safetensors" in refusal(
        "night-eval", "compact", finished_copy, "--out", tmp_path / "o"
    )
