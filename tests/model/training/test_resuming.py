"""A resumed training ends like one that was never interrupted, to the bit."""

import logging
import os
import shutil
import signal

import pytest
from synthetic_dataset import write_synthetic_dataset
from training_runs import assert_same_end, before_each_network, checkpoint, settings

from model.data.rows import RowLayout
from model.run_folder.run_config import RunError, run_settings
from model.settings.keys import merged
from model.settings.train_settings import settings_from_dict
from model.training.interruption import Interruption
from model.training.log import TrainingLog
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
EXIT_CODE_OF_SIGTERM = 128 + signal.SIGTERM


@pytest.fixture(scope="module")
def whole(closed_form_scenes, tmp_path_factory):
    """Results and folders of runs of two to four epochs that nothing interrupted."""
    root = tmp_path_factory.mktemp("whole")
    return {
        epochs: (
            train(closed_form_scenes, root / str(epochs), settings(max_epochs=epochs)),
            root / str(epochs),
        )
        for epochs in (2, 3, 4)
    }


@pytest.fixture
def streamed(tmp_path, monkeypatch):
    """A dataset in six pieces, and memory for two windows of two of its scenes, or of one piece."""
    row_bytes = RowLayout(24, 14, 3).row_bytes
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * row_bytes)
    dataset = write_synthetic_dataset(tmp_path / "data", count=12)
    return dataset, 4 * row_bytes


def test_a_resumed_run_ends_with_the_weights_of_an_uninterrupted_one(
    closed_form_scenes, whole, finished_run, finished_copy
):
    result, folder = whole[4]
    assert train(closed_form_scenes, finished_copy, settings(max_epochs=4), resume=True) == result
    assert_same_end(finished_copy, folder)
    end, before = checkpoint(finished_copy)["network"], checkpoint(finished_run)["network"]
    assert any(not weight.equal(before[name]) for name, weight in end.items())


def test_a_resumed_streamed_run_ends_with_the_weights_of_an_uninterrupted_one(streamed, tmp_path, caplog):
    dataset, memory_bytes = streamed
    long = settings(max_epochs=4, batch_size=5)
    whole = train(dataset, tmp_path / "whole", long, memory_bytes=memory_bytes)
    half = settings(max_epochs=2, batch_size=5)
    train(dataset, tmp_path / "run", half, memory_bytes=memory_bytes)
    # A machine with more memory keeps the windows; a machine with less keeps them too and warns.
    three = settings(max_epochs=3, batch_size=5)
    train(dataset, tmp_path / "run", three, resume=True)
    assert caplog.text == ""
    assert train(dataset, tmp_path / "run", long, resume=True, memory_bytes=0) == whole
    assert "keeps this number" in caplog.text
    assert_same_end(tmp_path / "run", tmp_path / "whole")


def test_a_streamed_self_calibrated_run_stopped_within_an_epoch_ends_as_an_uninterrupted_one(
    streamed, tmp_path
):
    dataset, memory_bytes = streamed
    course = settings(
        batch_size=2, max_epochs=3, checkpoint_minutes=0.0, channels="residual", reference="self"
    )
    end = train(dataset, tmp_path / "whole", course, memory_bytes=memory_bytes)
    batches = []

    def stop(network):
        batches.append(network.training)
        if network.training and sum(batches) == 6:  # of the four batches of an epoch: the second of epoch 2
            raise KeyboardInterrupt

    with before_each_network(stop), pytest.raises(KeyboardInterrupt):
        train(dataset, tmp_path / "run", course, memory_bytes=memory_bytes)
    state = checkpoint(tmp_path / "run")
    assert (len(state["history"]), state["position"]["batches"]) == (1, 1)
    # The walls of the rows are fitted again, also those of the first epoch.
    assert train(dataset, tmp_path / "run", course, resume=True, memory_bytes=memory_bytes) == end
    assert_same_end(tmp_path / "run", tmp_path / "whole")


def test_pieces_change_nothing_as_long_as_memory_holds_them_all(streamed, finished_run, tmp_path):
    train(streamed[0], tmp_path / "pieces", settings())
    weights = (finished_run / "best.safetensors").read_bytes()
    assert (tmp_path / "pieces" / "best.safetensors").read_bytes() == weights
    train(streamed[0], tmp_path / "streamed", settings(), memory_bytes=streamed[1])
    assert (tmp_path / "streamed" / "best.safetensors").read_bytes() != weights


