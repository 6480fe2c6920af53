"""Workers: how many there are, where they come from, and what it costs when one dies, grows or is slow.

Real commands and real worker processes; the results are compared with those of one undisturbed run.
"""

import os
import re
import shutil
import signal
import time
from concurrent.futures import Future
from types import SimpleNamespace

import pytest
from distributed import KilledWorker
from distributed.protocol.pickle import loads
from night_commands import night, night_here
from render_runs import SETTINGS, claim_of, killed_in, results, run_log, start_render, wait_for, workers_of

from render.farm.clusters import connected
from render.farm.jobs import Outcome, render_scenes
from render.farm.queue import QueueError, RenderQueue
from render.farm.run import RunOptions, render_dataset
from render.options import ManyLightOptions
from render.settings import RenderSettings
from scenegen import open_dataset, read_failure


def workers_in(log):
    """The processes that rendered scenes, by the log of a run."""
    return set(re.findall(r"rendered in .* on (\S+)", log))


def test_all_workers_of_a_scheduler_render(seven_renders):
    assert len(workers_in(run_log(seven_renders))) == 2


@pytest.mark.long
def test_workers_that_grow_make_way_for_fresh_ones_and_render_the_same(three_missing, seven_renders):
    dataset = open_dataset(three_missing)
    settings = RenderSettings(product="both", options=ManyLightOptions(error=0.05), device="cpu")
    # One local worker. No growth allowed: it is replaced when it is larger than after its first scene.
    options = RunOptions(workers=1, growth_bytes=0, progress=False)
    result = render_dataset(dataset, settings, dataset.ids(), options, lambda _: None)
    assert result.failures == {}
    assert results(three_missing) == results(seven_renders)
    assert len(workers_in(run_log(three_missing))) > 1
    assert " failed on " not in run_log(three_missing)


@pytest.mark.long
@pytest.mark.parametrize(
    "workers", [2, *(pytest.param(count, marks=pytest.mark.thorough) for count in (1, 4))]
)
def test_results_do_not_depend_on_the_number_of_local_workers(unrendered, seven_renders, workers):
    done = night("night-render", unrendered, *SETTINGS, "--workers", workers)
    assert done.returncode == 0, done.stderr
    assert results(unrendered) == results(seven_renders)
    assert len(workers_in(run_log(unrendered))) == workers


def test_a_scheduler_that_is_not_there_is_named(unrendered, monkeypatch):
    monkeypatch.setattr("render.farm.scheduler_address.CONNECT_S", 0.5)
    done = night_here("night-render", unrendered, "--cluster", "tcp://127.0.0.1:9")
    assert done.returncode == 2
    assert "Error: no Dask scheduler answers at tcp://127.0.0.1:9" in done.stderr


def test_wrong_workers_leave_no_settings_for_the_next_run(unrendered):
    for wrong in (["--cluster", "x://nonsense"], ["--cluster", "nowhere.toml"]):
        done = night_here("night-render", unrendered, "--resolution", "20x15", *wrong)
        assert done.returncode == 2
    assert not (unrendered / "renders").exists()


# Workers that die


@pytest.fixture(scope="module")
def after_deaths(seven_renders, tmp_path_factory):
    """A run whose worker was killed twice in scene 000004 and once in 000005; its folder, code and output."""
    data = tmp_path_factory.mktemp("deaths") / "data"
    shutil.copytree(seven_renders, data, ignore=shutil.ignore_patterns("*.log"))
    for scene_id in ("000004", "000005", "000006"):
        shutil.rmtree(data / "renders" / scene_id)
    first, second = (claim_of(data, scene_id) for scene_id in ("000004", "000005"))
    to_be_killed = [(first, 1), (first, 2), (second, 1)]  # in whatever order these attempts begin
    process = start_render(data, "--workers", "2")

    def all_are_killed():
        for claim, attempt in to_be_killed:
            if killed_in(process, claim, attempt):
                to_be_killed.remove((claim, attempt))
                break
        return not to_be_killed

    try:
        wait_for(all_are_killed)
    except BaseException:
        process.kill()
        raise
    finally:
        output, errors = process.communicate()
    return data, process.returncode, output, errors


@pytest.mark.long
def test_a_worker_killed_in_a_scene_costs_one_retry_of_that_scene(after_deaths, seven_renders):
    data = after_deaths[0]
    failures = [line for line in run_log(data).splitlines() if "000005 failed on" in line]
    assert len(failures) == 1
    assert "once more" in failures[0]
    files = results(data)
    of_scene = {name for name in files if name.startswith("renders/000005/")}
    assert len(of_scene) == 5
    assert {name: files[name] for name in of_scene} == {
        name: results(seven_renders)[name] for name in of_scene
    }


