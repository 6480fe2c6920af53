"""A training that starts from the weights of another run: what it keeps, what it learns, what it refuses."""

import json
import re
import shutil

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from safetensors.torch import load_file
from synthetic_dataset import write_synthetic_dataset
from training_processes import TORCHRUN, errors_of, start
from training_runs import (
    SEEING,
    assert_same_end,
    before_each_network,
    config_of,
    edit_config,
    edit_settings,
    edit_weights,
    settings,
)

import model
from disk import sha256_of
from model.data.shards import open_shards
from model.prediction.predictor import load
from model.run_folder.history import read_history
from model.run_folder.run_config import RunError, read_config
from model.settings.fine_tuning import fine_tuning_course
from model.training.loop import train
from model.training.refusals import TrainingError
from scenegen import open_dataset

pytestmark = pytest.mark.usefixtures("one_thread")
STILL = {"learning_rate": 1e-30, "noise_sigma": 0.0, "max_epochs": 1}


@pytest.fixture(scope="module")
def wider(tmp_path_factory):
    """Scenes of another image size than those of `seeing_run`."""
    return write_synthetic_dataset(tmp_path_factory.mktemp("wider"), count=8, width=36, height=20)


@pytest.fixture
def seeing_copy(seeing_run, tmp_path):
    return shutil.copytree(seeing_run, tmp_path / "pretrained")


def fine(**changes):
    """Settings with the network of `seeing_run`."""
    return settings(**SEEING | {"max_epochs": 1} | changes)


def test_steps_of_no_length_leave_the_predictions_as_they_are_also_at_another_image_size(
    seeing_run, closed_form_scenes, wider, tmp_path
):
    for name, dataset in (("same", closed_form_scenes), ("wider", wider)):
        train(dataset, tmp_path / name, fine(**STILL), start_from=seeing_run)
        before, now = (
            load_file(seeing_run / "best.safetensors"),
            load_file(tmp_path / name / "best.safetensors"),
        )
        assert before.keys() == now.keys()
        # Two steps of Adam, each at most a learning rate long; only weights that are 0 can show them.
        assert max(float((now[key] - weight).abs().max()) for key, weight in before.items()) <= 4e-30
    phasors = open_shards(closed_form_scenes).read([0, 1]).phasors
    old, new = (load(run, "cpu").predict(phasors) for run in (seeing_run, tmp_path / "same"))
    assert old.mask.any()
    for name in ("radial_depth_m", "mask", "phasor"):
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name))
    assert load(tmp_path / "wider", "cpu").predict(open_shards(wider).read([0]).phasors).mask.shape == (
        *(1, 20, 36),
    )


def test_the_run_keeps_the_constants_of_its_start_and_says_where_it_came_from(seeing_run, wider, tmp_path):
    train(wider, tmp_path / "fine", fine(), start_from=seeing_run)
    before, now = read_config(seeing_run), read_config(tmp_path / "fine")
    assert now.inputs == before.inputs
    train(wider, tmp_path / "scratch", fine())
    assert read_config(tmp_path / "scratch").inputs != before.inputs  # those of these scenes are others
    assert config_of(tmp_path / "fine")["started_from"] == {
        "run": seeing_run.name,
        "run_id": before.run_id,
        "sha256": sha256_of(seeing_run / "best.safetensors"),
    }
    assert str(seeing_run.parent) not in (tmp_path / "fine" / "run.json").read_text()
    assert "started_from" not in config_of(tmp_path / "scratch")
    assert now.run_id != read_config(tmp_path / "scratch").run_id


@pytest.mark.long
def test_the_id_depends_on_the_weights_of_the_start_and_not_on_its_name(seeing_copy, wider, tmp_path):
    renamed = shutil.copytree(seeing_copy, tmp_path / "renamed")
    ids = []
    for index, run in enumerate((seeing_copy, renamed)):
        train(wider, tmp_path / str(index), fine(**STILL), start_from=run)
        ids.append(read_config(tmp_path / str(index)).run_id)
    edit_weights(renamed, lambda _, weight: weight * 1.5)
    train(wider, tmp_path / "2", fine(**STILL), start_from=renamed)
    assert ids[0] == ids[1] != read_config(tmp_path / "2").run_id


