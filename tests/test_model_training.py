"""Training and evaluation on closed-form scenes: exact resuming, refusals, and the whole way to a report."""

import csv
import json
import logging
import os
import shutil
import signal
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from night_commands import FIGURES
from safetensors.torch import load_file, save_file
from synthetic_dataset import write_synthetic_dataset

from itof import phasor_of_return, pixel_rays
from model.data.rows import RowLayout
from model.data.shards import open_shards
from model.device import DeviceError, choose_device
from model.network.loss import NightLoss
from model.network.readout import Readout
from model.prediction.predictor import load
from model.report.evaluation import EvaluationError, evaluate
from model.run_folder import RunError, run_settings
from model.settings import TrainSettings, settings_from_dict, training_preset
from model.training.loop import train
from model.training.refusals import TrainingError
from scenegen import FailureRecord, PresetError, write_failure
from scenegen.files.whole_files import HOST

FLIP = {"flip_columns": False, "rotation_deg": 0.0, "translation": 0.0}
QUICK = {
    "width": 2,
    "batch_size": 3,
    "max_epochs": 2,
    "learning_rate": 1e-3,
    "progress": False,
    "device": "cpu",
    "flip_columns": True,
    "rotation_deg": 180.0,
    "translation": 0.2,
    "checkpoint_minutes": 0.0,
}


pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=12)


@pytest.fixture(scope="module")
def finished_run(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    train(dataset, folder, TrainSettings(**QUICK))
    return folder


@pytest.fixture
def run(finished_run, tmp_path):
    """A copy of a finished run, to be spoilt."""
    shutil.copytree(finished_run, tmp_path / "run")
    return tmp_path / "run"


def settings(**changes) -> TrainSettings:
    return TrainSettings(**(QUICK | changes))


def loss_of(**changes) -> tuple[str, str]:
    return settings(**changes).loss, settings(**changes).loss_on


def edit_config(run, **changes) -> None:
    config = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(config | changes))


def test_a_resumed_run_ends_with_the_weights_of_an_uninterrupted_one(dataset, finished_run, run, tmp_path):
    whole = train(dataset, tmp_path / "whole", settings(max_epochs=4))
    resumed = train(dataset, run, settings(max_epochs=4), resume=True)
    assert resumed == whole
    assert (run / "history.csv").read_text() == (tmp_path / "whole" / "history.csv").read_text()
    assert (run / "best.safetensors").read_bytes() == (tmp_path / "whole" / "best.safetensors").read_bytes()
    ends = [torch.load(f / "checkpoint.pt", weights_only=True) for f in (run, tmp_path / "whole")]
    for name, weight in ends[0]["network"].items():
        assert torch.equal(weight, ends[1]["network"][name]), name
    short = torch.load(finished_run / "checkpoint.pt", weights_only=True)["network"]
    assert any(not torch.equal(weight, short[name]) for name, weight in ends[0]["network"].items())


@pytest.fixture
def streamed(tmp_path, monkeypatch):
    """A dataset in six pieces, and memory for two windows of two of its scenes, or of one piece."""
    row_bytes = RowLayout(24, 14, 3).row_bytes
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * row_bytes)
    dataset = write_synthetic_dataset(tmp_path / "data", count=12)
    return dataset, 4 * row_bytes


def test_a_resumed_streamed_run_ends_with_the_weights_of_an_uninterrupted_one(streamed, tmp_path, caplog):
    dataset, memory_bytes = streamed
    long = settings(max_epochs=4, batch_size=5)
    whole = train(dataset, tmp_path / "whole", long, memory_bytes=memory_bytes)
    half = settings(max_epochs=2, batch_size=5)
    train(dataset, tmp_path / "run", half, memory_bytes=memory_bytes)
    # A machine with more memory keeps the windows, one with less too, and says so.
    three = settings(max_epochs=3, batch_size=5)
    train(dataset, tmp_path / "run", three, resume=True)
    assert caplog.text == ""
    assert train(dataset, tmp_path / "run", long, resume=True, memory_bytes=0) == whole
    assert "goes on so" in caplog.text
    weights = (tmp_path / "run" / "best.safetensors").read_bytes()
    assert weights == (tmp_path / "whole" / "best.safetensors").read_bytes()
    ends = [torch.load(tmp_path / n / "checkpoint.pt", weights_only=True) for n in ("run", "whole")]
    for name, weight in ends[0]["network"].items():
        assert torch.equal(weight, ends[1]["network"][name]), name


