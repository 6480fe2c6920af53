"""Rendering as a queue: killed, crowded, out of space and on other people's workers, the files are the same.

Every test runs the real commands, with real worker processes, and compares with one undisturbed run.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import psutil
import pytest
from night_commands import PRESET, night, words

from itof import read_image, write_image
from render.farm.run import RunOptions, render_dataset
from render.settings import RenderSettings
from render.transport.method import MethodOptions
from scenegen import open_dataset, read_failure, read_record, sha256_of

# About half a second a scene, so that a signal at a random moment meets a scene at work.
SETTINGS = ["--lights", "2048", "--device", "cpu"]


def night_render(data, *arguments, settings=SETTINGS):
    return night("night-render", data, *settings, *arguments)


def start_render(data, *arguments, **options):
    return subprocess.Popen(
        words("night-render", data, *SETTINGS, *arguments),
        **options,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def results(data):
    """Hash of everything a run leaves but its log, its locks and what it remembers."""
    files = [data / "dataset.json", *sorted(data.glob("renders/[0-9]*/*"))]
    return {file.relative_to(data).as_posix(): sha256_of(file) for file in files}


def run_log(data):
    return (data / "renders" / "night-render.log").read_text()


def workers_of(process):
    """The processes of a command that render (not those that only keep count of resources)."""
    try:
        found = psutil.Process(process.pid).children(recursive=True)
        return [child for child in found if "spawn_main" in " ".join(child.cmdline())]
    except psutil.NoSuchProcess:
        return []


def wait_for(condition, seconds=90):
    """Wait for something to happen; the limit only keeps a broken test from hanging."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return
        time.sleep(0.01)
    pytest.fail("it did not happen")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("queue")
    (folder / "small.toml").write_text(PRESET)
    made = words("night-gen", "scenes", folder / "data", "--preset", folder / "small.toml")
    subprocess.run(made, check=True, capture_output=True)
    return folder / "data"


@pytest.fixture(scope="module")
def undisturbed(scenes, tmp_path_factory):
    data = tmp_path_factory.mktemp("undisturbed") / "data"
    shutil.copytree(scenes, data)
    started = time.monotonic()
    done = night_render(data)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("7 scenes rendered, 0 were there")
    return data, results(data), time.monotonic() - started


@pytest.fixture
def data(scenes, tmp_path):
    """Scenes without renders, free to be rendered."""
    shutil.copytree(scenes, tmp_path / "data")
    return tmp_path / "data"


@pytest.fixture
def rendered(undisturbed, tmp_path):
    """A rendered dataset, free to be damaged."""
    shutil.copytree(undisturbed[0], tmp_path / "data")
    return tmp_path / "data"


def test_a_command_killed_ten_times_at_random_leaves_what_an_undisturbed_one_does(data, undisturbed):
    _, expected, seconds = undisturbed
    moments = np.random.default_rng(4)
    killed = 0
    while killed < 10:
        process = start_render(data)
        try:
            process.wait(moments.uniform(0.2, 0.9) * seconds)
            shutil.rmtree(data / "renders")  # it was faster than the signal: begin anew
        except subprocess.TimeoutExpired:
            workers = workers_of(process)
            process.kill()
            killed += 1
            # Workers must not render on behind the back of the next command.
            psutil.wait_procs(workers, timeout=30)
            assert not any(worker.is_running() for worker in workers)
        process.communicate()
    done = night_render(data)
    assert done.returncode == 0, done.stderr
    assert results(data) == expected
    assert not list(data.glob("renders/[0-9]*/.*"))


@pytest.mark.parametrize("workers", [2, 4])
def test_results_do_not_depend_on_the_number_of_workers(data, undisturbed, workers):
    done = night_render(data, "--workers", workers)
    assert done.returncode == 0, done.stderr
    assert results(data) == undisturbed[1]
    assert len(set(re.findall(r"rendered in .* on (\S+)", run_log(data)))) == workers