def test_a_resumed_run_needs_its_start_no_more_and_ends_as_if_uninterrupted(seeing_copy, wider, tmp_path):
    chosen = {"ema_decay": 0.9, "flip_rows": True}
    train(wider, tmp_path / "whole", fine(max_epochs=2, **chosen), start_from=seeing_copy)
    killed = []

    def kill(_: object) -> None:
        killed.append(True)
        raise KeyboardInterrupt

    run = tmp_path / "run"
    with before_each_network(kill), pytest.raises(KeyboardInterrupt):  # before the first step
        train(wider, run, fine(max_epochs=2, **chosen), start_from=seeing_copy)
    assert killed
    shutil.rmtree(seeing_copy)
    train(wider, run, fine(max_epochs=1, **chosen), resume=True)
    train(wider, run, fine(max_epochs=2, **chosen), resume=True)
    assert_same_end(run, tmp_path / "whole")
    assert read_config(run) == read_config(tmp_path / "whole")


def test_a_start_whose_weights_are_lost_cannot_be_resumed(seeing_run, wider, tmp_path):
    train(wider, tmp_path / "run", fine(), start_from=seeing_run)
    for name in ("checkpoint.pt", "best.safetensors"):
        (tmp_path / "run" / name).unlink()
    with pytest.raises(RunError, match=r"checkpoint.pt is missing, which held the weights of .* --from"):
        train(wider, tmp_path / "run", fine(max_epochs=2), resume=True)


@pytest.mark.long
def test_a_few_steps_from_a_trained_network_beat_as_many_from_random_weights(rendered_copy, tmp_path):
    course = SEEING | {"batch_size": 4, "noise_sigma": 0.0}
    points = write_synthetic_dataset(tmp_path / "points", count=48, width=24, height=18)
    train(points, tmp_path / "pretrained", settings(**course | {"max_epochs": 40}))
    rendered, miou = open_dataset(rendered_copy), {}
    for name, begin in (("fine", tmp_path / "pretrained"), ("scratch", None)):
        # Four scenes, so a step an epoch. The pretrained network may die at once of a step of 2e-3.
        ten_steps = settings(**course | {"max_epochs": 10, "learning_rate": 5e-4})
        train(rendered, tmp_path / name, ten_steps, start_from=begin)
        history = read_history(tmp_path / name)
        miou[name] = history["validation_miou"][int(np.argmin(history["validation_loss"]))]
    assert miou["fine"] > miou["scratch"]
    # An empty prediction scores half the share of the background, which is below 1/2.
    assert miou["fine"] > 0.5


def test_a_training_that_spoils_the_network_keeps_the_weights_of_its_start(
    seeing_run, closed_form_scenes, tmp_path
):
    spoiling = {"learning_rate": 0.01, "flip_rows": True}
    result = train(
        closed_form_scenes, tmp_path / "spoilt", fine(max_epochs=2, **spoiling), start_from=seeing_run
    )
    assert (result.epochs, result.best_epoch) == (2, 0)
    assert "no epoch was better than the start, with the validation loss" in result.sentence("run")
    before, kept = (load_file(run / "best.safetensors") for run in (seeing_run, tmp_path / "spoilt"))
    assert all(torch.equal(before[name], kept[name]) for name in before)
    history = read_history(tmp_path / "spoilt")
    assert history["epoch"] == [0, 1, 2]
    assert min(history["validation_loss"]) == history["validation_loss"][0] == result.best_validation_loss
    train(closed_form_scenes, tmp_path / "resumed", fine(max_epochs=1, **spoiling), start_from=seeing_run)
    train(closed_form_scenes, tmp_path / "resumed", fine(max_epochs=2, **spoiling), resume=True)
    assert_same_end(tmp_path / "resumed", tmp_path / "spoilt")


