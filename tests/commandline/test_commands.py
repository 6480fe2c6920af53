"""The four commands as a user types them: the whole pipeline, and what is the process's own."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from full_disk import file_size_limit
from night_commands import FIGURES, TRAINING, UNCERTAINTY, night, night_here, refusal, words
from render_runs import workers_of

from disk.byte_size import size
from itof import TransientReader, read_image
from scenegen import open_dataset


def tree(folder):
    """Contents of all files of a folder, except the hashes that are remembered."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and file.name != ".hashes.json"]
    return {file: file.read_bytes() for file in files}


def test_the_four_commands_go_from_nothing_to_a_judged_depth_map(pipeline):
    folder = pipeline.folder
    dataset = open_dataset(folder / "data")
    assert pipeline.gen.stdout == f"7 scenes in {folder / 'data'}: 4 train, 2 validation, 1 test\n"
    assert pipeline.render.stdout.startswith("1 scene rendered, 6 were there")
    assert pipeline.train.stdout.startswith("2 epochs, ended by max_epochs; best epoch ")
    assert "no object" in pipeline.eval.stdout
    for scene_id in dataset.ids():
        truth = read_image(dataset.render_folder(scene_id) / "mirrored.exr")
        assert truth.channel("mask.M").shape == (18, 24)
        assert truth.channel("mask.M").sum() > 3
        with TransientReader(dataset.render_folder(scene_id) / "transient.exr") as reader:
            assert reader.attributes["scene_id"] == scene_id
            assert reader.attributes["method"] == "many-light"
    metrics = json.loads((folder / "report" / "metrics.json").read_text())
    assert metrics["scene_count"] == 1
    (scene,) = dataset.ids("test")
    share = read_image(dataset.render_folder(scene) / "mirrored.exr").channel("mask.M").mean()
    # The empty image has the background's pixels, and none of the object.
    assert metrics["no_object"]["miou"]["mean"] == pytest.approx((1 - share) / 2, rel=1e-6)
    with (folder / "report" / "metrics.csv").open() as stream:
        assert [row["scene"] for row in csv.DictReader(stream)] == dataset.ids("test")
    truth_file = folder / "report" / "pointclouds" / f"{dataset.ids('test')[0]}_gt.ply"
    cloud = trimesh.load(truth_file)
    depth = read_image(dataset.render_folder(dataset.ids("test")[0]) / "mirrored.exr").channel("depth.R")
    distances = np.sort(np.linalg.norm(cloud.vertices, axis=1))
    np.testing.assert_allclose(distances, np.sort(depth[depth > 0]), rtol=1e-5)
    figures = {file.stem for file in (folder / "report" / "figures").iterdir()}
    figures.discard("depth_error")  # which is there if the prediction shows an object
    assert figures == FIGURES | UNCERTAINTY


def test_a_log_of_a_long_job_holds_lines_of_progress(pipeline):
    # Its workers load Mitsuba before the first scene, which takes more than the second between two lines.
    lines = re.findall(r"^render: .*$", pipeline.render.stderr, re.MULTILINE)
    assert re.fullmatch(
        r"render: 1 of 1 scenes, [\d.]+ (scenes/s|s/scene), \d+ s in all \(failed=0\)", lines[-1]
    )
    assert "\r" not in pipeline.render.stderr


@pytest.mark.long
def test_a_second_render_keeps_what_is_there_and_mends_what_is_not(pipeline_copy, render_here):
    (pipeline_copy / "data" / "renders" / "000003" / "itof.exr").unlink()
    done = render_here(pipeline_copy / "data", "--device", "cpu")
    assert done.returncode == 0
    assert done.stdout.startswith("1 scene rendered, 6 were there")


@pytest.mark.long
def test_only_renders_only_that_scene(pipeline_copy, render_here):
    data = pipeline_copy / "data"
    shutil.rmtree(data / "renders")
    only = ["--only", "000002", "--only", "000002", "--method", "path", "--spp", "4", "--resolution", "12x9"]
    done = render_here(data, *only)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 scene rendered")
    assert [folder.name for folder in (data / "renders").glob("0*")] == ["000002"]


