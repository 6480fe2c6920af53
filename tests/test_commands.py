"""The four commands as a user types them: the whole pipeline, and every bad input in one sentence."""

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from night_commands import FIGURES, PRESET, night

import cli
from itof import TransientReader, read_image, write_image
from scenegen import open_dataset

COMMANDS = {
    "night-gen": cli.night_gen,
    "night-render": cli.night_render,
    "night-train": cli.night_train,
    "night-eval": cli.night_eval,
}
TRAINING = ["--width", 4, "--max-epochs", 2, "--batch-size", 4, "--learning-rate", 1e-3]
TRAINING += ["--schedule", "constant"]  # which may go on for longer


def refusal(command, *arguments):
    """The one sentence on stderr of a command that must end with exit code 2."""
    result = CliRunner().invoke(COMMANDS[command], [str(word) for word in arguments])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return result.stderr.removeprefix("Error: ").strip()


@pytest.fixture(scope="session")
def pipeline(tmp_path_factory):
    """A dataset, a run and a report made with the four commands; their outputs by command."""
    folder = tmp_path_factory.mktemp("pipeline")
    (folder / "small.toml").write_text(PRESET)
    data, run, report = folder / "data", folder / "run", folder / "report"
    steps = [
        ("night-gen", "scenes", data, "--preset", folder / "small.toml"),
        ("night-render", data, "--lights", 128, "--device", "cpu"),
        ("night-train", data, "--out", run, *TRAINING, "--device", "cpu"),
        ("night-eval", run, data, "--split", "test", "--out", report, "--device", "cpu"),
    ]
    printed = {}
    for step in steps:
        done = night(*step)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        printed[step[0]] = done.stdout
    return folder, printed


@pytest.fixture
def copy(pipeline, tmp_path):
    """The pipeline's folders, free to be damaged."""
    for name in ("data", "run"):
        shutil.copytree(pipeline[0] / name, tmp_path / name)
    return tmp_path


def test_the_four_commands_go_from_nothing_to_a_judged_depth_map(pipeline):
    folder, printed = pipeline
    dataset = open_dataset(folder / "data")
    assert printed["night-gen"].endswith("4 train, 2 validation, 1 test\n")
    assert "7 scenes rendered" in printed["night-render"]
    assert "no object" in printed["night-eval"]
    for scene_id in dataset.ids():
        truth = read_image(dataset.render_folder(scene_id) / "mirrored.exr")
        assert truth.channel("mask.M").shape == (18, 24)
        assert truth.channel("mask.M").sum() > 3
        with TransientReader(dataset.render_folder(scene_id) / "transient.exr") as reader:
            assert reader.attributes["scene_id"] == scene_id
            assert reader.attributes["method"] == "many-light"
    metrics = json.loads((folder / "report" / "metrics.json").read_text())
    assert metrics["scene_count"] == 1
    assert 0.45 < metrics["no_object"]["miou"]["mean"] < 0.5
    with (folder / "report" / "metrics.csv").open() as stream:
        assert [row["scene"] for row in csv.DictReader(stream)] == dataset.ids("test")
    truth_file = folder / "report" / "pointclouds" / f"{dataset.ids('test')[0]}_gt.ply"
    cloud = trimesh.load(truth_file)
    depth = read_image(dataset.render_folder(dataset.ids("test")[0]) / "mirrored.exr").channel("depth.R")
    distances = np.sort(np.linalg.norm(cloud.vertices, axis=1))
    np.testing.assert_allclose(distances, np.sort(depth[depth > 0]), rtol=1e-5)
    figures = {file.name for file in (folder / "report" / "figures").iterdir()}
    assert figures == FIGURES


def test_a_second_render_keeps_what_is_there_and_mends_what_is_not(copy):
    (copy / "data" / "renders" / "000003" / "itof.exr").unlink()
    done = night("night-render", copy / "data", "--lights", 128, "--device", "cpu")
    assert done.returncode == 0
    assert done.stdout.startswith("1 scenes rendered, 6 were there")


def test_only_renders_only_that_scene(copy):
    shutil.rmtree(copy / "data" / "renders")
    words = ["--only", "000002", "--only", "000002", "--method", "path", "--spp", "4", "--resolution", "12x9"]
    result = CliRunner().invoke(cli.night_render, [str(copy / "data"), *words])
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("1 scenes rendered")
    assert [folder.name for folder in (copy / "data" / "renders").glob("0*")] == ["000002"]


def test_a_finished_training_resumes_to_more_epochs(copy):
    arguments = ["--out", str(copy / "run"), *map(str, TRAINING), "--device", "cpu", "--resume"]
    more = [*arguments, "--max-epochs", "3"]
    result = CliRunner().invoke(cli.night_train, [str(copy / "data"), *more])
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("3 epochs")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command):
    done = night(command, "--help")
    assert done.returncode == 0
    assert "Usage" in done.stdout