@pytest.mark.parametrize(
    ("scenes", "changes", "epochs"),
    [(16, {}, 200), (17, {}, 100), (160, {}, 40), (9000, {}, 40), (9000, {"train_scenes": 16}, 200)],
)
def test_few_scenes_are_seen_in_more_epochs(scenes, changes, epochs):
    course = fine_tuning_course(fine(batch_size=16, **changes), scenes)
    assert course["run"] == {"max_epochs": epochs, "patience": epochs}


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda run: (run / "best.safetensors").write_bytes(b"x" * 500), "damaged"),
        (lambda run: (run / "best.safetensors").unlink(), "no epoch was finished"),
        (lambda run: edit_weights(run, lambda _, weight: weight * float("nan")), "NaN or infinite"),
        (lambda run: edit_weights(run, lambda name, weight: weight[:1]), "another architecture"),
        (lambda run: (run / "run.json").write_text("{}"), "run.json"),
        (lambda run: edit_config(run, run_id="0" * 64), "belongs to another run"),
        (lambda run: shutil.rmtree(run), "there is no folder"),
    ],
)
def test_a_damaged_start_is_refused_and_nothing_is_written(seeing_copy, wider, tmp_path, damage, sentence):
    damage(seeing_copy)
    said = refusal("night-train", wider.root, "--out", tmp_path / "run", "--from", seeing_copy)
    assert sentence in said
    assert not (tmp_path / "run").exists()


def test_the_command_takes_the_network_of_the_start_and_the_training_of_the_preset(
    seeing_copy, wider, tmp_path
):
    edit_settings(seeing_copy, mask_threshold=0.4)
    out = tmp_path / "run"
    quick = ("--max-epochs", 1, "--device", "cpu", "--no-progress")
    start = ("night-train", wider.root, "--out", out, "--from", seeing_copy)
    done = night_here(*start, *quick, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["epochs"] == 1
    chosen = config_of(out)["settings"]
    assert (chosen["network"]["width"], chosen["target"]["mask_threshold"]) == (8, 0.4)
    assert chosen["input"]["frequencies_hz"] == [20e6, 50e6, 60e6]
    optimiser = chosen["optimiser"]
    assert (optimiser["batch_size"], optimiser["learning_rate"], optimiser["algorithm"]) == (16, 3e-4, "adam")
    assert chosen["run"]["patience"] == 200  # steps, of one epoch each
    done = night_here("night-train", wider.root, "--out", out, "--resume", "--max-epochs", 1)
    assert done.returncode == 0, done.stderr
    for given, sentence in (
        (("--block", 0), r"network.block is 0, but .* was trained with 1"),
        (("--width", 16), r"network.width is 16, but .* was trained with 8"),
        (("--channels", "paper"), r"input.channels.kind is paper, but .* was trained with paper\+residual"),
        (("--frequencies", "20"), r"input.frequencies_hz is \(20000000.0,\), but"),
        (("--resume",), "--from begins a new run, and --resume goes on with one"),
    ):
        said = refusal("night-train", wider.root, "--out", tmp_path / "no", "--from", seeing_copy, *given)
        assert re.search(sentence, said), said
    assert not (tmp_path / "no").exists()


def test_python_has_the_same_refusals(seeing_run, finished_copy, wider, tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("refused")
    inherited = model.fine_tuning_settings(seeing_run)
    assert (inherited["network"]["width"], inherited["input"]["frequencies_hz"]) == (8, [20e6, 50e6, 60e6])
    assert inherited["optimiser"] == {"algorithm": "adam"}  # that of the run
    with pytest.raises(RunError, match=r"network\.width is 2, but"):
        train(wider, tmp_path / "run", settings(), start_from=seeing_run)
    with pytest.raises(RunError, match="leave out resume or start_from"):
        train(wider, finished_copy, settings(), resume=True, start_from=seeing_run)


def test_a_dataset_at_other_frequencies_is_refused(seeing_run, tmp_path):
    for name, hz, sentence in (
        ("fewer", [20e6, 50e6], "60 MHz is not among 20, 50 MHz"),
        ("lower", [10e6, 20e6, 50e6, 60e6], "predicts at 20 MHz, and a training on .* at 10 MHz"),
    ):
        tables = {"itof": {"frequencies_hz": hz}}
        dataset = write_synthetic_dataset(tmp_path / name, count=6, **tables)
        with pytest.raises((RunError, TrainingError), match=sentence):
            train(dataset, tmp_path / "run", fine(), start_from=seeing_run)


@pytest.mark.long
def test_two_processes_start_from_a_trained_network(seeing_run, wider, tmp_path):
    run = tmp_path / "run"
    process = start(wider, run, "--from", seeing_run, launcher=TORCHRUN, **SEEING | {"max_epochs": 1})
    assert process.wait() == 0, errors_of(run).read_text()
    assert config_of(run)["started_from"]["run_id"] == read_config(seeing_run).run_id
