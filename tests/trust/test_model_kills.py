"""A training that is killed at any moment leaves a run that can be used and resumed to the same weights."""

from contextlib import suppress

import pytest
from kill_points import killed_before
from training_runs import assert_same_end, settings

from model.prediction.predictor import load
from model.run_folder.history import read_history
from model.run_folder.run_config import RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")


def test_a_training_that_is_killed_between_two_files_loses_nothing(
    closed_form_scenes, finished_run, tmp_path
):
    run, often = tmp_path / "run", settings(checkpoint_minutes=0.0)
    assert killed_before(4, {"os.rename"}, lambda: train(closed_form_scenes, run, often), below=run)
    read_history(run)
    with suppress(RunError):  # no epoch was finished
        load(run, "cpu")
    train(closed_form_scenes, run, often, resume=True)
    assert_same_end(run, finished_run)
    assert not list(run.glob(".*"))


@pytest.mark.parametrize("number", [1, 2])
def test_a_fine_tuning_that_is_killed_before_it_has_a_run_json_can_begin_again(
    closed_form_scenes, finished_run, tmp_path, number
):
    run = tmp_path / "run"

    def tune():
        train(closed_form_scenes, run, settings(), start_from=finished_run)

    assert killed_before(number, {"os.rename"}, tune, below=run)
    assert (run / "history.csv").exists()
    assert not (run / "run.json").exists()
    tune()
    assert read_history(run)["epoch"] == [0, *range(1, settings().run.max_epochs + 1)]
