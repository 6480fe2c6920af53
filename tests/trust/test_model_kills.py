"""A training that is killed at any moment leaves a run that can be used and resumed to the same weights."""

import itertools

import pytest
from kill_points import killed_before
from training_runs import assert_same_end, settings

from model.prediction.predictor import load
from model.run_folder.history import read_history
from model.run_folder.run_config import RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
OFTEN = settings(checkpoint_minutes=0.0)
EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate"}


def survives(number, events, dataset, whole, folder):
    """Whether a training was killed before this call; then its run is used and resumed."""
    run = folder / str(number)
    if not killed_before(number, events, lambda: train(dataset, run, OFTEN), below=run):
        return False
    begun = (run / "run.json").exists()
    if begun:
        read_history(run)
        try:
            load(run, "cpu")
        except RunError as error:
            assert "no epoch was finished" in str(error)  # noqa: PT017
    train(dataset, run, OFTEN, resume=begun)
    assert_same_end(run, whole)
    assert not list(run.glob(".*"))
    return True


@pytest.mark.parametrize("number", [4])
def test_a_training_that_is_killed_between_two_files_loses_nothing(
    closed_form_scenes, finished_run, tmp_path, number
):
    assert survives(number, {"os.rename"}, closed_form_scenes, finished_run, tmp_path)


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


@pytest.mark.thorough
@pytest.mark.parametrize("first", [0, 3])
def test_a_training_that_is_killed_before_any_call_loses_nothing(
    closed_form_scenes, finished_run, tmp_path, first
):
    numbers = itertools.count(first, 7)  # of about 280 calls
    done = itertools.takewhile(
        lambda number: survives(number, EVENTS, closed_form_scenes, finished_run, tmp_path), numbers
    )
    assert sum(1 for _ in done) > 30
