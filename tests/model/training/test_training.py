"""What decides a training, what it writes, and the datasets and losses that it refuses."""

import csv
import json
import shutil

import pytest
import torch
from synthetic_dataset import write_synthetic_dataset
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from training_runs import before_each_network, checkpoint, edit_settings, settings

from disk.partials import HOST
from model.data.channel_scaling import fit_input_spec
from model.data.shards import ShardError, open_shards
from model.device import choose_device
from model.judging.calibration import reread
from model.prediction.predictor import load, read_output
from model.run_folder.history import read_history
from model.run_folder.run_config import RUN_SCHEMA, RunError
from model.training.loop import train
from model.training.refusals import TrainingError
from scenegen import FailureRecord, write_failure

pytestmark = pytest.mark.usefixtures("one_thread")


def test_the_seed_decides_the_weights(closed_form_scenes, finished_run, tmp_path):
    train(closed_form_scenes, tmp_path / "same", settings())
    train(closed_form_scenes, tmp_path / "other", settings(seed=1))
    weights = (finished_run / "best.safetensors").read_bytes()
    assert (tmp_path / "same" / "best.safetensors").read_bytes() == weights
    assert (tmp_path / "other" / "best.safetensors").read_bytes() != weights


def test_a_training_on_the_first_scenes_sees_no_others(closed_form_scenes, tmp_path):
    shards = open_shards(closed_form_scenes)
    count = len(shards.rows("train")) - 2
    some = settings(train_scenes=count, max_epochs=1)
    train(closed_form_scenes, tmp_path / "run", some)
    config = load(tmp_path / "run", "cpu").config
    channels, reference = some.input.channels.kind, some.input.reference
    own = fit_input_spec(channels, shards, shards.rows("train")[:count], reference=reference)
    assert config.inputs == own
    steps = checkpoint(tmp_path / "run")["optimisation"]["steps"]
    assert steps == -(-count // some.optimiser.batch_size)
    with pytest.raises(TrainingError, match=f"train_scenes is 500, but .* has {count + 2} training scenes"):
        train(closed_form_scenes, tmp_path / "more", settings(train_scenes=500))


def test_block_0_is_a_number_that_depends_on_the_image(tmp_path):
    for width, block in ((20, 1), (40, 2), (60, 4), (320, 8), (1, 1)):
        assert settings(block=0).for_images(width) == settings(block=block)
    assert settings(block=3).for_images(40) == settings(block=3)
    dataset = write_synthetic_dataset(tmp_path / "data", count=6, width=40, height=8)
    run = tmp_path / "run"
    train(dataset, run, settings(block=0, max_epochs=1))
    assert load(run, "cpu").config.settings.network.block == 2
    edit_settings(run, block=0)
    with pytest.raises(RunError, match="a run has that number"):
        load(run, "cpu")


def test_training_stops_when_patience_runs_out(closed_form_scenes, tmp_path):
    # Steps of 1e-12 change no loss in float32, so the first epoch stays the best.
    still = settings(max_epochs=9, patience=2, learning_rate=1e-12, noise_sigma=0.0)
    result = train(closed_form_scenes, tmp_path / "run", still)
    assert result.ended_by == "patience"
    assert result.epochs == result.best_epoch + 2


def test_improvements_that_do_not_count_end_the_training_but_the_best_weights_stay(
    closed_form_scenes, tmp_path, finished_run
):
    best = read_history(finished_run)["validation_loss"]
    assert best[1] < best[0]
    short = settings(max_epochs=9, patience=1, min_delta=2 * (best[0] - best[1]))
    result = train(closed_form_scenes, tmp_path / "run", short)
    assert (result.ended_by, result.epochs, result.best_epoch) == ("patience", 2, 2)
    weights = (load(run, "cpu").network.state_dict() for run in (tmp_path / "run", finished_run))
    found, expected = weights
    assert all(torch.equal(found[name], weight) for name, weight in expected.items())


def test_a_run_folder_holds_what_it_promises(finished_run):
    config = json.loads((finished_run / "run.json").read_text())
    assert config["schema_version"] == RUN_SCHEMA
    assert config["settings"]["optimiser"]["batch_size"] == 3
    assert config["inputs"]["frequencies_hz"] == [20e6, 50e6, 60e6]
    with (finished_run / "history.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert [line["epoch"] for line in lines] == ["1", "2"]
    assert all(float(line["validation_mae_cm"]) > 0 for line in lines)
    assert list((finished_run / "log").glob("events.out.tfevents.*"))
    assert not list(finished_run.glob(".*.partial"))


def logged(run, tag):
    """(step, value) of a scalar in the log of a run, as TensorBoard shows it."""
    accumulator = EventAccumulator(str(run / "log"), size_guidance={"scalars": 0})
    accumulator.Reload()
    return [(event.step, event.value) for event in accumulator.Scalars(tag)], accumulator.Tags()["images"]


def test_the_log_shows_every_epoch_once_and_pictures_of_the_first(
    closed_form_scenes, finished_copy, finished_run
):
    for _ in range(2):  # the second time, epoch 3 is in the log but not in the checkpoint
        shutil.copy(finished_run / "checkpoint.pt", finished_copy)
        train(closed_form_scenes, finished_copy, settings(max_epochs=3), resume=True)
    assert len(list((finished_copy / "log").iterdir())) == 3
    found, pictures = logged(finished_copy, "validation_loss")
    expected = read_history(finished_copy)["validation_loss"]
    assert [step for step, _ in found] == [1, 2, 3]
    assert [value for _, value in found] == pytest.approx(expected, rel=1e-6)  # float32
    assert set(pictures) == {"radial_depth", "re", "im"}


def test_a_network_sees_the_frequencies_it_was_asked_to_see_and_no_others(closed_form_scenes, tmp_path):
    train(closed_form_scenes, tmp_path / "run", settings(frequencies_hz=(50e6,), max_epochs=1))
    config = load(tmp_path / "run", "cpu").config
    assert config.inputs.channel_count == 3 + 1  # A, Re / A, Im / A, and Im r
    assert config.readout.frequency_hz == 20e6
    with pytest.raises(TrainingError, match="30 MHz is not among 20, 50, 60 MHz"):
        train(closed_form_scenes, tmp_path / "other", settings(frequencies_hz=(30e6,)))


@pytest.fixture(scope="module")
def deep_scenes(tmp_path_factory):
    """Scenes whose objects can be farther than the 3.75 m of 40 MHz."""
    root = tmp_path_factory.mktemp("deep") / "data"
    return write_synthetic_dataset(root, count=6, itof={"frequencies_hz": [40e6, 70e6]})


@pytest.mark.parametrize("target", ["mask+depth", "depth"])
def test_depths_that_the_first_frequency_does_not_represent_do_not_wrap(deep_scenes, target, tmp_path):
    run = tmp_path / "run"
    train(deep_scenes, run, settings(target=target, max_epochs=1))
    readout = load(run, "cpu").config.readout
    assert readout.frequency_hz == 20e6  # half of 40 MHz
    depth_m = torch.full((1, 2, 3), 3.9)
    output = depth_m[:, None]
    if target == "mask+depth":
        output = torch.stack([torch.full_like(depth_m, 9.0), readout.standardised(depth_m)], dim=1)
    prediction = read_output(output, readout)
    assert prediction.radial_depth_m == pytest.approx(3.9, abs=1e-5)
    assert reread(prediction, readout).radial_depth_m == pytest.approx(3.9, abs=1e-5)  # from the phase
    assert train(deep_scenes, run, settings(target=target, max_epochs=1), resume=True).epochs == 1


def test_targets_that_need_the_phase_at_the_first_frequency_are_refused_if_it_wraps(deep_scenes, tmp_path):
    with pytest.raises(TrainingError, match=r"40 MHz, whose phase represents depths below 3\.747 m, "):
        train(deep_scenes, tmp_path / "run", settings(target="components"))
    with pytest.raises(ShardError, match=r"the phase at 40 MHz, which repeats every 3\.747 m, .* take"):
        train(deep_scenes, tmp_path / "run", settings(target="mask+depth", ground_truth="simulated"))
    assert not (tmp_path / "run" / "run.json").exists()


def test_a_folder_in_use_is_not_overwritten(closed_form_scenes, finished_copy, tmp_path):
    with pytest.raises(RunError, match=r"exists already: resume it \(--resume\)"):
        train(closed_form_scenes, finished_copy, settings())
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "thesis.txt").write_text("years of work")
    with pytest.raises(RunError, match="is not empty and holds no run: choose another folder"):
        train(closed_form_scenes, tmp_path / "notes", settings())
    with pytest.raises(RunError, match=r"thesis.txt is a file"):
        train(closed_form_scenes, tmp_path / "notes" / "thesis.txt", settings())
    with pytest.raises(RunError, match="is no training run"):
        train(closed_form_scenes, tmp_path / "notes", settings(), resume=True)
    assert (tmp_path / "notes" / "thesis.txt").read_text() == "years of work"


def test_a_new_run_may_begin_where_a_killed_one_left_only_a_temporary_file(closed_form_scenes, tmp_path):
    left = tmp_path / "run" / f".run.json.{HOST}-999999999.1.partial"
    left.mkdir(parents=True)
    (left / "run.json").write_text("{")
    train(closed_form_scenes, tmp_path / "run", settings(max_epochs=1))
    assert not left.exists()


def test_a_dataset_without_validation_scenes_cannot_be_trained_on(tmp_path):
    tables = {"count": 3, "test_fraction": 0.0, "validation_fraction": 0.0}
    dataset = write_synthetic_dataset(tmp_path / "data", count=3, dataset=tables)
    with pytest.raises(TrainingError, match="has no validation scenes"):
        train(dataset, tmp_path / "run", settings())


def test_a_split_whose_scenes_all_failed_to_render_is_named(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=8)
    for scene in dataset.ids("validation"):
        write_failure(dataset.render_folder(scene), FailureRecord(recipe="", attempts=2, reason="broken"), "")
    with pytest.raises(TrainingError, match=r"no validation scene of .* could be rendered"):
        train(dataset, tmp_path / "run", settings())


def test_a_loss_that_is_not_a_number_names_epoch_and_scenes(closed_form_scenes, tmp_path):
    # A learning rate of 1e30 makes the weights so large that float32 overflows in the next step.
    with pytest.raises(TrainingError, match=r"loss became (nan|inf) in epoch \d+, on scenes 0000"):
        train(closed_form_scenes, tmp_path / "run", settings(learning_rate=1e30))


@pytest.mark.parametrize("minutes", [0.0, 10.0])
@pytest.mark.parametrize("target", [{}, {"target": "mask+depth"}])
def test_weights_that_are_not_numbers_are_never_written(closed_form_scenes, tmp_path, minutes, target):
    bad = settings(learning_rate=1e30, batch_size=64, max_epochs=1, checkpoint_minutes=minutes, **target)
    with pytest.raises(TrainingError, match=r"(validation loss became|weights stopped being numbers)"):
        train(closed_form_scenes, tmp_path / "run", bad)
    assert not (tmp_path / "run" / "best.safetensors").exists()
    if (tmp_path / "run" / "checkpoint.pt").exists():  # weights of 1e30 are numbers, the output is not
        assert all(weight.isfinite().all() for weight in checkpoint(tmp_path / "run")["network"].values())


def test_float32_is_not_rounded_on_a_gpu(monkeypatch):
    flags = (torch.backends.cudnn, torch.backends.cuda.matmul)
    before = [flag.allow_tf32 for flag in flags]
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    try:
        for flag in flags:
            flag.allow_tf32 = True
        assert choose_device("auto").type == "cuda"
        assert not any(flag.allow_tf32 for flag in flags)
    finally:
        for flag, value in zip(flags, before, strict=True):
            flag.allow_tf32 = value


def test_running_out_of_memory_names_what_to_make_smaller(closed_form_scenes, tmp_path):
    advice = "out of memory with batch size 3 and width 2 at 24x14 pixels"
    with before_each_network(lambda _: torch.empty(2**50)), pytest.raises(TrainingError, match=advice):
        train(closed_form_scenes, tmp_path / "run", settings())
