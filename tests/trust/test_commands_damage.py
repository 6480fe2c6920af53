"""Datasets, renders and runs that were changed or damaged: every command says so in one sentence."""

import json
import re

import numpy as np
import pytest
import trimesh
from night_commands import TRAINING, refusal
from render_records import record_anew
from training_runs import edit_settings, edit_weights

from itof import TransientReader, TransientWriter, read_image, write_image


def test_a_dataset_of_another_schema_is_refused(pipeline_copy):
    file = pipeline_copy / "data" / "dataset.json"
    changed, count = re.subn('"schema_version": [0-9]+', '"schema_version": 99', file.read_text())
    assert count == 1
    file.write_text(changed)
    assert "schema version 99" in refusal("night-render", pipeline_copy / "data")
    for text in ("{", "[" * 100_000, f'{{"schema_version": {"9" * 5000}}}'):
        file.write_text(text)
        assert "cannot be read as JSON" in refusal("night-render", pipeline_copy / "data")


def turn_projector_round(folder):
    scene = json.loads((folder / "scene.json").read_text())
    scene["emitter"]["rotation_deg"][2] += 180.0
    (folder / "scene.json").write_text(json.dumps(scene))


def put_object_before_camera(folder):
    camera = json.loads((folder / "scene.json").read_text())["camera"]
    angle = np.radians(camera["rotation_deg"][2])
    put_object(folder, np.array(camera["location_m"]) + 0.7 * np.array([-np.sin(angle), np.cos(angle), 0]))


def put_object_behind_relay_wall(folder):  # where no light goes
    scene = json.loads((folder / "scene.json").read_text())
    put_object(folder, np.array(scene["hidden_objects"][0]["location_m"]) * [-1, 1, 1])


def put_object(folder, place_m):
    """Move the object and its mirror image to another place; the relay wall is the plane x = 0."""
    scene = json.loads((folder / "scene.json").read_text())
    (part,) = scene["hidden_objects"]
    by_m = place_m - part["location_m"]
    part["location_m"] = place_m.tolist()
    (folder / "scene.json").write_text(json.dumps(scene))
    for name, moved_m in (("hidden_object_0.ply", by_m), ("mirrored_hidden_object_0.ply", by_m * [-1, 1, 1])):
        trimesh.load(folder / name).apply_translation(moved_m).export(folder / name)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (turn_projector_round, "light nothing"),
        (put_object_before_camera, "--method path"),
        (put_object_behind_relay_wall, "no hidden object can be seen"),
    ],
)
def test_a_scene_that_many_light_cannot_render_says_why(pipeline_copy, render_here, edit, words):
    edit(pipeline_copy / "data" / "scenes" / "000001")
    only = (
        "--again",
        "changed",
        "--accept",
        "edited",
        "--only",
        "000001",
        "--lights",
        "64",
        "--device",
        "cpu",
    )
    done = render_here(pipeline_copy / "data", *only)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "scene 000001" in done.stderr
    assert words in done.stderr


def with_nan(file):
    image = read_image(file)
    channels = {name: values.copy() for name, values in image.channels.items()}
    channels["itof.50MHz.Im"][3, 4] = np.nan
    write_image(file, channels, image.attributes)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda file: file.write_bytes(file.read_bytes()[:-300]), "EXR file ("),
        (lambda file: write_image(file, {"R": np.ones((18, 24))}, {}), "holds no phasors"),
        # A channel name that is not UTF-8, on which the OpenEXR library crashes.
        (lambda file: file.write_bytes(file.read_bytes().replace(b"itof.20", b"itof\xff20")), "EXR file ("),
        (with_nan, "holds 1 values that are NaN"),
    ],
    ids=["truncated", "foreign", "no text", "NaN"],
)
def test_a_damaged_render_is_refused(pipeline_copy, damage, words):
    file = pipeline_copy / "data" / "renders" / "000001" / "itof.exr"
    damage(file)
    train = ("night-train", pipeline_copy / "data", "--out", pipeline_copy / "new")
    message = refusal(*train)
    assert f"scene 000001: {file} is not the file that night-render wrote" in message
    assert "which renders it again" in message
    record_anew(file.parent)  # now the damage itself is what is wrong
    message = refusal(*train)
    assert words in message
    assert str(file) in message
    assert "render" in message.rpartition(": ")[2]  # what to do


def test_a_transient_of_a_damaged_time_axis_is_refused(pipeline_copy, tmp_path):
    file = pipeline_copy / "data" / "renders" / "000001" / "transient.exr"
    with TransientReader(file) as reader:
        layout = reader.layout
    with TransientWriter(file, layout, {}) as writer:
        writer.write_rows(np.ones((layout.height, layout.width, layout.bin_count)))
    content = file.read_bytes()
    for bins, words in ((b"1399", "no whole pixels of 1399 bins"), (b"many", "impossible time axis")):
        file.write_bytes(content.replace(b"1400", bins))
        record_anew(file.parent)
        command = (
            "convert",
            pipeline_copy / "data",
            "--only",
            "000001",
            "--to",
            "itof",
            "--out",
            tmp_path / "c",
        )
        assert words in refusal("night-render", *command)


def test_weights_and_answers_that_are_no_numbers_are_refused(pipeline_copy):
    run, report = pipeline_copy / "run", ("--out", pipeline_copy / "report")
    judged = (run, pipeline_copy / "data")
    exr = pipeline_copy / "data" / "renders" / "000001" / "itof.exr"
    onnx = ("--out", pipeline_copy / "model.onnx")
    edit_weights(run, lambda _, weight: weight * np.nan)
    for command in ((*judged, *report), ("predict", run, exr, *report), ("export", run, *onnx)):
        assert "holds weights that are NaN or infinite" in refusal("night-eval", *command)
    edit_weights(run, lambda _, weight: weight.nan_to_num(1e30))  # finite weights whose answer is not
    for command in ((*judged, *report), ("predict", run, exr, *report)):
        assert "answers with NaN or infinite values" in refusal("night-eval", *command)
    assert not (pipeline_copy / "report").exists()
    assert not (pipeline_copy / "model.onnx").exists()


@pytest.mark.parametrize("width", [700, 1_000_000])
def test_a_network_that_is_much_larger_than_its_weights_takes_no_memory(pipeline_copy, width):
    edit_settings(pipeline_copy / "run", width=width)
    judged = (pipeline_copy / "run", pipeline_copy / "data", "--out", pipeline_copy / "report")
    message = refusal("night-eval", *judged)
    assert "another architecture" in message
    assert "are needed" in message


def test_a_network_that_would_enlarge_every_image_is_refused(pipeline_copy):
    edit_settings(pipeline_copy / "run", levels=8, block=64)
    judged = (pipeline_copy / "run", pipeline_copy / "data", "--out", pipeline_copy / "report")
    assert "take fewer levels" in refusal("night-eval", *judged)


def test_a_loss_that_explodes_ends_a_training_in_one_sentence(pipeline, tmp_path):
    out = ("--out", tmp_path / "run", *TRAINING, "--device", "cpu", "--learning-rate", "1e30")
    assert "loss became nan" in refusal("night-train", pipeline.folder / "data", *out)