def test_no_command_takes_a_foreign_folder(tmp_path, pipeline):
    (tmp_path / "diary.txt").write_text("dear diary")
    assert "no NIGHT dataset" in refusal("night-gen", "scenes", tmp_path, "--preset", "demo")
    assert "no NIGHT dataset" in refusal("night-render", tmp_path)
    assert "no folder" in refusal("night-render", tmp_path / "nowhere")
    assert "no NIGHT dataset" in refusal("night-train", tmp_path, "--out", tmp_path / "run")
    assert "no training run" in refusal(
        "night-eval", tmp_path, pipeline[0] / "data", "--out", tmp_path / "report"
    )


def test_a_dataset_of_another_preset_is_not_overwritten(copy):
    assert "another preset" in refusal("night-gen", "scenes", copy / "data", "--preset", "paper")


def test_an_unknown_preset_key_is_named(tmp_path):
    (tmp_path / "my.toml").write_text("[camera]\nwidht = 320\n")
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert "unknown key camera.widht" in message
    assert not (tmp_path / "out").exists()


def test_a_preset_that_leaves_no_room_is_refused(tmp_path):
    (tmp_path / "my.toml").write_text("[hidden_object]\nlocation_m = { x = [0.1, 0.1] }\n")
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert "none of 1000 draws fits the room" in message


def test_a_dataset_of_another_schema_is_refused(copy):
    file = copy / "data" / "dataset.json"
    file.write_text(file.read_text().replace('"schema_version": 2', '"schema_version": 3'))
    assert "schema version 3" in refusal("night-render", copy / "data")
    file.write_text("{")
    assert "cannot be read as JSON" in refusal("night-render", copy / "data")


def test_a_scene_that_is_not_in_the_dataset_is_refused(copy):
    assert "no scene 000099" in refusal("night-render", copy / "data", "--only", "000099")


@pytest.mark.parametrize(("size", "words"), [("12", "no image size"), ("12x12", "aspect ratio")])
def test_an_impossible_resolution_is_refused(copy, size, words):
    assert words in refusal("night-render", copy / "data", "--resolution", size)


def test_an_unknown_method_is_refused(copy):
    assert "no rendering method magic" in refusal("night-render", copy / "data", "--method", "magic")


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (None, "the projector turned round", "light nothing"),
        ('type="roughplastic"', 'type="conductor"', "--method path"),
        # The mirrored object stands behind the relay wall, where no light goes.
        ('"hidden_object_0.ply"', '"mirrored_hidden_object_0.ply"', "no hidden object can be seen"),
    ],
)
def test_a_scene_that_many_light_cannot_render_says_why(copy, before, after, words):
    file = copy / "data" / "scenes" / "000001" / "scene.xml"
    head, emitter, tail = file.read_text().partition("<emitter")
    if before is None:
        numbers = re.search(r'matrix value="([^"]*)"', tail)[1].split()
        # The first and third column of the pose point right and ahead.
        turned = [str(-float(n)) if i < 12 and i % 4 in (0, 2) else n for i, n in enumerate(numbers)]
        text = head + emitter + tail.replace(" ".join(numbers), " ".join(turned))
    else:
        text = (head + emitter + tail).replace(before, after)
        text = re.sub(r'\s*<(float|spectrum) name="(alpha|diffuse_reflectance)"[^>]*>', "", text)
    file.write_text(text)
    words_given = ("--replace", "--only", "000001", "--lights", "64", "--device", "cpu")
    result = CliRunner().invoke(cli.night_render, [str(copy / "data"), *words_given])
    assert result.exit_code == 1
    assert "Traceback" not in result.stderr
    message = result.stderr
    assert "scene 000001" in message
    assert words in message


def test_impossible_render_options_are_refused(copy):
    assert "above 0" in refusal("night-render", copy / "data", "--error", -1)
    assert "lights" in CliRunner().invoke(cli.night_render, [str(copy / "data"), "--lights", "0"]).stderr
    assert "product" in CliRunner().invoke(cli.night_render, [str(copy / "data"), "--product", "film"]).stderr


def test_a_missing_render_says_which_and_what_to_do(copy):
    (copy / "data" / "renders" / "000002" / "itof.exr").unlink()
    message = refusal("night-train", copy / "data", "--out", copy / "new")
    assert "000002" in message
    assert "night-render" in message


def test_a_truncated_render_is_refused(copy):
    file = copy / "data" / "renders" / "000004" / "mirrored.exr"
    file.write_bytes(file.read_bytes()[:-300])
    assert "damaged or no EXR" in refusal("night-train", copy / "data", "--out", copy / "new")