@pytest.mark.long
def test_a_scene_that_kills_its_worker_twice_is_recorded_and_the_rest_goes_on(
    after_deaths, seven_renders, render_here, tmp_path
):
    found, code, output, errors = after_deaths
    assert code == 1, errors
    assert output.startswith("2 scenes rendered, 4 were there")
    assert "scene 000004: its worker process died" in errors
    failure = read_failure(found / "renders" / "000004")
    assert failure is not None
    assert failure.attempts == 2
    assert "died" in failure.reason
    assert (found / "renders" / "000004" / "failure.log").read_text()

    data = shutil.copytree(found, tmp_path / "data")
    status = night_here("night-render", "status", data).stdout
    assert "7 scenes: 6 done, 0 running, 1 failed, 0 missing" in status
    assert "failed: scene 000004: its worker process died" in status
    again = render_here(data)
    assert again.returncode == 1
    assert again.stdout.startswith("0 scenes rendered, 6 were there")
    assert "left out: 1 scene that failed earlier" in again.stderr
    healed = render_here(data, "--again", "failed")
    assert healed.returncode == 0, healed.stderr
    assert results(data) == results(seven_renders)


@pytest.mark.long
def test_a_worker_killed_after_a_scene_and_before_its_answer_has_rendered_it(three_missing, seven_renders):
    def killed_before_the_answer(job):
        render_scenes(job)
        os.kill(os.getpid(), signal.SIGKILL)

    dataset = open_dataset(three_missing)
    settings = RenderSettings(product="both", options=ManyLightOptions(error=0.05), device="cpu")
    answers = []
    with connected(workers=1, scheduler=None, cluster_file=None, device="cpu") as client:
        queue = RenderQueue(
            *(client, dataset, settings, "a run", lambda *answer: answers.append(answer)),
            work=killed_before_the_answer,
        )
        tally = queue.run(["000004", "000005", "000006"])
    assert (tally.counts, tally.failures) == ({"rendered": 3}, {})
    assert [outcome.scene_id for outcome, final in answers if final] == ["000004", "000005", "000006"]
    assert all(outcome.attributes["lights"] for outcome, _ in answers)
    assert not list((three_missing / "renders" / ".claims").iterdir())
    found, expected = results(three_missing), results(seven_renders)
    images = [name for name in expected if name.endswith(".exr")]
    assert [found[name] for name in images] == [expected[name] for name in images]


@pytest.mark.long
def test_attempts_are_those_that_began(three_missing, tmp_path):
    died = tmp_path / "died"

    def dies_once_and_then_fails(job):
        if not died.exists():
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return [Outcome(each, "failed", "the scene is bad") for each in job.scene_ids]

    dataset = open_dataset(three_missing)
    settings = RenderSettings(product="both", options=ManyLightOptions(error=0.05), device="cpu")
    with connected(workers=1, scheduler=None, cluster_file=None, device="cpu") as client:
        queue = RenderQueue(
            client, dataset, settings, "a run", lambda *_: None, work=dies_once_and_then_fails
        )
        assert queue.run(["000004"]).failures == {"000004": "the scene is bad"}
    failure = read_failure(three_missing / "renders" / "000004")
    assert failure is not None
    assert failure.attempts == 2


@pytest.mark.thorough
def test_a_worker_that_is_slow_to_come_back_is_waited_for(three_missing):
    process = start_render(three_missing)
    claim = claim_of(three_missing, "000004")
    wait_for(lambda: killed_in(process, claim))
    wait_for(lambda: workers_of(process))
    (fresh,) = workers_of(process)
    fresh.suspend()
    time.sleep(20)  # by default Dask would stop waiting for it after 15
    fresh.resume()
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    assert output.startswith("3 scenes rendered, 4 were there")


class DyingWorkers:
    """A client whose workers do the first jobs as they should, and die of all others."""

    status = "running"

    def __init__(self, done):
        self.done = done

    def nthreads(self):
        return {"tcp://one": 1}

    def submit(self, work, packed, **_):
        future = Future()
        future.release = lambda: None
        job = loads(packed)[1]
        if self.done:
            self.done -= 1
            future.set_result([Outcome(each, "rendered") for each in job.scene_ids])
        else:
            future.set_exception(KilledWorker("a job", SimpleNamespace(address="tcp://one"), 0))
        return future


@pytest.mark.parametrize(("done", "given_up"), [(0, 3), (1, 6)])
def test_workers_that_die_of_each_of_the_first_scenes_end_the_run(unrendered, done, given_up):
    dataset = open_dataset(unrendered)
    settings = RenderSettings(product="both", options=ManyLightOptions(), device="cpu")
    queue = RenderQueue(DyingWorkers(done), dataset, settings, "a run", lambda *_: None)
    if done:
        queue.run(dataset.ids())
    else:
        with pytest.raises(QueueError, match="use fewer --workers or a smaller --resolution"):
            queue.run(dataset.ids())
    assert len(queue.tally.failures) == given_up