@contextmanager
def dask_processes(folder, *workers):
    """A Dask scheduler and workers as processes of their own; yields its address and its process."""
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    running = []
    try:
        scheduler = subprocess.Popen(
            words("dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"),
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        running.append(scheduler)
        address = None
        while address is None:
            line = scheduler.stderr.readline()
            assert line, "the scheduler did not start"
            match = re.search(r"Scheduler at:\s+(tcp://\S+)", line)
            address = match and match[1]
        for options in workers:
            worker = words("dask", "worker", address, "--no-dashboard", "--local-directory", folder, *options)
            running.append(subprocess.Popen(worker, stderr=subprocess.DEVNULL, env=environment))
        yield address, scheduler
    finally:
        for process in reversed(running):
            process.terminate()
        for process in running:
            process.wait(30)
        running[0].stderr.close()


def test_workers_of_an_existing_scheduler_give_the_same(data, undisturbed, tmp_path):
    with dask_processes(tmp_path, ["--nthreads", "1"], ["--nthreads", "2"]) as (address, _):
        done = night_render(data, "--scheduler", address)
    assert done.returncode == 0, done.stderr
    assert results(data) == undisturbed[1]


def test_a_scheduler_that_is_not_there_is_named(data):
    done = night_render(data, "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in done.stderr


def test_workers_that_grow_make_way_for_fresh_ones(data, undisturbed):
    dataset = open_dataset(data)
    settings = RenderSettings(product="both", options=MethodOptions(lights=2048), device="cpu")
    # No growth allowed: whoever is larger after a scene than after its first one goes.
    options = RunOptions(workers=1, growth_bytes=0, progress=False)
    result = render_dataset(dataset, settings, dataset.ids(), options, lambda _: None)
    assert result.failures == {}
    assert results(data) == undisturbed[1]
    assert len(set(re.findall(r"rendered in .* on (\S+)", run_log(data)))) > 1
    assert " failed on " not in run_log(data)


def kill_worker_at(process, claim):
    """Kill the worker that has a scene claimed; it must be at work on it."""
    wait_for(lambda: claim.exists() and claim.read_text())
    (worker,) = workers_of(process)
    worker.send_signal(signal.SIGKILL)
    worker.wait(30)


def test_a_worker_that_is_slow_to_come_back_is_waited_for(data):
    process = start_render(data)
    kill_worker_at(process, data / "renders" / ".claims" / "000002")
    wait_for(lambda: workers_of(process))
    (fresh,) = workers_of(process)
    fresh.suspend()
    time.sleep(20)  # Dask would give it up after 15
    fresh.resume()
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    assert output.startswith("7 scenes rendered, 0 were there")


def test_a_worker_killed_in_a_scene_costs_one_retry_of_that_scene(data, undisturbed):
    process = start_render(data)
    kill_worker_at(process, data / "renders" / ".claims" / "000002")
    output, errors = process.communicate()
    assert process.returncode == 0, errors
    assert output.startswith("7 scenes rendered, 0 were there")
    assert results(data) == undisturbed[1]
    failures = [line for line in run_log(data).splitlines() if " failed on " in line]
    assert len(failures) == 1
    assert "000002 failed" in failures[0]
    assert "once more" in failures[0]


def test_a_scene_that_kills_its_worker_twice_is_recorded_and_the_rest_goes_on(data, undisturbed):
    process = start_render(data)
    claim = data / "renders" / ".claims" / "000001"
    kill_worker_at(process, claim)
    wait_for(lambda: claim.read_text().endswith(": 2}"))
    kill_worker_at(process, claim)
    output, errors = process.communicate()
    assert process.returncode == 1, errors
    assert output.startswith("6 scenes rendered, 0 were there")
    assert "scene 000001: its worker process died" in errors
    failure = read_failure(data / "renders" / "000001")
    assert failure is not None
    assert failure.attempts == 2
    assert "died" in failure.reason
    assert (data / "renders" / "000001" / "failure.log").read_text()

    status = night_render(data, "--status")
    assert "7 scenes: 6 done, 0 running, 1 failed, 0 missing" in status.stdout
    assert "failed: 000001: its worker process died" in status.stdout
    again = night_render(data)
    assert again.returncode == 1
    assert again.stdout.startswith("0 scenes rendered, 6 were there")
    assert "1 scenes failed earlier" in again.stderr
    healed = night_render(data, "--retry-failed")
    assert healed.returncode == 0, healed.stderr
    assert results(data) == undisturbed[1]


def test_a_scene_that_cannot_be_rendered_leaves_the_others_alone(data, undisturbed):
    mesh = data / "scenes" / "000004" / "hidden_object_0.ply"
    whole = mesh.read_bytes()
    mesh.write_bytes(whole[: len(whole) // 2])
    done = night_render(data, settings=["--lights", "64", "--device", "cpu", "--product", "itof"])
    assert done.returncode == 1
    assert done.stdout.startswith("6 scenes rendered")
    assert "000004" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Traceback" in (data / "renders" / "000004" / "failure.log").read_text()
    mesh.write_bytes(whole)  # another scene than the one that failed: no --retry-failed needed
    assert night_render(data, settings=["--device", "cpu"]).stdout.startswith(
        "1 scenes rendered, 6 were there"
    )


def test_scenes_whose_description_is_gone_fail_alone(data, undisturbed):
    kept = {name: data.parent / name for name in ("000002", "000005")}
    shutil.move(data / "scenes" / "000002", kept["000002"])
    shutil.copytree(data / "scenes" / "000005", kept["000005"])
    (data / "scenes" / "000005" / "scene.json").unlink()
    done = night_render(data)
    assert done.returncode == 1
    assert done.stdout.startswith("5 scenes rendered, 0 were there")
    assert re.search(r"failed: scene 000002: .*night-gen scenes again", done.stderr)
    assert re.search(r"failed: scene 000005: .*night-gen scenes again", done.stderr)
    assert "5 done, 0 running, 2 failed" in night_render(data, "--status").stdout
    shutil.move(kept["000002"], data / "scenes" / "000002")
    (data / "scenes" / "000005" / "scene.json").write_bytes((kept["000005"] / "scene.json").read_bytes())
    assert night_render(data).stdout.startswith("2 scenes rendered, 5 were there")
    assert results(data) == undisturbed[1]


def test_a_dataset_deleted_while_it_is_rendered_ends_the_run_and_stays_deleted(data):
    process = start_render(data)
    wait_for((data / "renders" / "000000" / "render.json").exists)
    data.rename(data.with_name("gone"))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "Traceback" not in errors
    assert not (data / "renders").exists()


def test_ctrl_c_ends_the_command_and_its_workers_without_a_word_too_many(data, undisturbed):
    process = start_render(data, "--workers", "2", start_new_session=True)
    wait_for((data / "renders" / ".claims" / "000001").exists)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert errors.endswith("interrupted\n")
    assert night_render(data).returncode == 0
    assert results(data) == undisturbed[1]


def test_a_scheduler_that_dies_ends_the_run_with_one_sentence(data, undisturbed, tmp_path):
    with dask_processes(tmp_path, ["--nthreads", "1"]) as (address, scheduler):
        process = start_render(data, "--scheduler", address)
        wait_for((data / "renders" / ".claims" / "000001").exists)
        scheduler.kill()
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "connection to the Dask scheduler was lost" in errors
    assert "Traceback" not in errors
    assert night_render(data).returncode == 0
    assert results(data) == undisturbed[1]


def test_two_commands_agree_that_a_scene_cannot_be_rendered(data):
    mesh = data / "scenes" / "000001" / "hidden_object_0.ply"
    mesh.write_bytes(mesh.read_bytes()[:200])
    both = [start_render(data), start_render(data)]
    outputs = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [1, 1], outputs
    assert all("failed: scene 000001" in errors for _, errors in outputs)
    assert len(re.findall("000001 failed on", run_log(data))) <= 4  # two attempts each


def test_training_refuses_renders_that_verification_found_bad(rendered):
    folders = [rendered / "renders" / name for name in ("000000", "000001")]
    shutil.copy(folders[1] / "itof.exr", folders[0] / "itof.exr")
    run = rendered.parent / "run"
    for _ in range(2):  # before and after its record is gone
        done = night("night-train", rendered, "--out", run, "--max-epochs", "1", "--width", "2")
        assert done.returncode == 2
        assert "scene 000000" in done.stderr
        assert "run night-render" in done.stderr
        night_render(rendered, "--verify", settings=[])
    assert night_render(rendered, settings=[]).stdout.startswith("1 scenes rendered")


@pytest.mark.parametrize(
    ("options", "words_said"),
    [({"foo": 1}, "unexpected keyword argument 'foo'"), ({"error": None}, "not supported between")],
)
def test_a_dataset_rendered_in_an_unknown_way_is_refused(rendered, options, words_said):
    index = json.loads((rendered / "dataset.json").read_text())
    index["rendering"]["options"] = options
    (rendered / "dataset.json").write_text(json.dumps(index))
    for arguments in ([], ["--status"]):
        done = night_render(rendered, *arguments, settings=[])
        assert done.returncode == 2
        assert "the key rendering of" in done.stderr
        assert words_said in done.stderr
        assert done.stderr.count("\n") == 1


def test_truncated_flipped_foreign_and_missing_files_are_found_and_repaired(rendered, undisturbed):
    folder = rendered / "renders"
    truncated = folder / "000000" / "itof.exr"
    truncated.write_bytes(truncated.read_bytes()[:-100])
    flipped = folder / "000001" / "transient.exr"
    content = bytearray(flipped.read_bytes())
    content[len(content) // 2] ^= 1
    flipped.write_bytes(content)
    foreign = folder / "000002" / "mirrored.exr"
    write_image(foreign, read_image(foreign).channels, {"comment": "made by somebody else"})
    (folder / "000003" / "mirrored_transient.exr").unlink()
    (folder / "000004" / "render.json").write_text("{")

    done = night_render(rendered, "--verify")
    assert done.returncode == 1
    bad = dict(re.findall(r"^bad: (\d+): (.*)$", done.stdout, re.MULTILINE))
    assert "itof.exr has" in bad["000000"]
    assert "transient.exr is not what was written" in bad["000001"]
    assert "mirrored.exr has" in bad["000002"]
    assert "mirrored_transient.exr is missing" in bad["000003"]
    assert "render.json is damaged" in bad["000004"]
    assert "7 scenes checked: 2 good, 5 bad" in done.stdout

    assert night_render(rendered).stdout.startswith("5 scenes rendered, 2 were there")
    assert results(rendered) == undisturbed[1]
    clean = night_render(rendered, "--verify", "--workers", 2)
    assert clean.returncode == 0
    assert "7 scenes checked: 7 good, 0 bad" in clean.stdout


def test_damage_is_repaired_without_verify_too(rendered, undisturbed):
    file = rendered / "renders" / "000005" / "itof.exr"
    content = bytearray(file.read_bytes())
    content[-50] ^= 4
    file.write_bytes(content)
    assert "1 are there but damaged" in night_render(rendered, "--status").stdout
    assert night_render(rendered).stdout.startswith("1 scenes rendered, 6 were there")
    assert results(rendered) == undisturbed[1]


def test_two_commands_at_once_share_the_work(data, undisturbed):
    both = [start_render(data), start_render(data)]
    outputs = [process.communicate() for process in both]
    assert [process.returncode for process in both] == [0, 0], outputs
    counts = [re.match(r"(\d+) scenes rendered, (\d+) were there", out) for out, _ in outputs]
    assert sum(int(match[1]) for match in counts) == 7  # no scene twice
    assert all(int(match[1]) + int(match[2]) == 7 for match in counts)
    assert results(data) == undisturbed[1]


def test_two_commands_with_other_settings_do_not_trample_each_other(data, undisturbed):
    first = start_render(data)
    claim = data / "renders" / ".claims" / "000000"
    wait_for(lambda: claim.exists() and claim.read_text())
    (worker,) = workers_of(first)
    worker.suspend()  # or it might be done before the others have looked
    running = night_render(data, "--status")
    second = night_render(data, settings=["--lights", "64", "--device", "cpu"])
    worker.resume()
    assert second.returncode == 2
    assert "another night-render is rendering" in second.stderr
    first.communicate()
    assert first.returncode == 0
    assert running.stdout.startswith("7 scenes: 0 done, 1 running, 0 failed, 6 missing")
    assert results(data) == undisturbed[1]


def test_other_settings_replace_nothing_unasked(rendered, undisturbed):
    fewer = ["--lights", "64", "--device", "cpu"]
    done = night_render(rendered, settings=fewer)
    assert done.returncode == 2
    assert "--replace" in done.stderr
    assert results(rendered) == undisturbed[1]
    assert night_render(rendered, settings=[]).stdout.startswith("0 scenes rendered, 7 were there")
    done = night_render(rendered, "--replace", "--only", "000003", settings=fewer)
    assert done.stdout.startswith("1 scenes rendered")
    assert '"lights": 64' in read_record(rendered / "renders" / "000003").recipe


@contextmanager
def small_disk(folder, size):
    """A tmpfs of `size` mounted on `folder`; yields a function that changes its size."""
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("mounting a small disk needs root")
    try:
        yield lambda more: subprocess.run(
            ["mount", "-o", f"remount,size={more}", folder], check=True, capture_output=True
        )
    finally:
        subprocess.run(["umount", "-l", folder], check=True, capture_output=True)


def test_a_full_disk_stops_the_run_and_what_is_done_stays(scenes, undisturbed, tmp_path):
    with small_disk(tmp_path / "disk", "3m") as resize:
        data = tmp_path / "disk" / "data"
        shutil.copytree(scenes, data)
        refused = night_render(data)
        assert refused.returncode == 2
        assert "7 scenes need about" in refused.stderr
        assert "--product itof needs" in refused.stderr
        assert not list(data.glob("renders/0*"))
        full = night_render(data, "--ignore-space")
        assert full.returncode == 2
        assert "no space left for scene" in full.stderr.splitlines()[-1]
        assert "Traceback" not in full.stderr
        assert not list(data.glob("renders/*/failure.json"))
        whole = [read_record(folder) for folder in data.glob("renders/0*") if any(folder.iterdir())]
        resize("200m")
        done = night_render(data)
        assert done.returncode == 0, done.stderr
        assert len([record for record in whole if record is not None]) < 7
        assert results(data) == undisturbed[1]


def test_a_larger_product_adds_files_and_keeps_the_rest_as_it_was(data, undisturbed):
    small = night_render(data, "--product", "itof")
    assert small.returncode == 0, small.stderr
    assert {file.name for file in (data / "renders" / "000000").iterdir()} == {
        "itof.exr",
        "mirrored.exr",
        "render.json",
    }
    more = night_render(data, "--product", "both", "--only", "000003")
    assert more.stdout.startswith("1 scenes rendered")
    # Transients of one scene are no wish for those of all.
    assert night_render(data, settings=[]).stdout.startswith("0 scenes rendered, 7 were there")
    rest = night_render(data, "--product", "both")
    assert rest.stdout.startswith("6 scenes rendered, 1 were there")
    assert results(data) == undisturbed[1]


def test_transients_can_go_and_come_back(rendered, undisturbed):
    done = night_render(rendered, "--convert", "itof", settings=[])
    assert done.returncode == 0, done.stderr
    assert "MB freed" in done.stdout
    assert not list(rendered.glob("renders/*/*transient.exr"))
    assert night_render(rendered, settings=[]).stdout.startswith("0 scenes rendered, 7 were there")
    assert "7 good, 0 bad" in night_render(rendered, "--verify", settings=[]).stdout
    night_render(rendered, "--product", "both", settings=[])
    assert results(rendered) == undisturbed[1]


def test_transients_are_exported_and_filmed_from_the_command_line(rendered, tmp_path):
    out = tmp_path / "out"
    done = night_render(rendered, "--convert", "tal", "--only", "000002", "--out", out, settings=[])
    assert done.returncode == 0, done.stderr
    done = night_render(
        rendered,
        *("--convert", "itof", "--frequencies", "70,30", "--only", "000002", "--out", out),
        settings=[],
    )
    assert done.returncode == 0, done.stderr
    done = night_render(rendered, "--movie", "000002", "--out", out / "light.mp4", settings=[])
    assert done.returncode == 0, done.stderr
    assert {file.name for file in out.iterdir()} == {"000002.hdf5", "000002_itof.exr", "light.mp4"}
    assert read_image(out / "000002_itof.exr").phasors()[1] == (30e6, 70e6)
    for arguments, words_said in (
        (("--convert", "tal"), "--out"),
        (("--convert", "itof", "--frequencies", "7,x", "--out", out), "no list of frequencies"),
        (("--movie", "000009"), "no scene 000009"),
        (("--status", "--verify"), "give one"),
    ):
        refused = night_render(rendered, *arguments, settings=[])
        assert refused.returncode == 2
        assert words_said in refused.stderr
        assert "Traceback" not in refused.stderr


def test_the_dataset_says_how_and_how_well_it_was_rendered(undisturbed):
    data = undisturbed[0]
    dataset = open_dataset(data)
    made = dataset.index.rendering
    assert (made.method, made.product, made.width, made.height) == ("many-light", "both", 24, 18)
    assert made.options["lights"] == 2048
    assert made.scene_count == 7
    assert made.packages["mitsuba"]
    errors = [
        float(read_image(dataset.render_folder(scene) / "itof.exr").attributes["hidden_error"])
        for scene in dataset.ids()
    ]
    assert made.hidden_error_max == max(errors)
    assert made.hidden_error_median == sorted(errors)[3]
