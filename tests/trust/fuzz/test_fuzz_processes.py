"""The commands as processes of their own, with their workers: in a bad environment, and killed."""

import os
import resource
import shutil
import subprocess
import time
from dataclasses import replace

import numpy as np
import psutil
import pytest
from conftest import FIRST_SEED, KILLS
from forked import ONE_THREAD
from jobs import GEN, JUDGE, RENDER, TRAIN, Stage
from night_commands import night, words
from render_runs import SETTINGS, results, start_render, workers_of

MODULES = ("cli", "commandline", "disk", "processes", "scenegen", "itof", "render", "model")
pytestmark = pytest.mark.thorough
COMMANDS = ("night-gen", "night-render", "night-train", "night-eval")
RENDER_HERE = replace(RENDER, command="night-render data --again failed --workers 1 --device cpu")
BARE = {name: value for name, value in os.environ.items() if name not in ("HOME", "USER", "LOGNAME")}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("module", MODULES)
def test_a_foreign_module_first_on_the_path_is_named(tmp_path, command, module):
    (tmp_path / f"{module}.py").write_text("raise SystemExit('the foreign module was run')\n")
    done = night(command, "--help", PYTHONPATH=str(tmp_path))
    assert done.returncode == 2, done
    assert "Traceback" not in done.stderr
    assert str(tmp_path / f"{module}.py") in done.stderr
    assert done.stderr.count("Error: ") == 1


def few_files_and_no_streams():
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
    os.closerange(0, 3)


@pytest.mark.parametrize("job", [GEN, RENDER_HERE, TRAIN, JUDGE], ids=lambda job: job.name)
def test_a_command_starts_with_64_files_without_streams_and_home(forks, samples, tmp_path, job):
    stage = Stage(forks, tmp_path / "arena", samples, job)
    done = subprocess.run(
        words(*job.command.split()),
        cwd=stage.arena.work,
        env=BARE | ONE_THREAD,
        preexec_fn=few_files_and_no_streams,
        check=False,
    )
    assert done.returncode == 0
    assert stage.result() == stage.new


def test_killed_runs_and_workers_leave_what_an_undisturbed_run_does(unrendered, seven_renders, tell):
    started = time.monotonic()
    assert night("night-render", unrendered, *SETTINGS).returncode == 0
    seconds = time.monotonic() - started
    shutil.rmtree(unrendered / "renders")
    rng = np.random.default_rng(FIRST_SEED)
    killed = {"command": 0, "worker": 0}
    while sum(killed.values()) < 2 * KILLS:
        process = start_render(unrendered)
        try:
            process.wait(rng.uniform(0.1, 0.9) * seconds)
        except subprocess.TimeoutExpired:
            killed[kill_one(process, rng, is_worker=killed["worker"] < killed["command"])] += 1
        _, errors = process.communicate(timeout=300)
        assert process.returncode in (0, -9), errors
        if process.returncode == 0:  # it was faster than the signal, or went on without a worker
            assert results(unrendered) == results(seven_renders)
            shutil.rmtree(unrendered / "renders")
    assert night("night-render", unrendered, *SETTINGS).returncode == 0
    assert results(unrendered) == results(seven_renders)
    assert not list(unrendered.glob("renders/[0-9]*/.*"))
    for name, count in killed.items():
        tell("killed command", f"night-render, {name}", {"kills": count, "lost": 0})


def kill_one(process, rng, *, is_worker):
    """Kill a worker of the command, or the command, whose workers must end too; returns which."""
    workers = workers_of(process)
    if workers and is_worker:
        workers[int(rng.integers(len(workers)))].kill()
        return "worker"
    process.kill()
    psutil.wait_procs(workers, timeout=300)
    assert not any(worker.is_running() for worker in workers)
    return "command"