@pytest.mark.long
def test_a_finished_training_resumes_to_more_epochs_on_the_device_of_the_run(pipeline_copy):
    run = pipeline_copy / "run"
    more = ["--out", run, *TRAINING, "--resume", "--max-epochs", 3, "--json"]
    done = night_here("night-train", pipeline_copy / "data", *more)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result) == {"run", "epochs", "best_epoch", "best_validation_loss", "ended_by"}
    assert (result["run"], result["epochs"], result["ended_by"]) == (str(run), 3, "max_epochs")
    assert "3 epochs, ended by max_epochs" in done.stderr
    assert json.loads((run / "run.json").read_text())["settings"]["run"]["device"] == "cpu"  # not auto


def test_the_device_of_a_training_preset_is_used_unless_another_is_given(pipeline, tmp_path):
    preset = tmp_path / "small.toml"
    preset.write_text(
        "[input.channels]\nbounce_images = false\n[network]\nwidth = 2\n"
        '[run]\nmax_epochs = 1\ndevice = "cpu"\nprogress = false\n'
    )
    for given, device in ((), "cpu"), (("--device", "auto"), "auto"):
        out = tmp_path / device
        done = night_here("night-train", pipeline.folder / "data", "--out", out, "--preset", preset, *given)
        assert done.returncode == 0, done.stderr
        assert json.loads((out / "run.json").read_text())["settings"]["run"]["device"] == device


def test_a_dry_run_prints_the_plan_and_changes_nothing(pipeline_copy):
    data = pipeline_copy / "data"
    shutil.rmtree(data / "renders" / "000003")
    before = tree(data)
    done = night_here("night-render", data, "--dry-run", "--device", "cpu")
    assert done.returncode == 0, done.stderr
    assert (done.stdout + done.stderr).count("plan: ") == 1
    assert done.stdout.startswith("plan: 1 scene at 24x18, many-light, product both\ndisk: ")
    assert tree(data) == before
    other = night_here("night-render", data, "--dry-run", "--again", "changed", "--resolution", "12x9")
    assert other.returncode == 0, other.stderr
    assert tree(data) == before
    for unrendered in (False, True):  # also where no folder of renders is there
        if unrendered:
            shutil.rmtree(data / "renders")
        done = night_here(
            "night-render", data, "--dry-run", "--again", "changed", "--product", "itof", "--lights", 9
        )
        assert done.stdout.startswith("plan: 7 scenes at 24x18, many-light, product itof")
        assert (data / "renders").exists() is not unrendered


def test_a_dry_run_of_a_rendered_dataset_has_nothing_to_do(pipeline):
    done = night_here("night-render", pipeline.folder / "data", "--dry-run", "--device", "cpu")
    assert done.stdout == "nothing to render: 7 rendered before, 0 failed earlier\n"


def test_a_dataset_called_like_a_command_is_given_by_a_path(pipeline_copy):
    (pipeline_copy / "data").rename(pipeline_copy / "verify")
    done = night_here("night-render", "./verify", "--dry-run", cwd=pipeline_copy)
    assert done.stdout.startswith("nothing to render: 7 rendered")
    done = night_here("night-render", "verify", "verify", "--only", "000001", cwd=pipeline_copy)
    assert done.stdout == "1 scene checked: 1 good, 0 bad; 0 not rendered\n"


