"""Batch systems: what would be submitted, a run whose jobs are real, and files that are not understood.

There is no SLURM here. `sbatch` and `scancel` are small stand-ins that start and stop the very job script.
"""

import gc
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import dask
import pytest
from night_commands import night_here, refusal
from render_runs import SETTINGS

from render.farm import submissions as batch_submissions
from render.farm.batch_system import batch_cluster
from render.farm.clusters import check_cluster
from render.farm.dask_settings import ClusterError, dask_settings
from render.farm.queue import QueueError, RenderQueue
from render.farm.submissions import Submissions

ROOT = Path(__file__).parents[3]
SBATCH = """#!/bin/sh
cp "$1" "$JOBS/script.$$"
setsid sh -c 'exec bash "$0" >/dev/null 2>&1' "$JOBS/script.$$" &
echo $! > "$JOBS/pid.$!"
echo "Submitted batch job $!"
"""
ONE_JOB = 'mkdir "$JOBS/taken" 2>/dev/null || { echo "job limit" >&2; exit 1; }\n'
SCANCEL = """#!/bin/sh
for job in "$@"; do kill -TERM -- "-$job" 2>/dev/null; done
exit 0
"""


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """A folder on PATH with `sbatch` and `scancel`; submitted scripts lie in it."""
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("JOBS", str(tmp_path))
    monkeypatch.chdir(tmp_path)  # job logs go to the folder a command is started in
    yield tmp_path
    for file in tmp_path.glob("pid.*"):
        subprocess.run(["scancel", file.suffix[1:]], check=False)


@pytest.mark.parametrize(
    ("system", "lines"),
    [
        (
            "slurm",
            [
                "#SBATCH -J night",
                "#SBATCH -p cpu",
                "#SBATCH --cpus-per-task=16",
                "#SBATCH --mem=30G",
                "#SBATCH -t 04:00:00",
            ],
        ),
        (
            "pbs",
            [
                "#PBS -N night",
                "#PBS -q workq",
                "#PBS -l select=1:ncpus=16:mem=30GB",
                "#PBS -l walltime=04:00:00",
            ],
        ),
    ],
)
def test_the_sample_files_ask_for_what_they_say(tmp_path, monkeypatch, system, lines):
    monkeypatch.chdir(tmp_path)
    with batch_cluster(ROOT / "data" / "clusters" / f"{system}.yaml", tmp_path) as cluster:
        script = cluster.job_script()
        address = cluster.scheduler_address
    for line in lines:
        assert line in script.splitlines()
    (command,) = [line for line in script.splitlines() if "dask_worker" in line]
    assert command.startswith(f"{sys.executable} -P -m distributed.cli.dask_worker {address} ")
    for words in ("--nworkers 4", "--nthreads 4", "--nanny", "--lifetime 225m", "--memory-limit 7.45GiB"):
        assert words in command


@pytest.mark.long
def test_a_run_on_a_batch_system_renders_in_its_jobs(slurm, unrendered, seven_renders):
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    queue: cpu\n    interface: lo\n"
    )
    only = [word for scene_id in ("000000", "000003") for word in ("--only", scene_id)]
    settings = [*SETTINGS, "--product", "itof", "--method", "many-light", *only]
    done = night_here(
        "night-render", unrendered, *settings, "--cluster", slurm / "cluster.yaml", "--workers", 2
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("2 scenes rendered")
    scripts = [file.read_text() for file in slurm.glob("script.*")]
    assert len(scripts) == 2
    assert all("#SBATCH -p cpu" in script for script in scripts)
    for scene_id in ("000000", "000003"):
        for name in ("itof.exr", "mirrored.exr"):
            file = Path("renders", scene_id, name)
            assert (unrendered / file).read_bytes() == (seven_renders / file).read_bytes()


@pytest.mark.parametrize(
    ("sbatch", "words"),
    [
        (
            "#!/bin/sh\necho 'invalid partition specified: cpu' >&2\nexit 1\n",
            "invalid partition specified: cpu",
        ),
        (None, "No such file or directory: 'sbatch'"),
    ],
)
def test_a_refused_job_ends_the_run_with_the_reason(slurm, unrendered, sbatch, words):
    (slurm / "sbatch").unlink()
    if sbatch is not None:
        (slurm / "sbatch").write_text(sbatch)
        (slurm / "sbatch").chmod(0o755)
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    queue: cpu\n    interface: lo\n"
    )
    sentence = refusal(
        *("night-render", unrendered, *SETTINGS, "--product", "itof", "--only", "000000"),
        *("--cluster", slurm / "cluster.yaml"),
    )
    assert "the batch system takes no job" in sentence
    assert words in sentence


