"""Batch systems: what would be submitted, a run whose jobs are real, and files that are not understood.

There is no SLURM here. `sbatch` and `scancel` are small stand-ins that start and stop the very job script.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from night_commands import night

import cli
from render.farm.clusters import ClusterError, batch_cluster

ROOT = Path(__file__).parent.parent
SBATCH = """#!/bin/sh
cp "$1" "$JOBS/script.$$"
setsid sh -c 'exec bash "$0" >/dev/null 2>&1' "$JOBS/script.$$" &
echo $! > "$JOBS/pid.$!"
echo "Submitted batch job $!"
"""
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
    with batch_cluster(ROOT / "data" / "clusters" / f"{system}.yaml") as cluster:
        script = cluster.job_script()
        address = cluster.scheduler_address
    for line in lines:
        assert line in script.splitlines()
    (command,) = [line for line in script.splitlines() if "dask_worker" in line]
    assert command.startswith(f"{sys.executable} -m distributed.cli.dask_worker {address} ")
    for words in ("--nworkers 4", "--nthreads 4", "--nanny", "--lifetime 225m", "--memory-limit 7.45GiB"):
        assert words in command


def test_a_run_on_a_batch_system_renders_in_its_jobs(slurm):
    (slurm / "small.toml").write_text(
        "[dataset]\ncount = 3\n[camera]\nwidth = 16\nheight = 12\n[transient]\nbin_count = 1400\n"
    )
    (slurm / "cluster.yaml").write_text(
        "jobqueue:\n  slurm:\n    cores: 1\n    memory: 4GB\n    queue: cpu\n    interface: lo\n"
    )
    assert night("night-gen", "scenes", "data", "--preset", "small.toml").returncode == 0
    settings = ["--lights", "64", "--product", "itof", "--device", "cpu"]
    done = night("night-render", "data", *settings, "--cluster", "cluster.yaml", "--workers", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("3 scenes rendered")
    scripts = [file.read_text() for file in slurm.glob("script.*")]
    assert len(scripts) == 2
    assert all("#SBATCH -p cpu" in script for script in scripts)

    shutil.copytree("data", "local", ignore=shutil.ignore_patterns("renders"))
    assert night("night-render", "local", *settings).returncode == 0
    for scene in ("000000", "000001", "000002"):
        for name in ("itof.exr", "mirrored.exr", "render.json"):
            files = [Path(data, "renders", scene, name) for data in ("data", "local")]
            assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("jobqueue: [", "is no YAML"),
        ("cores: 4", "one section jobqueue.<system>"),
        ("jobqueue:\n  abacus:\n    cores: 4", "one section jobqueue.<system>"),
        ("jobqueue:\n  slurm: 4", "must hold keys"),
        (
            "jobqueue:\n  slurm:\n    cores: 4\n    memory: 1GB\n    coers: 4",
            "unknown key coers of jobqueue.slurm; known are",
        ),
        ("jobqueue:\n  slurm:\n    cores: 4", "jobqueue.slurm needs memory"),
    ],
)
def test_a_cluster_file_that_is_not_understood_is_refused_by_name(tmp_path, text, words):
    file = tmp_path / "cluster.yaml"
    file.write_text(text)
    with pytest.raises(ClusterError, match=re.escape(words)) as refusal:
        batch_cluster(file)
    assert str(file) in str(refusal.value)


def test_a_cluster_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ClusterError, match="No such file"):
        batch_cluster(tmp_path / "nowhere.yaml")


def test_joining_and_starting_a_cluster_at_once_is_refused(make_dataset, tmp_path):
    dataset = make_dataset({"dataset": {"count": 1}, "hidden_object": {"composite_fraction": 0.0}})
    words = [str(dataset.root), "--scheduler", "tcp://localhost:1", "--cluster", str(tmp_path / "c.yaml")]
    result = CliRunner().invoke(cli.night_render, words)
    assert result.exit_code == 2
    assert "either --scheduler or --cluster" in result.stderr
