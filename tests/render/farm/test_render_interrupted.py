"""Runs that are disturbed: killed, interrupted, without scheduler, disk or dataset; the files stay right.

Real commands and real worker processes; the results are compared with those of one undisturbed run.
"""

import os
import re
import shutil
import signal
from dataclasses import replace

import psutil
import pytest
from dask_processes import dask_processes
from full_disk import small_disk
from night_commands import night_here
from render_runs import begun, claim_of, meanwhile, results, start_render, wait_for, workers_of

from render import render_files
from render.farm import jobs
from render.farm.claims import claimed
from render.options import ManyLightOptions
from render.settings import RenderSettings
from scenegen import read_record


def kill_with_workers(process):
    """Kill a command; its workers must end too, and not render on unseen by the next command."""
    workers = workers_of(process)
    process.kill()
    psutil.wait_procs(workers, timeout=300)
    assert not any(worker.is_running() for worker in workers)
    process.communicate()


@pytest.mark.long
def test_a_killed_command_leaves_what_an_undisturbed_one_does(three_missing, seven_renders, render_here):
    process = start_render(three_missing)
    wait_for(lambda: begun(claim_of(three_missing, "000004")))  # so 000006 is done, and 000005 comes last
    kill_with_workers(process)
    done = render_here(three_missing)
    assert done.returncode == 0, done.stderr
    assert re.match("[12] scenes rendered", done.stdout)  # 000004 may have been finished before the kill
    assert results(three_missing) == results(seven_renders)
    assert not list(three_missing.glob("renders/[0-9]*/.*"))


@pytest.mark.long
def test_ctrl_c_ends_the_command_and_its_workers_with_one_word(three_missing, seven_renders, render_here):
    process = start_render(three_missing, start_new_session=True)
    wait_for(lambda: begun(claim_of(three_missing, "000004")))
    workers = workers_of(process)
    assert workers
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert errors.endswith("interrupted\n")
    assert not any(worker.is_running() for worker in workers)
    assert render_here(three_missing).returncode == 0
    assert results(three_missing) == results(seven_renders)


@pytest.mark.long
def test_a_scheduler_that_dies_ends_the_run_with_one_sentence(
    three_missing, seven_renders, render_here, tmp_path
):
    with dask_processes(tmp_path, ["--no-nanny", "--nthreads", "1"]) as (address, scheduler):

        def kill_the_scheduler():
            wait_for(lambda: begun(claim_of(three_missing, "000004")))
            scheduler.kill()

        with meanwhile(kill_the_scheduler):
            done = night_here("night-render", three_missing, "--cluster", address)
    assert done.returncode == 2
    assert "connection to the Dask scheduler was lost" in done.stderr
    assert render_here(three_missing).returncode == 0
    assert results(three_missing) == results(seven_renders)


def test_a_dataset_deleted_while_it_is_rendered_ends_the_run_and_stays_deleted(three_missing, render_here):
    def delete():
        wait_for((three_missing / "renders" / "000004" / "render.json").exists)
        three_missing.rename(three_missing.with_name("gone"))

    # No worker is in the middle of a scene when the folder goes: it would make that scene's folder again.
    renders = three_missing / "renders"
    with claimed(renders, "000005"), claimed(renders, "000006"), meanwhile(delete):
        done = render_here(three_missing)
    assert done.returncode == 2
    assert "is no dataset" in done.stderr
    assert not three_missing.exists()


def test_a_dataset_deleted_while_a_file_is_written_is_not_taken_for_a_full_disk(three_missing, monkeypatch):
    encoded = render_files.image_bytes

    def delete_and_encode(*given, **options):
        three_missing.rename(three_missing.with_name("gone"))
        return encoded(*given, **options)

    monkeypatch.setattr(render_files, "image_bytes", delete_and_encode)
    monkeypatch.setattr(jobs, "_state", {})
    settings = RenderSettings(options=ManyLightOptions(error=0.05), device="cpu")
    job = jobs.Job(str(three_missing), settings, ("000004",), run_id="a")
    (outcome,) = jobs.render_scenes(job)
    assert outcome.kind == "failed"
    assert "No such file or directory" in outcome.reason
    (after,) = jobs.render_scenes(replace(job, scene_ids=("000005",)))
    assert after.kind == "stop"
    assert "is no dataset" in after.reason


@pytest.mark.long
def test_a_full_disk_stops_the_run_and_what_is_done_stays(
    three_missing, seven_renders, render_here, tmp_path
):
    with small_disk(tmp_path / "disk") as resize:
        data = shutil.copytree(three_missing, tmp_path / "disk" / "data")
        used = shutil.disk_usage(data).used
        resize(used + 700_000)  # a scene takes 480 kB
        refused = render_here(data)
        assert refused.returncode == 2
        assert "3 scenes would take about" in refused.stderr
        assert "--product itof needs" in refused.stderr
        assert "there is room for 1 scene" in refused.stderr
        assert not (data / "renders" / "000004").exists()
        full = render_here(data, "--accept", "small-disk")
        assert full.returncode == 2
        assert "no space left for scene" in full.stderr.splitlines()[-1]
        assert not list(data.glob("renders/*/failure.json"))
        whole = [read_record(folder) for folder in data.glob("renders/0*") if any(folder.iterdir())]
        assert len([record for record in whole if record is not None]) < 7
        resize(used + 10_000_000)
        done = render_here(data)
        assert done.returncode == 0, done.stderr
        assert results(data) == results(seven_renders)