def test_pieces_change_nothing_as_long_as_memory_holds_them_all(streamed, dataset, finished_run, tmp_path):
    train(streamed[0], tmp_path / "pieces", settings())
    weights = (finished_run / "best.safetensors").read_bytes()
    assert (tmp_path / "pieces" / "best.safetensors").read_bytes() == weights
    train(streamed[0], tmp_path / "streamed", settings(), memory_bytes=streamed[1])
    assert (tmp_path / "streamed" / "best.safetensors").read_bytes() != weights


def test_evaluation_over_many_pieces_is_that_over_one(streamed, dataset, finished_run, tmp_path):
    one = evaluate(finished_run, dataset, tmp_path / "one", device="cpu", progress=False)
    many = evaluate(finished_run, streamed[0], tmp_path / "many", device="cpu", progress=False)
    assert many == one


def test_an_interrupted_epoch_is_begun_again(dataset, tmp_path):
    whole = train(dataset, tmp_path / "whole", settings())
    run, killed = tmp_path / "run", False

    def interrupt(*_: object) -> None:
        nonlocal killed
        if (run / "checkpoint.pt").exists() and not killed:
            killed = True
            raise KeyboardInterrupt

    handle = torch.nn.modules.module.register_module_forward_pre_hook(interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            train(dataset, run, settings())
    finally:
        handle.remove()
    assert killed
    assert train(dataset, run, settings(), resume=True) == whole
    assert (run / "best.safetensors").read_bytes() == (tmp_path / "whole" / "best.safetensors").read_bytes()


def test_a_training_that_is_asked_to_stop_while_it_validates_goes_on_there(dataset, tmp_path):
    whole = train(dataset, tmp_path / "whole", settings())
    run, asked = tmp_path / "run", False

    def ask(module: torch.nn.Module, *_: object) -> None:
        nonlocal asked
        if not module.training and (run / "history.csv").exists() and not asked:
            asked = True
            os.kill(os.getpid(), signal.SIGINT)

    handle = torch.nn.modules.module.register_module_forward_pre_hook(ask)
    try:
        with pytest.raises(KeyboardInterrupt):
            train(dataset, run, settings(checkpoint_minutes=10))
    finally:
        handle.remove()
    assert len(torch.load(run / "checkpoint.pt", weights_only=True)["history"]) == 1
    assert train(dataset, run, settings(), resume=True) == whole
    assert (run / "history.csv").read_text() == (tmp_path / "whole" / "history.csv").read_text()
    assert (run / "best.safetensors").read_bytes() == (tmp_path / "whole" / "best.safetensors").read_bytes()


def test_weights_of_a_later_epoch_than_the_checkpoints_are_taken_back(dataset, run, tmp_path):
    three = train(dataset, tmp_path / "whole", settings(max_epochs=3))
    shutil.copy(tmp_path / "whole" / "best.safetensors", run / "best.safetensors")
    shutil.copy(tmp_path / "whole" / "history.csv", run / "history.csv")
    assert train(dataset, run, settings(max_epochs=3), resume=True) == three
    assert (run / "best.safetensors").read_bytes() == (tmp_path / "whole" / "best.safetensors").read_bytes()


def test_the_seed_decides_the_weights(dataset, finished_run, tmp_path):
    train(dataset, tmp_path / "same", settings())
    train(dataset, tmp_path / "other", settings(seed=1))
    weights = (finished_run / "best.safetensors").read_bytes()
    assert (tmp_path / "same" / "best.safetensors").read_bytes() == weights
    assert (tmp_path / "other" / "best.safetensors").read_bytes() != weights


def test_resuming_a_finished_run_does_nothing_and_says_so(dataset, run, caplog):
    before = (run / "checkpoint.pt").read_bytes()
    caplog.set_level(logging.INFO)
    assert train(dataset, run, settings(), resume=True).epochs == 2
    assert "finished already, after 2 epochs" in caplog.text
    assert (run / "checkpoint.pt").read_bytes() == before


def test_training_stops_when_patience_runs_out(dataset, tmp_path):
    # Steps of 1e-12 change no loss in float32, so the first epoch stays the best.
    result = train(
        dataset, tmp_path / "run", settings(max_epochs=9, patience=2, learning_rate=1e-12, noise_sigma=0.0)
    )
    assert result.ended_by == "patience"
    assert result.epochs == result.best_epoch + 2


@pytest.mark.parametrize(
    ("change", "named"),
    [({"seed": 5}, "seed was 0 and is now 5"), ({"width": 3}, "width"), ({"channels": "paper"}, "channels")],
)
def test_resuming_with_other_settings_is_refused_by_name(dataset, run, change, named):
    with pytest.raises(RunError, match=f"cannot be resumed: {named}"):
        train(dataset, run, settings(**change), resume=True)


def test_resuming_on_another_dataset_is_refused(run, tmp_path):
    other = write_synthetic_dataset(tmp_path / "other", count=8)
    with pytest.raises(RunError, match="dataset is not the one"):
        train(other, run, settings(), resume=True)


def test_a_folder_in_use_is_not_overwritten(dataset, run, tmp_path):
    with pytest.raises(RunError, match=r"exists already: resume it \(--resume\)"):
        train(dataset, run, settings())
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "thesis.txt").write_text("years of work")
    with pytest.raises(RunError, match="is not empty and holds no run: choose another folder"):
        train(dataset, tmp_path / "notes", settings())
    with pytest.raises(RunError, match=r"thesis.txt is a file"):
        train(dataset, tmp_path / "notes" / "thesis.txt", settings())
    with pytest.raises(RunError, match="is no training run"):
        train(dataset, tmp_path / "notes", settings(), resume=True)
    assert (tmp_path / "notes" / "thesis.txt").read_text() == "years of work"


