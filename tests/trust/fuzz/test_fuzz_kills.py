"""Commands that are killed at any moment lose nothing; the next one leaves what an undisturbed one does."""

import shutil
import subprocess
import time

import numpy as np
import psutil
import pytest
from conftest import FIRST_SEED, KILLS
from jobs import FIVE, Stage
from night_commands import night
from render_runs import SETTINGS, results, start_render, workers_of

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("job", FIVE, ids=lambda job: job.name)
def test_a_killed_command_loses_nothing(forks, samples, tmp_path, job, tell):
    stage = Stage(forks, tmp_path / "arena", samples, job)
    rng = np.random.default_rng(FIRST_SEED)
    wrong = {}
    for number in range(KILLS):
        if number % 2:
            moment = rng.uniform(0, stage.seconds)
            wrong[f"after {moment:.3f} s"] = stage.killed_after(moment)
        else:
            change = int(rng.integers(stage.change_count))
            wrong[f"before change {change} of {stage.change_count}"] = stage.killed_before(change)
    lost = {when: what for when, what in wrong.items() if what}
    tell("killed command", job.name, {"kills": KILLS, "lost": len(lost)})
    assert lost == {}


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