@pytest.mark.long
def test_one_refused_job_of_several_does_not_end_the_run(slurm, unrendered):
    slow = "sleep 3\n"  # so the run sees the refusal while the other job is still being submitted
    (slurm / "sbatch").write_text(SBATCH.replace("#!/bin/sh\n", "#!/bin/sh\n" + ONE_JOB + slow))
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    queue: cpu\n    interface: lo\n"
    )
    done = night_here(
        *("night-render", unrendered, *SETTINGS, "--product", "itof", "--only", "000000", "--only", "000003"),
        *("--cluster", slurm / "cluster.yaml", "--workers", 2),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("2 scenes rendered")
    assert len(list(slurm.glob("script.*"))) == 1


def test_a_cluster_of_which_a_job_was_refused_can_be_closed(slurm):
    (slurm / "sbatch").write_text(SBATCH.replace("#!/bin/sh\n", "#!/bin/sh\n" + ONE_JOB))
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    interface: lo\n"
    )
    submissions = Submissions()
    with batch_cluster(slurm / "cluster.yaml", slurm, submissions) as cluster:
        cluster.scale(2)
        wait_until(lambda: submissions.accepted and submissions.refusals)
        jobs = set(submissions.unfinished)  # kept alive, as the refused job's traceback may do
    assert [job.status.name for job in jobs] == ["closed"]
    assert not submissions.unfinished
    assert submissions.pending == 0


@pytest.mark.long
@pytest.mark.parametrize("processes", [pytest.param(1, marks=pytest.mark.thorough), 2])
def test_a_job_that_ends_is_submitted_again(slurm, processes):
    (slurm / "cluster.yaml").write_text(
        f"jobqueue:\n  slurm:\n    cores: 2\n    memory: 4GB\n    interface: lo\n    processes: {processes}\n"
    )
    submissions = Submissions()
    with (
        dask_settings(is_local=False, shows_pages=False),
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1s"}),
        batch_cluster(slurm / "cluster.yaml", slurm, submissions) as cluster,
    ):
        cluster.adapt(minimum_jobs=1, maximum_jobs=1)
        wait_until(lambda: len(cluster.scheduler_info["workers"]) == processes)
        (job,) = slurm.glob("pid.*")
        os.killpg(int(job.suffix[1:]), signal.SIGKILL)
        wait_until(lambda: submissions.accepted == 2)
        assert len(submissions.unfinished) == 1


def test_a_job_that_is_refused_beside_others_is_submitted_again(slurm, monkeypatch):
    monkeypatch.setattr(batch_submissions, "_RETRY_S", 0.1)
    (slurm / "sbatch").write_text(SBATCH.replace("#!/bin/sh\n", "#!/bin/sh\n" + ONE_JOB))
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    interface: lo\n"
    )
    submissions = Submissions()
    with batch_cluster(slurm / "cluster.yaml", slurm, submissions) as cluster:
        cluster.adapt(minimum_jobs=2, maximum_jobs=2)
        wait_until(lambda: submissions.accepted == 1 and len(submissions.refusals) > 1)
        (slurm / "taken").rmdir()
        wait_until(lambda: submissions.accepted == 2)


def wait_until(holds):
    end = time.monotonic() + 180
    while not holds():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.05)