def test_a_dataset_without_validation_scenes_cannot_be_trained_on(tmp_path):
    tables = {"count": 3, "test_fraction": 0.0, "validation_fraction": 0.0}
    dataset = write_synthetic_dataset(tmp_path / "data", count=3, dataset=tables)
    with pytest.raises(TrainingError, match="has no validation scenes"):
        train(dataset, tmp_path / "run", settings())


def test_a_loss_that_is_no_number_names_epoch_and_scenes(dataset, tmp_path):
    # A learning rate of 1e30 throws the weights so far that float32 overflows in the next step.
    with pytest.raises(TrainingError, match=r"loss became (nan|inf) in epoch \d+, on scenes 0000"):
        train(dataset, tmp_path / "run", settings(learning_rate=1e30))


@pytest.mark.parametrize("minutes", [0.0, 10.0])
def test_weights_that_are_no_numbers_are_never_written(dataset, tmp_path, minutes):
    bad = settings(learning_rate=1e30, batch_size=64, max_epochs=1, checkpoint_minutes=minutes)
    with pytest.raises(TrainingError, match=r"(validation loss became|weights stopped being numbers)"):
        train(dataset, tmp_path / "run", bad)
    assert not (tmp_path / "run" / "best.safetensors").exists()
    if (tmp_path / "run" / "checkpoint.pt").exists():  # weights of 1e30 are numbers, what they make is none
        state = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
        assert all(weight.isfinite().all() for weight in state["network"].values())


