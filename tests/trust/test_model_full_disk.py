"""A full disk ends night-train and the ONNX export in one sentence that names the file; nothing is lost."""

import pytest
from full_disk import file_size_limit
from night_commands import refusal
from training_runs import assert_same_end, settings

from model.run_folder.history import EpochRecord, read_history, write_history
from model.run_folder.run_config import RunError
from model.training.log import TrainingLog
from model.training.loop import train
from model.training.refusals import naming_disk

pytestmark = pytest.mark.usefixtures("one_thread")
RESUME = "free some space and go on with night-train --resume; the run keeps its last checkpoint"


@pytest.mark.parametrize(
    ("size", "file", "advice"),  # the first checkpoint has less than 400 kB, the others 591 kB
    [
        (1_000, "run.json", "free some space and start again$"),
        (100_000, "checkpoint.pt", "free some space and go on with night-train --resume$"),
        (400_000, "checkpoint.pt", f"{RESUME}$"),
    ],
)
def test_a_training_that_cannot_write_says_so_and_can_be_resumed(
    closed_form_scenes, finished_run, tmp_path, size, file, advice
):
    run = tmp_path / "run"
    with (
        file_size_limit(size),
        pytest.raises(RunError, match=rf"{run / file} cannot be written \(File too large\): {advice}"),
    ):
        train(closed_form_scenes, run, settings())
    assert run.exists() == (file != "run.json")
    assert not list(tmp_path.rglob(".*"))
    train(closed_form_scenes, run, settings(), resume=run.exists())
    assert_same_end(run, finished_run)


@pytest.mark.parametrize(("size", "file"), [(10, "history.csv"), (100_000, "checkpoint.pt")])
def test_a_fine_tuning_that_cannot_write_its_first_weights_can_begin_again(
    closed_form_scenes, finished_run, tmp_path, size, file
):
    run = tmp_path / "run"
    advice = rf"{run / file} cannot be written \(File too large\): free some space and start again"
    with file_size_limit(size), pytest.raises(RunError, match=advice):
        train(closed_form_scenes, run, settings(), start_from=finished_run)
    assert not (run / "run.json").exists()
    train(closed_form_scenes, run, settings(), start_from=finished_run)
    assert read_history(run)["epoch"] == [0, *range(1, settings().run.max_epochs + 1)]


def test_a_history_or_log_that_cannot_be_written_is_named(finished_copy):
    record = EpochRecord(1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.0)
    before, file = read_history(finished_copy), finished_copy / "history.csv"
    with file_size_limit(1000), pytest.raises(RunError, match=f"{file} cannot be written"), naming_disk(file):
        write_history(finished_copy, [record] * 100)
    assert read_history(finished_copy) == before
    log = TrainingLog(finished_copy, 0)
    with (
        file_size_limit(10),
        pytest.raises(RunError, match=r"log/events\.out\.\S+ cannot be written.*--resume"),
    ):
        log.write()


@pytest.mark.long
def test_an_export_that_cannot_be_written_leaves_the_earlier_file(finished_run, tmp_path):
    model = tmp_path / "model.onnx"
    model.write_text("the earlier file")
    with file_size_limit(50_000):
        message = refusal("night-eval", "export", finished_run, "--out", model)
    assert message.startswith(f"{model}: ")
    assert "File too large" in message or "file is too large" in message
    assert model.read_text() == "the earlier file"
    assert list(tmp_path.iterdir()) == [model]