def test_a_foreign_exr_is_refused(copy):
    write_image(copy / "data" / "renders" / "000001" / "itof.exr", {"R": np.ones((18, 24))}, {})
    message = refusal("night-train", copy / "data", "--out", copy / "new")
    assert "000001" in message


def test_a_nan_in_a_render_is_refused(copy):
    file = copy / "data" / "renders" / "000001" / "itof.exr"
    image = read_image(file)
    channels = {name: values.copy() for name, values in image.channels.items()}
    channels["itof.50MHz.Im"][3, 4] = np.nan
    write_image(file, channels, image.attributes)
    message = refusal("night-train", copy / "data", "--out", copy / "new")
    assert "000001" in message


def test_another_resolution_between_stages_is_refused(copy):
    half = ["--lights", 64, "--device", "cpu", "--resolution", "12x9"]
    assert night("night-render", copy / "data", *half, "--replace", "--only", "000001").returncode == 0
    message = refusal("night-train", copy / "data", "--out", copy / "new")
    assert "12x9" in message
    assert "24x18" in message
    assert night("night-render", copy / "data", *half, "--replace").returncode == 0
    message = refusal("night-eval", copy / "run", copy / "data", "--out", copy / "report")
    assert "wrong resolution" in message


def test_a_dataset_without_a_test_split_is_refused(tmp_path, pipeline):
    (tmp_path / "my.toml").write_text(PRESET.replace("count = 7", "count = 7\ntest_fraction = 0.0"))
    assert night("night-gen", "scenes", tmp_path / "d", "--preset", tmp_path / "my.toml").returncode == 0
    message = refusal("night-eval", pipeline[0] / "run", tmp_path / "d", "--out", tmp_path / "report")
    assert "no test split" in message


def test_a_checkpoint_of_another_architecture_is_refused(copy):
    config = copy / "run" / "run.json"
    config.write_text(config.read_text().replace('"width": 4', '"width": 8'))
    message = refusal("night-eval", copy / "run", copy / "data", "--out", copy / "report")
    assert "another architecture" in message


def test_truncated_weights_are_refused(copy):
    weights = copy / "run" / "best.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])
    assert "damaged" in refusal("night-eval", copy / "run", copy / "data", "--out", copy / "report")


def test_an_existing_run_is_not_overwritten(copy):
    message = refusal("night-train", copy / "data", "--out", copy / "run", *TRAINING)
    assert "--resume" in message


def test_an_unknown_training_preset_is_refused(copy):
    message = refusal("night-train", copy / "data", "--out", copy / "new", "--preset", "nowhere")
    assert "no preset nowhere" in message
    assert "demo" in message


def test_cuda_where_there_is_none_is_refused(copy):
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has a CUDA GPU, so asking for one is no error")
    for command, *arguments in (
        ("night-render", copy / "data"),
        ("night-train", copy / "data", "--out", copy / "new"),
        ("night-eval", copy / "run", copy / "data", "--out", copy / "report"),
    ):
        assert "cuda" in refusal(command, *arguments, "--device", "cuda").lower()


def test_a_missing_llvm_is_refused_before_anything_is_rendered(copy):
    shutil.rmtree(copy / "data" / "renders")
    done = night("night-render", copy / "data", "--device", "cpu", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "/nowhere/libLLVM.so" in done.stderr
    assert "libllvm19" in done.stderr
    assert not (copy / "data" / "renders").exists()


def test_an_old_llvm_is_refused_before_it_can_abort(copy):
    old = sorted(Path("/usr/lib").glob("*/libLLVM-1[0-8].so*"))
    if not old:
        pytest.skip("no LLVM older than 19 is installed here (Debian: libllvm15)")
    done = night("night-render", copy / "data", "--device", "cpu", DRJIT_LIBLLVM_PATH=str(old[-1]))
    assert done.returncode == 2
    assert "too old" in done.stderr


def test_a_file_size_limit_leaves_no_half_file(copy):
    shutil.rmtree(copy / "data" / "renders")
    program = Path(sys.executable).with_name("night-render")
    # Like a quota: writing fails while the disk has room. (A full disk is in test_render_queue.py.)
    command = f"ulimit -f 8; exec {program} {copy / 'data'} --only 000000 --lights 64 --replace --device cpu"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "failed: scene 000000" in done.stderr
    assert "Failed to write pixel data" in done.stderr
    assert "Traceback" not in done.stderr
    written = {file.name for file in (copy / "data" / "renders" / "000000").iterdir()}
    assert written == {"failure.json", "failure.log"}


def test_an_output_folder_that_is_a_file_is_refused(copy):
    (copy / "file").write_text("")
    assert "file" in refusal("night-train", copy / "data", "--out", copy / "file")
    assert "file" in refusal("night-gen", "scenes", copy / "file", "--preset", "demo")
    assert "file" in refusal("night-eval", copy / "run", copy / "data", "--out", copy / "file")