def test_a_split_whose_scenes_all_failed_to_render_is_named(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=8)
    for scene in dataset.ids("validation"):
        write_failure(dataset.render_folder(scene), FailureRecord(recipe="", attempts=2, reason="broken"), "")
    with pytest.raises(TrainingError, match=r"no validation scene of .* could be rendered"):
        train(dataset, tmp_path / "run", settings())


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without CUDA")
def test_asking_for_cuda_where_there_is_none_is_refused(dataset, tmp_path):
    with pytest.raises(DeviceError, match="no CUDA device"):
        train(dataset, tmp_path / "run", settings(device="cuda"))
    assert choose_device("auto").type == "cpu"


def test_a_run_folder_holds_what_it_promises(dataset, finished_run):
    config = json.loads((finished_run / "run.json").read_text())
    assert config["schema_version"] == 2
    assert config["settings"]["batch_size"] == 3
    assert config["inputs"]["frequencies_hz"] == [20e6, 50e6, 60e6]
    with (finished_run / "history.csv").open() as stream:
        lines = list(csv.DictReader(stream))
    assert [line["epoch"] for line in lines] == ["1", "2"]
    assert all(float(line["validation_mae_cm"]) > 0 for line in lines)
    assert list((finished_run / "log").glob("events.out.tfevents.*"))
    assert not list(finished_run.glob(".*.partial"))


def test_predictions_of_one_image_and_of_many_agree(dataset, finished_run):
    shards = open_shards(dataset)
    predictor = load(str(finished_run), "cpu")
    phasor = shards.complex_phasors([0, 1, 2])
    many, one = predictor.predict(phasor, shards.reference), predictor.predict(phasor[1], shards.reference)
    assert many.radial_depth_m.shape == phasor.shape[:3]
    np.testing.assert_allclose(many.phasor[1], one.phasor, atol=1e-5)
    assert np.count_nonzero(many.radial_depth_m[~many.mask]) == 0
    with pytest.raises(ValueError, match="NaN"):
        predictor.predict(phasor * np.nan, shards.reference)
    with pytest.raises(ValueError, match="expected phasors of shape"):
        predictor.predict(phasor[0, 0], shards.reference)


