"""Several processes that make scenes: the same bytes, and no process is left behind."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from night_commands import night, night_here, words
from scene_folders import contents, identities, of_seed_5

from scenegen import scene_id
from scenegen.making.generation import generate


@pytest.mark.long
def test_one_and_three_processes_write_the_same_bytes_and_nothing_else(maker, tmp_path):
    generate(tmp_path / "one", of_seed_5(50), maker, lambda: None)  # three chunks of 16, and two scenes
    (temporary := tmp_path / "temporary").mkdir()
    arguments = ("scenes", tmp_path / "three", "--count", 50, "--seed", 5, "--workers", 3)
    done = night("night-gen", *arguments, TMPDIR=str(temporary))
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("scenes: ") for line in done.stderr.splitlines())  # progress, and nothing else
    assert done.stdout.startswith(f"50 scenes in {tmp_path / 'three'}: ")
    assert contents(tmp_path / "three") == contents(tmp_path / "one")
    assert list(temporary.iterdir()) == []


@pytest.mark.long
def test_workers_add_the_scenes_that_one_process_would_and_touch_nothing_that_is_there(maker, tmp_path):
    count = 40  # three chunks for two workers, the last one not full
    generate(tmp_path / "once", of_seed_5(count), maker, lambda: None)
    generate(tmp_path / "grown", of_seed_5(9), maker, lambda: None)
    before = identities(tmp_path / "grown" / "scenes")
    done = night("night-gen", "scenes", tmp_path / "grown", "--count", count, "--seed", 5, "--workers", 2)
    assert done.returncode == 0, done.stderr
    assert all(line.startswith("scenes: ") for line in done.stderr.splitlines())  # progress, and nothing else
    assert done.stdout.startswith(f"40 scenes in {tmp_path / 'grown'}: ")
    after = identities(tmp_path / "grown" / "scenes")
    assert {name: after[name] for name in before} == before
    assert contents(tmp_path / "grown") == contents(tmp_path / "once")


def workers_of(process):
    """Process ids of the workers that a night-gen has started, without the one that tracks its semaphores."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def working(tmp_path):
    """A night-gen of two workers in the middle of more scenes than it will make."""
    command = words("night-gen", "scenes", tmp_path / "data", "--count", 100_000, "--workers", 2)
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 600
    while not (tmp_path / "data" / "scenes" / scene_id(40)).exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    yield process
    process.kill()
    process.communicate()


def assert_ended(workers):
    deadline = time.monotonic() + 300
    while any(is_running(worker) for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_killed_worker_ends_the_command_with_one_sentence(working, tmp_path):
    workers = workers_of(working)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    _, stderr = working.communicate(timeout=600)
    assert working.returncode == 2
    assert "Traceback" not in stderr
    assert stderr.splitlines()[-1].startswith("Error: a worker process was killed")
    assert_ended(workers)
    assert not (tmp_path / "data" / "dataset.json").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 128 + signal.SIGINT), (signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGKILL, -9)],
)
def test_the_workers_end_with_the_command(working, number, code):
    workers = workers_of(working)
    for pid in (*workers, working.pid) if number == signal.SIGINT else (working.pid,):
        os.kill(pid, number)  # Ctrl-C goes to every process of a terminal
    _, stderr = working.communicate(timeout=600)
    assert working.returncode == code
    assert "Traceback" not in stderr
    assert_ended(workers)


@pytest.mark.long
def test_a_preset_without_room_is_refused_by_workers_in_the_same_words(tmp_path):
    (tmp_path / "my.toml").write_text(
        '[hidden_object]\nshapes = ["cube"]\ncomposite_fraction = 0.0\nsize_m = { cube = [2.5, 2.5, 2.5] }\n'
    )
    command = ["night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml", "--workers"]
    done = [night_here(*command, 1), night(*command, 2)]
    assert [one.returncode for one in done] == [2, 2]
    errors = [one.stderr.splitlines()[-1] for one in done]
    assert errors[0] == errors[1]
    assert "scene 0: none of 1000 draws fits the room" in errors[0]