@pytest.mark.parametrize(
    ("number", "ending"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
def test_a_training_that_is_asked_to_stop_goes_on_in_the_middle_of_its_epoch(
    closed_form_scenes, tmp_path, number, ending
):
    course = {"max_epochs": 3, "batch_size": 2, "ema_decay": 0.9, "schedule": "cosine", "optimiser": "muon"}
    batches_an_epoch = -(-len(closed_form_scenes.ids("train")) // 2)
    assert batches_an_epoch > 2
    batches = []

    def ask(network) -> None:
        batches.append(network.training)
        if sum(batches) == batches_an_epoch + 2 and network.training:  # the second batch of epoch 2
            os.kill(os.getpid(), number)

    run = tmp_path / "run"
    with before_each_network(ask), pytest.raises(ending) as stopped:
        train(closed_form_scenes, run, settings(**course))
    assert number == signal.SIGINT or stopped.value.code == EXIT_CODE_OF_SIGTERM
    state = checkpoint(run)
    assert (len(state["history"]), state["position"]["batches"]) == (1, 2)
    whole = train(closed_form_scenes, tmp_path / "whole", settings(**course))
    assert train(closed_form_scenes, run, settings(**course), resume=True) == whole
    assert checkpoint(run)["history"] == checkpoint(tmp_path / "whole")["history"]
    assert_same_end(run, tmp_path / "whole")


def test_a_training_ignores_a_signal_that_its_process_ignores():
    """As a background job of a script ignores Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Interruption() as interruption:
            os.kill(os.getpid(), signal.SIGINT)
            assert interruption.signal is None
            os.kill(os.getpid(), signal.SIGTERM)
            assert interruption.signal == signal.SIGTERM
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_signal_in_the_middle_of_a_write_is_noted(monkeypatch):
    def fail(*_):
        raise RuntimeError("reentrant call inside a write")

    monkeypatch.setattr("model.training.interruption._log.info", fail)
    with Interruption() as interruption:
        os.kill(os.getpid(), signal.SIGTERM)
        assert interruption.signal == signal.SIGTERM


def test_a_training_that_is_asked_to_stop_while_it_validates_goes_on_there(
    closed_form_scenes, whole, tmp_path
):
    run, asked = tmp_path / "run", []

    def ask(network) -> None:
        if not network.training and (run / "best.safetensors").exists() and not asked:
            asked.append(True)
            os.kill(os.getpid(), signal.SIGINT)

    with before_each_network(ask), pytest.raises(KeyboardInterrupt):
        train(closed_form_scenes, run, settings())
    assert len(checkpoint(run)["history"]) == 1
    assert train(closed_form_scenes, run, settings(), resume=True) == whole[2][0]
    assert_same_end(run, whole[2][1])


def test_weights_of_a_later_epoch_than_the_checkpoints_are_taken_back(
    closed_form_scenes, whole, finished_copy
):
    result, three = whole[3]
    for file in ("best.safetensors", "history.csv"):
        shutil.copy(three / file, finished_copy / file)
    assert train(closed_form_scenes, finished_copy, settings(max_epochs=3), resume=True) == result
    assert_same_end(finished_copy, three)


def test_resuming_a_finished_run_does_nothing_and_says_so(closed_form_scenes, finished_copy, caplog):
    before = (finished_copy / "checkpoint.pt").read_bytes()
    caplog.set_level(logging.INFO)
    assert train(closed_form_scenes, finished_copy, settings(), resume=True).epochs == 2
    assert "finished already, after 2 epochs" in caplog.text
    assert (finished_copy / "checkpoint.pt").read_bytes() == before


def test_the_settings_of_a_run_resume_it(closed_form_scenes, finished_copy, finished_run):
    stored = run_settings(finished_copy)
    assert stored["optimiser"]["batch_size"] == 3
    assert settings_from_dict(stored, "run.json") == settings()
    longer = settings_from_dict(merged(stored, {"run": {"max_epochs": 3}}), "run.json")
    assert train(closed_form_scenes, finished_copy, longer, resume=True).epochs == 3
    with pytest.raises(RunError, match="is no training run"):
        run_settings(finished_run.parent)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 5}, "run.seed was 0 and is now 5"),
        ({"width": 3}, "network.width"),
        ({"channels": "paper"}, "input.channels.kind"),
    ],
)
def test_resuming_with_other_settings_is_refused_by_name(closed_form_scenes, finished_copy, change, named):
    with pytest.raises(RunError, match=f"cannot be resumed: {named}"):
        train(closed_form_scenes, finished_copy, settings(**change), resume=True)


def test_a_schedule_that_ends_with_the_run_cannot_be_made_longer(closed_form_scenes, tmp_path):
    ending = {"schedule": "cosine", "max_epochs": 1}
    train(closed_form_scenes, tmp_path / "run", settings(**ending))
    with pytest.raises(RunError, match=r"run\.max_epochs was 1 and is now 2 \(the learning rate's schedule"):
        train(closed_form_scenes, tmp_path / "run", settings(**ending | {"max_epochs": 2}), resume=True)


def test_a_run_that_ended_before_its_first_checkpoint_writes_one_before_it_goes_on(
    closed_form_scenes, finished_copy, monkeypatch
):
    for name in ("checkpoint.pt", "best.safetensors", "history.csv"):
        (finished_copy / name).unlink()

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("model.training.loop.train_epoch", killed)
    with pytest.raises(KeyboardInterrupt):
        train(closed_form_scenes, finished_copy, settings(), resume=True)
    assert checkpoint(finished_copy)["history"] == []


def test_shards_that_another_command_removes_do_not_end_a_training_that_holds_its_scenes(
    tmp_path, monkeypatch
):
    dataset, pictures = write_synthetic_dataset(tmp_path / "data", count=12), []

    def wanted(self, epoch):
        shutil.rmtree(dataset.root / "shards", ignore_errors=True)
        pictures.append(epoch)
        return True

    monkeypatch.setattr(TrainingLog, "wants_pictures", wanted)
    train(dataset, tmp_path / "run", settings(max_epochs=2))
    assert pictures == [1, 2]


def test_resuming_on_another_dataset_is_refused(finished_copy, tmp_path):
    other = write_synthetic_dataset(tmp_path / "other", count=8)
    with pytest.raises(RunError, match="dataset is not the one"):
        train(other, finished_copy, settings(), resume=True)