def test_unusable_runs_are_refused_in_one_sentence(run, tmp_path):
    with pytest.raises(RunError, match="there is no folder"):
        load(tmp_path / "nowhere")
    (tmp_path / "foreign").mkdir()
    with pytest.raises(RunError, match="is no training run"):
        load(tmp_path / "foreign")

    weights = (run / "best.safetensors").read_bytes()
    (run / "best.safetensors").write_bytes(weights[: len(weights) // 2])
    with pytest.raises(RunError, match=r"best.safetensors is damaged"):
        load(run)
    (run / "best.safetensors").unlink()
    with pytest.raises(RunError, match=r"has no best.safetensors"):
        load(run)

    config = json.loads((run / "run.json").read_text())
    edit_config(run, schema_version=3)
    with pytest.raises(RunError, match="schema version 3, this program reads version 2"):
        load(run)
    edit_config(run, schema_version=2, settings=config["settings"] | {"widht": 3})
    with pytest.raises(RunError, match=r"unknown key settings.widht"):
        load(run)
    (run / "run.json").write_text("[1, 2")
    with pytest.raises(RunError, match="is not the JSON of a run"):
        load(run)


def test_weights_of_another_architecture_are_refused(dataset, run):
    config = json.loads((run / "run.json").read_text())
    edit_config(run, settings=config["settings"] | {"width": 3})
    with pytest.raises(RunError, match="weights of another architecture"):
        load(run)
    with pytest.raises(RunError, match="weights of another architecture"):
        train(dataset, run, settings(width=3), resume=True)


def test_a_damaged_checkpoint_cannot_be_resumed(dataset, run):
    content = (run / "checkpoint.pt").read_bytes()
    for spoilt in (content[:1000], b"", b"no checkpoint"):
        (run / "checkpoint.pt").write_bytes(spoilt)
        with pytest.raises(RunError, match=r"checkpoint.pt is damaged or no checkpoint"):
            train(dataset, run, settings(), resume=True)
    torch.save([1, 2], run / "checkpoint.pt")
    with pytest.raises(RunError, match=r"is no checkpoint of schema version 2"):
        train(dataset, run, settings(), resume=True)


@pytest.mark.parametrize("missing", ["network", "optimisation", "best", "position", "history", "window_rows"])
def test_a_checkpoint_without_one_of_its_parts_cannot_be_resumed(dataset, run, missing):
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    del state[missing]
    torch.save(state, run / "checkpoint.pt")
    with pytest.raises(RunError, match=rf"checkpoint.pt lacks {missing}"):
        train(dataset, run, settings(max_epochs=3), resume=True)


def foreign_states():
    other = torch.nn.Linear(2, 3)
    for optimiser in (torch.optim.Adam(other.parameters()), torch.optim.SGD(other.parameters(), lr=0.1)):
        state = {"adam": optimiser.state_dict(), "scaler": {}, "average": None, "steps": 6}
        yield "optimisation", state
    yield "optimisation", [1, 2]
    yield "position", {"batches": 0}
    yield "network", [1, 2]
    yield "best", {}
    yield "history", [{"epoch": 1}]
    yield "history", []


@pytest.mark.parametrize(("part", "foreign"), list(foreign_states()))
def test_a_checkpoint_with_a_foreign_part_cannot_be_resumed(dataset, run, part, foreign):
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    torch.save(state | {part: foreign}, run / "checkpoint.pt")
    with pytest.raises(RunError, match=r"checkpoint.pt does not hold the state of this training"):
        train(dataset, run, settings(max_epochs=3), resume=True)


@pytest.mark.parametrize("spoil", ["no moments", "other shapes"])
def test_an_optimiser_state_of_other_weights_cannot_be_resumed(dataset, run, spoil):
    state = torch.load(run / "checkpoint.pt", weights_only=True)
    if spoil == "no moments":
        state["optimisation"]["adam"]["state"] = {}
    else:
        state["optimisation"]["adam"]["state"][0]["exp_avg"] = torch.zeros(5)
    torch.save(state, run / "checkpoint.pt")
    with pytest.raises(RunError, match=r"checkpoint.pt does not hold the state of this training"):
        train(dataset, run, settings(max_epochs=3), resume=True)


def test_the_settings_of_a_run_resume_it(dataset, run, finished_run):
    stored = run_settings(run)
    assert stored["batch_size"] == 3
    assert settings_from_dict(stored, "run.json") == settings()
    longer = settings_from_dict(stored | {"max_epochs": 3}, "run.json")
    assert train(dataset, run, longer, resume=True).epochs == 3
    with pytest.raises(RunError, match="is no training run"):
        run_settings(finished_run.parent)


def test_a_new_run_may_begin_where_a_killed_one_left_only_a_temporary_file(dataset, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / f".run.json.{HOST}-999999999.partial").write_text("{")
    train(dataset, tmp_path / "run", settings(max_epochs=1))
    assert not (tmp_path / "run" / f".run.json.{HOST}-999999999.partial").exists()


def test_running_out_of_memory_names_what_to_make_smaller(dataset, tmp_path):
    def need_a_petabyte(*_: object) -> None:
        torch.empty(2**50)

    handle = torch.nn.modules.module.register_module_forward_pre_hook(need_a_petabyte)
    try:
        with pytest.raises(
            TrainingError, match="out of memory with batch size 3 and width 2 at 24x14 pixels"
        ):
            train(dataset, tmp_path / "run", settings())
    finally:
        handle.remove()


def test_training_and_evaluation_end_to_end_beat_no_object(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=48)
    learning = {"width": 6, "batch_size": 4, "max_epochs": 3, "learning_rate": 2e-3} | FLIP
    result = train(dataset, tmp_path / "run", settings(**learning))
    assert result.epochs == 3
    report = evaluate(tmp_path / "run", dataset, tmp_path / "report", device="cpu", progress=False)
    assert len(report.scenes) == len(dataset.ids("test"))
    # Three epochs do not make good depth, but masks better than none by three standard errors of the mean.
    gain = np.array([scene.prediction.miou - scene.no_object.miou for scene in report.scenes])
    assert gain.mean() > 3 * gain.std(ddof=1) / np.sqrt(len(gain))

    written = json.loads((tmp_path / "report" / "metrics.json").read_text())
    assert written["prediction"]["miou"]["mean"] == report.prediction.miou.mean
    assert written["paper"]["depth_mae_m"]["mean"] == 0.0521
    assert [scene["scene"] for scene in written["scenes"]] == dataset.ids("test")
    assert {f.name for f in (tmp_path / "report" / "figures").iterdir()} == FIGURES
    assert "no object" in report.table
    assert (tmp_path / "report" / "table.txt").read_text() == report.table + "\n"


def test_point_clouds_of_the_truth_lie_at_its_depth_on_the_pixels_rays(dataset, finished_run, tmp_path):
    evaluate(finished_run, dataset, tmp_path / "report", split="validation", device="cpu", progress=False)
    shards = open_shards(dataset)
    row = shards.rows("validation")[0]
    cloud = trimesh.load(tmp_path / "report" / "pointclouds" / f"{shards.ids([row])[0]}_gt.ply")
    truth = shards.read([row])
    mask = truth.mask[0] > 0
    height, width = mask.shape
    rays = pixel_rays(width, height, dataset.preset.camera.horizontal_fov_deg)
    expected = (rays * truth.radial_depth_m[0][..., None])[mask]
    np.testing.assert_allclose(cloud.vertices, expected, rtol=1e-6, atol=1e-6)
    # An evaluation elsewhere leaves nothing of the old one behind.
    evaluate(finished_run, dataset, tmp_path / "report", split="test", device="cpu", progress=False)
    names = {file.name.split("_")[0] for file in (tmp_path / "report" / "pointclouds").iterdir()}
    assert names == set(dataset.ids("test"))


def test_a_network_that_sees_nothing_scores_the_baseline_and_draws_no_points(dataset, run, tmp_path):
    weights = load_file(run / "best.safetensors")
    last = max(name for name in weights if name.startswith("head."))
    weights |= {name: torch.zeros_like(w) for name, w in weights.items() if name[:6] == last[:6]}
    save_file(weights, run / "best.safetensors")
    report = evaluate(run, dataset, tmp_path / "report", device="cpu", progress=False)
    assert report.prediction == report.no_object
    clouds = {file.name for file in (tmp_path / "report" / "pointclouds").iterdir()}
    assert clouds == {f"{scene}_gt.ply" for scene in dataset.ids("test")}


def best_constant_loss(dataset, loss) -> float:
    """Loss on the training scenes of the best output that is the same everywhere: nothing was seen."""
    shards = open_shards(dataset)
    block = shards.read(shards.rows("train"))
    truth = [torch.from_numpy(array) for array in (block.target, block.radial_depth_m, block.mask)]
    outputs = [
        torch.tensor([z.real, z.imag], dtype=torch.float32)[:, None, None].expand(truth[0].shape)
        for amplitude in np.linspace(0, 1, 11)
        for z in amplitude * phasor_of_return(np.linspace(0, 7.4, 38), 20e6)
    ]
    return min(float(loss(output, *truth)) for output in outputs)


@pytest.mark.parametrize(
    "change",
    [
        {"loss_on": "depth"},
        {"loss": "mse+iou"},
        {"channels": "paper"},
        {"channels": "residual"},
        {"flip_rows": False},
        {"frequencies_hz": (50e6,)},
        {"precision": "bfloat16"},
        {"precision": "float16"},
        {"ema_decay": 0.5, "clip_norm": 1.0, "schedule": "cosine", "warm_up_epochs": 1.0},
    ],
)
def test_every_choice_learns_on_closed_form_scenes(dataset, tmp_path, change):
    learning = {"width": 8, "batch_size": 2, "max_epochs": 10} | FLIP
    train(dataset, tmp_path / "run", settings(**(learning | change)))
    with (tmp_path / "run" / "history.csv").open() as stream:
        losses = [float(line["train_loss"]) for line in csv.DictReader(stream)]
    assert losses[-1] < best_constant_loss(dataset, NightLoss(Readout(20e6), *loss_of(**change)))


def test_evaluation_without_a_test_split_says_which_there_are(finished_run, tmp_path):
    tables = {"count": 4, "test_fraction": 0.0, "validation_fraction": 0.5}
    dataset = write_synthetic_dataset(tmp_path / "data", count=4, dataset=tables)
    with pytest.raises(EvaluationError, match="has no test split: its 4 scenes are train and validation"):
        evaluate(finished_run, dataset, tmp_path / "report", device="cpu", progress=False)


@pytest.mark.parametrize("kind", ["run", "dataset", "foreign", "report with notes"])
def test_a_report_replaces_nothing_but_an_earlier_report(dataset, run, tmp_path, kind):
    foreign = tmp_path / "foreign"
    (foreign / "figures").mkdir(parents=True)
    (foreign / "figures" / "thesis.txt").write_text("years of work")
    if kind == "report with notes":
        evaluate(run, dataset, tmp_path / "report", device="cpu", progress=False)
        (tmp_path / "report" / "notes.txt").write_text("mine")
    out = {"run": run, "dataset": dataset.root, "foreign": foreign}.get(kind, tmp_path / "report")
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
    # The run is looked at later: nothing was done yet.
    with pytest.raises(EvaluationError, match="holds other things than an earlier report"):
        evaluate(tmp_path / "no run", dataset, out, device="cpu", progress=False)
    assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before


def test_a_report_does_not_replace_a_file_and_takes_an_empty_folder(dataset, run, tmp_path, monkeypatch):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(EvaluationError, match="notes is a file"):
        evaluate(run, dataset, tmp_path / "notes", device="cpu", progress=False)
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    evaluate(run, dataset, Path(), device="cpu", progress=False)
    assert (tmp_path / "empty" / "metrics.json").is_file()


def test_an_interrupted_evaluation_leaves_the_earlier_report_as_it_was(dataset, run, tmp_path):
    evaluate(run, dataset, tmp_path / "report", device="cpu", progress=False)
    before = {f: f.read_bytes() for f in (tmp_path / "report").rglob("*") if f.is_file()}

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    handle = torch.nn.modules.module.register_module_forward_hook(interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            evaluate(run, dataset, tmp_path / "report", split="train", device="cpu", progress=False)
    finally:
        handle.remove()
    assert {f: f.read_bytes() for f in (tmp_path / "report").rglob("*") if f.is_file()} == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["report", "run"]


def test_evaluation_at_another_resolution_or_frequency_is_refused(finished_run, tmp_path):
    larger = write_synthetic_dataset(tmp_path / "larger", count=4, width=30, height=20)
    with pytest.raises(EvaluationError, match=r"trained on 24x14 pixels, .* rendered at 30x20"):
        evaluate(finished_run, larger, tmp_path / "report", device="cpu", progress=False)
    slower = write_synthetic_dataset(tmp_path / "slower", count=4, itof={"frequencies_hz": [20e6, 50e6]})
    with pytest.raises(EvaluationError, match=r"trained at \[20.0, 50.0, 60.0\] MHz"):
        evaluate(finished_run, slower, tmp_path / "report", device="cpu", progress=False)
    assert not (tmp_path / "report").exists()


def test_settings_refuse_what_makes_no_sense():
    for change in ({"channels": "all"}, {"batch_size": 0}, {"learning_rate": -1.0}, {"device": "tpu"}):
        with pytest.raises(ValueError, match=next(iter(change))):
            settings(**change)


def test_a_schedule_that_ends_with_the_run_cannot_be_made_longer(dataset, tmp_path):
    ending = {"schedule": "cosine", "max_epochs": 1}
    train(dataset, tmp_path / "run", settings(**ending))
    with pytest.raises(RunError, match=r"max_epochs was 1 and is now 2 \(the learning rate's schedule"):
        train(dataset, tmp_path / "run", settings(**ending | {"max_epochs": 2}), resume=True)


def test_every_training_preset_is_one_that_settings_take_and_differs_from_its_base_by_its_own_keys():
    folder = Path(__file__).parent.parent / "data" / "training"
    paper = settings_from_dict(*training_preset("paper"))
    for file in folder.glob("*.toml"):
        preset = settings_from_dict(*training_preset(file.stem))
        if file.stem.startswith("ablation-"):
            own = {key for key in tomllib.loads(file.read_text()) if key != "extends"}
            assert len(own) == 1, file
            changed = {
                f.name for f in fields(TrainSettings) if getattr(preset, f.name) != getattr(paper, f.name)
            }
            assert changed <= own, file


def test_a_preset_extends_one_beside_it(tmp_path):
    (tmp_path / "base.toml").write_text('width = 5\nloss = "mse"\n')
    (tmp_path / "mine.toml").write_text('extends = "base.toml"\nwidth = 6\n')
    data, origin = training_preset(str(tmp_path / "mine.toml"))
    assert data == {"width": 6, "loss": "mse"}
    assert origin.endswith("mine.toml")


def test_presets_that_extend_each_other_in_a_circle_are_refused(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.toml").write_text(f'extends = "{tmp_path / other}.toml"\n')
    with pytest.raises(PresetError, match="a circle has no beginning"):
        training_preset(str(tmp_path / "a.toml"))


def test_a_network_sees_the_frequencies_it_was_asked_to_see_and_no_others(dataset, tmp_path):
    train(dataset, tmp_path / "run", settings(frequencies_hz=(50e6,), max_epochs=1))
    config = load(tmp_path / "run", "cpu").config
    assert config.inputs.channel_count == 3 + 1  # A, Re / A, Im / A, and Im r
    assert config.readout.frequency_hz == 20e6
    with pytest.raises(TrainingError, match="30 MHz is not among 20, 50, 60 MHz"):
        train(dataset, tmp_path / "other", settings(frequencies_hz=(30e6,)))


def test_a_small_network_finds_a_disc_of_known_place_to_a_stated_error(tmp_path):
    # The truth is a disc at a known point, the measurement a closed form of that point.
    tables = {"count": 160, "test_fraction": 0.2, "validation_fraction": 0.2}
    dataset = write_synthetic_dataset(tmp_path / "data", count=160, dataset=tables)
    learning = {"width": 8, "batch_size": 8, "max_epochs": 20, "learning_rate": 3e-3, "alpha": 1.0}
    course = {"schedule": "cosine", "warm_up_epochs": 1.0, "clip_norm": 1.0, "checkpoint_minutes": 10.0}
    train(dataset, tmp_path / "run", settings(**learning, **course, **FLIP))
    report = evaluate(tmp_path / "run", dataset, tmp_path / "report", device="cpu", progress=False)
    assert report.no_object.depth_mae_m.mean > 0.12
    # Three seeds made 3.7, 5.4 and 7.6 cm, and 0.79 to 0.88.
    assert report.prediction.depth_mae_m.mean < 0.10
    assert report.prediction.miou.mean > 0.70