NOT_UNDERSTOOD = (
    ("jobqueue: [", "is not YAML"),
    ("cores: 4", "one section jobqueue.<system>"),
    ("jobqueue:\n  abacus:\n    cores: 4", "one section jobqueue.<system>"),
    ("jobqueue:\n  slurm: 4", "must hold keys"),
    (
        "jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    coers: 4",
        "unknown key coers of jobqueue.slurm; known keys are",
    ),
    ("jobqueue:\n  slurm:\n    cores: 4", "jobqueue.slurm needs memory"),
    *(
        (f"jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    {line}", "does not describe a job")
        for line in ("processes: 1.5", "job-script-prologue: 3")
    ),
    (
        "jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    security: abc",
        "security must be true, or left out",
    ),
    (
        "jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    processes: 0",
        "jobqueue.slurm.processes must be 1 to 1e+06 (got 0)",
    ),
    (
        "jobqueue:\n  slurm:\n    cores: 4\n    memory: 32",
        "jobqueue.slurm.memory must be 1e+08 to 1e+15 bytes (got 32): give it with a unit, like 32GB",
    ),
    ("jobqueue:\n  slurm:\n    cores: 4\n    memory: [1]", "does not describe a job"),
    ("jobqueue:\n  slurm:\n    cores: 4\n    memory: 1e400", "does not describe a job"),
    (
        "jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    shared-temp-directory: 3",
        "shared-temp-directory must be the name of a folder",
    ),
)


def test_a_cluster_file_that_is_not_understood_is_refused_by_name(tmp_path):
    file = tmp_path / "cluster.yaml"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # Dask's, of a cluster that fails while it is made
        for text, words in NOT_UNDERSTOOD:
            file.write_text(text)
            sentence = refused(file, tmp_path)
            assert words in sentence, text
            assert str(file) in sentence
        gc.collect()


def refused(file, folder):
    try:
        with batch_cluster(file, folder):
            pytest.fail("the file was taken")
    except ClusterError as error:
        return str(error)


def test_a_cluster_file_that_is_not_there_is_refused(tmp_path):
    file = tmp_path / "nowhere.yaml"
    with pytest.raises(ClusterError, match="No such file"), batch_cluster(file, tmp_path):
        pass


def test_joining_and_starting_a_cluster_at_once_is_refused(unrendered, tmp_path):
    with pytest.raises(ClusterError, match="either the address of a running cluster or a file"):
        check_cluster("tcp://localhost:1", tmp_path / "c.yaml")
    done = night_here("night-render", unrendered, "--cluster", "tcp://localhost:1", "--workers", 2)
    assert done.returncode == 2
    assert "a running cluster has its own workers" in done.stderr


class NoWorkers:
    """A client of a scheduler that has no workers."""

    status = "running"

    def nthreads(self):
        return {}


@pytest.mark.parametrize(
    ("pending", "accepted", "unfinished", "since_s", "ends"),
    [
        (0, 0, 0, 1, True),
        (1, 0, 0, 1, False),
        (0, 1, 1, 1000, False),
        (0, 1, 0, 1, False),
        (0, 1, 0, 181, True),
    ],
)
def test_a_run_ends_when_the_batch_system_takes_no_job_any_more(pending, accepted, unfinished, since_s, ends):
    queue = RenderQueue(NoWorkers(), None, None, "run", lambda outcome, final: None)
    queue.patience_s = None
    queue.submissions = Submissions(pending, accepted, set(range(unfinished)), ["job limit"])
    since = time.monotonic() - since_s
    if ends:
        with pytest.raises(QueueError, match=r"the batch system takes no job \(job limit\)"):
            queue._checked_idle(since)
    else:
        assert queue._checked_idle(since) == since


@pytest.mark.parametrize(
    ("submissions", "words"),
    [
        (
            None,
            "start one, or see the logs of those that were started; without one, the run ends after 1.7 h",
        ),
        (Submissions(0, 2, {1, 2}), "with 2 jobs submitted: see the queue of the batch system"),
        (Submissions(1), "and no job submitted yet"),
    ],
)
def test_a_run_without_workers_says_so_after_a_minute_and_then_ever_less_often(submissions, words):
    said = []
    queue = RenderQueue(NoWorkers(), None, None, "run", lambda outcome, final: None, say=said.append)
    queue.patience_s = 6000 if submissions is None else None
    queue.submissions = submissions or Submissions()
    for waited_s in range(0, 5000, 10):
        queue._checked_idle(time.monotonic() - waited_s)
    times = [re.match(r"no worker for (\d+ \w+)", sentence)[1] for sentence in said]
    assert times == ["60 s", "2 min", "4 min", "8 min", "16 min", "32 min", "64 min"]
    assert all(words in sentence for sentence in said)
