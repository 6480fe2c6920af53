"""Only one night-train works on a run folder at a time, and a killed one does not block the next."""

import functools
import os
import re
import signal
import socket
import time

import pytest
import torch
from night_commands import refusal
from training_processes import TORCHRUN, errors_of, start
from training_runs import settings

from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.training.lock import LOCK_FILE, _taken, only_training
from model.training.loop import train
from model.training.processes import Processes
from model.training.refusals import refuse_start

pytestmark = pytest.mark.usefixtures("one_thread")
ALONE = Processes(torch.device("cpu"))
OURS = f"another night-train (process {os.getpid()} on {socket.gethostname()}) is training into"


def locked(out):
    return only_training(out, ALONE, lambda: None)


def test_a_run_folder_in_use_is_refused_to_a_second_training(closed_form_scenes, finished_copy, tmp_path):
    new = tmp_path / "new"
    for out, more in ((new, []), (finished_copy, ["--resume"])):
        with locked(out):
            message = refusal("night-train", closed_form_scenes.root, "--out", out, *more)
            assert f"{OURS} {out}: wait until it ends" in message
    with locked(finished_copy):
        load(finished_copy, "cpu")  # reading is possible all the time
    assert not new.exists()
    assert not (finished_copy / LOCK_FILE).exists()


def test_a_refused_training_leaves_no_folder(closed_form_scenes, tmp_path):
    message = refusal("night-train", closed_form_scenes.root, "--out", tmp_path / "run", "--frequencies", 21)
    assert "21 MHz is not among" in message
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_others_gets_no_lock_file(closed_form_scenes, tmp_path):
    (tmp_path / "diary.txt").write_text("dear diary")
    for more in ([], ["--resume"]):
        refusal("night-train", closed_form_scenes.root, "--out", tmp_path, *more)
    assert [file.name for file in tmp_path.iterdir()] == ["diary.txt"]


def in_a_child(action):
    """Process id of a copy of this process that calls `action` and then waits to be killed."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        action()
        os.write(writer, b"x")
        time.sleep(600)
        os._exit(1)
    assert os.read(reader, 1) == b"x"
    os.close(reader)
    os.close(writer)
    return child


def test_the_lock_of_a_killed_training_is_free(closed_form_scenes, tmp_path):
    run = tmp_path / "run"
    child = in_a_child(locked(run).__enter__)
    with pytest.raises(RunError, match=rf"process {child} on "), locked(run):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert (run / LOCK_FILE).exists()
    train(closed_form_scenes, run, settings(max_epochs=1))
    assert not (run / LOCK_FILE).exists()


def test_a_folder_that_another_training_used_before_the_lock_was_free_is_refused(
    closed_form_scenes, finished_copy
):
    check = functools.partial(refuse_start, closed_form_scenes, finished_copy, resume=False)
    with pytest.raises(RunError, match="exists already"), only_training(finished_copy, ALONE, check):
        pass
    with locked(finished_copy):
        pass


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_what_is_no_lock_file_is_not_opened(closed_form_scenes, finished_copy, tmp_path, kind):
    path, victim = finished_copy / LOCK_FILE, tmp_path / "victim"
    victim.write_text("precious")
    if kind == "link":
        path.symlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    more = ("--out", finished_copy, "--resume", "--max-epochs", 3)
    assert str(path) in refusal("night-train", closed_form_scenes.root, *more)
    assert victim.read_text() == "precious"


def test_the_name_in_a_lock_file_is_not_printed_if_it_is_no_name(tmp_path):
    with locked(tmp_path):
        (tmp_path / LOCK_FILE).write_text("process 1 on \x1b[2Jhost\n")
        with (
            pytest.raises(RunError, match=r"another night-train \(of an unknown process\)"),
            locked(tmp_path),
        ):
            pass


@pytest.mark.long
@pytest.mark.parametrize("attempts", [1, pytest.param(5, marks=pytest.mark.thorough)])
def test_of_trainings_that_start_into_one_folder_exactly_one_goes_on(closed_form_scenes, tmp_path, attempts):
    for attempt in range(attempts):
        run = tmp_path / f"run{attempt}"
        processes = [start(closed_form_scenes, run, max_epochs=2) for _ in range(3)]
        codes = sorted(process.wait() for process in processes)
        said = errors_of(run).read_text()
        assert codes == [0, 2, 2], said
        refused = re.findall(r"^Error: (.*)", said, re.MULTILINE)
        assert len(refused) == 2
        assert all("is training into" in one or "exists already" in one for one in refused)
        load(run, "cpu")


@pytest.mark.long
def test_all_processes_of_a_refused_training_end(closed_form_scenes, tmp_path):
    run = tmp_path / "run"
    with locked(run):
        assert start(closed_form_scenes, run, launcher=TORCHRUN).wait() != 0
        said = errors_of(run).read_text()
    assert f"Error: {OURS}" in said
    assert "defect of NIGHT" not in said


def test_a_folder_in_which_no_file_can_be_made_is_not_tried_for_ever(tmp_path, monkeypatch):
    tried = []

    def refuse(path):
        tried.append(path)
        raise FileNotFoundError(2, "No such file or directory", str(path))

    monkeypatch.setattr("model.training.lock.open_lock_file", refuse)
    with pytest.raises(FileNotFoundError):
        _taken(tmp_path)
    assert 1 < len(tried) < 10_000