def test_a_movie_is_named_after_its_scene_unless_told_otherwise(pipeline, tmp_path):
    done = night_here("night-render", "movie", pipeline.folder / "data", "000002", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["000002.mp4"]


def test_dropped_transients_are_gone_and_the_rest_stays(pipeline_copy):
    renders = pipeline_copy / "data" / "renders"
    found = size(sum(file.stat().st_size for file in renders.glob("000001/*transient.exr")))
    done = night_here("night-render", "drop-transients", pipeline_copy / "data", "--only", "000001", "--yes")
    assert done.stdout == f"{found} freed: the transients of 1 scene are deleted\n"
    names = {file.name for file in (renders / "000001").iterdir()}
    assert names == {"itof.exr", "mirrored.exr", "render.json"}
    assert (renders / "000002" / "transient.exr").exists()


def test_what_the_commands_made_may_be_replaced(pipeline_copy):
    data = pipeline_copy / "data"
    assert {file.name for file in data.iterdir()} > {"renders", "shards"}
    said = refusal("night-gen", "scenes", data, "--preset", "paper", "--replace")
    assert said.startswith(f"this would delete 7 scenes and 7 renders in {data}, ")


def test_a_pipe_that_is_closed_ends_a_command_silently(pipeline):
    reader, writer = os.pipe()
    os.close(reader)
    command = words("night-render", "status", pipeline.folder / "data")
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_machine_that_cannot_load_blender_says_what_it_lacks(tmp_path):
    lacking = "libSM.so.6: cannot open shared object file"
    (tmp_path / "bpy.py").write_text(f"raise ImportError('{lacking}')")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import cli; cli.night_gen()"
    done = subprocess.run(
        [sys.executable, "-c", code, "scenes", tmp_path / "out", "--preset", "demo"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert f"Error: Blender cannot be loaded ({lacking}): install the system libraries" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_a_missing_llvm_is_refused_before_anything_is_rendered(pipeline_copy):
    shutil.rmtree(pipeline_copy / "data" / "renders")
    llvm = {"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"}
    for extra in ([], ["--dry-run"]):
        done = night("night-render", pipeline_copy / "data", "--device", "cpu", *extra, **llvm)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
        assert "/nowhere/libLLVM.so" in done.stderr
        assert "libllvm19" in done.stderr
        assert not (pipeline_copy / "data" / "renders").exists()


@pytest.mark.long
def test_an_old_llvm_is_refused_before_it_can_abort(pipeline):
    old = sorted(Path("/usr/lib").glob("*/libLLVM-1[0-8].so*"))
    if not old:
        pytest.skip("no LLVM older than 19 is installed here (Debian: libllvm15)")
    done = night("night-render", pipeline.folder / "data", "--device", "cpu", DRJIT_LIBLLVM_PATH=str(old[-1]))
    assert done.returncode == 2
    assert "too old" in done.stderr


def limited(blocks, *command):
    """Run a command that may write no file above so many KiB: like a quota, where the disk has room."""
    script = f"ulimit -f {blocks}; exec {' '.join(words(*command))}"
    return subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)


@pytest.mark.long
def test_a_file_size_limit_leaves_no_half_file(pipeline_copy):  # a full disk: test_render_interrupted.py
    data = pipeline_copy / "data"
    shutil.rmtree(data / "renders")
    only = ("--only", "000000", "--lights", 64, "--again", "changed", "--device", "cpu")
    done = limited(8, "night-render", data, *only)
    assert done.returncode == 1
    assert "failed: scene 000000" in done.stderr
    assert "000000/transient.exr: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    written = {file.name for file in (data / "renders" / "000000").iterdir()}
    assert written == {"failure.json", "failure.log"}


def test_a_capture_that_cannot_be_written_leaves_no_half_file(pipeline, tmp_path):
    only = ("--only", "000001", "--to", "tal", "--out", tmp_path)
    done = limited(8, "night-render", "convert", pipeline.folder / "data", *only)
    assert done.returncode == 2, done.stderr
    assert done.stderr == f"Error: cannot write {tmp_path / '000001.hdf5'}: File too large\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_pictures_that_blender_cannot_write_are_missed(pipeline_copy, maker):
    with file_size_limit(8000):  # a picture of a scene takes 50 kB
        done = night_here("night-gen", "preview", pipeline_copy / "data", "--count", 1)
    assert done.returncode == 2, done.stderr
    assert "Error: Blender could not write" in done.stderr


def test_a_check_whose_worker_is_killed_says_so(pipeline):
    command = words("night-render", "verify", pipeline.folder / "data", "--workers", 2)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None and not (workers := workers_of(process)):
            time.sleep(0.01)
        workers[0].kill()
        output, errors = process.communicate()
    assert (process.returncode, output) == (2, "")
    assert errors == (
        "Error: a worker process was killed, perhaps because memory ran out: try fewer --workers\n"
    )


@pytest.mark.long
def test_the_processes_of_a_training_that_ends_in_one_of_them_end_too(pipeline, tmp_path):
    (program,) = words("night-train")
    exploding = ("--batch-size", 2, "--learning-rate", 1e37, "--set", "run.checkpoint_minutes=0")
    options = ("--out", tmp_path / "run", "--width", 2, "--max-epochs", 3, "--device", "cpu", *exploding)
    done = night("torchrun", "--nproc-per-node", 2, program, pipeline.folder / "data", *options)
    said = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert len(said) == 2, done.stderr
    # Both lose their weights at once; the slower one may first hear of the other's end.
    other = "Error: another process of this training has ended: see what it printed"
    lost = [line for line in said if line.startswith("Error: the loss became nan in epoch 1, on scenes ")]
    assert lost, done.stderr
    assert len(lost) + said.count(other) == 2, done.stderr
    assert "defect of NIGHT" not in done.stderr
