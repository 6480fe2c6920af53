"""Datasets, renders and runs that were changed or damaged: every command says so in one sentence."""

import re

import numpy as np
import pytest
from night_commands import PRESET, TRAINING, night_here, refusal

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


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (None, "the projector turned round", "light nothing"),
        ('type="roughplastic"', 'type="conductor"', "--method path"),
        # The mirrored object stands behind the relay wall, where no light goes.
        ('"hidden_object_0.ply"', '"mirrored_hidden_object_0.ply"', "no hidden object can be seen"),
    ],
)
def test_a_scene_that_many_light_cannot_render_says_why(pipeline_copy, render_here, before, after, words):
    file = pipeline_copy / "data" / "scenes" / "000001" / "scene.xml"
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
    only = ("--replace", "--only", "000001", "--lights", "64", "--device", "cpu")
    done = render_here(pipeline_copy / "data", *only)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "scene 000001" in done.stderr
    assert words in done.stderr


def test_a_missing_render_says_which_and_what_to_do(pipeline_copy):
    (pipeline_copy / "data" / "renders" / "000002" / "itof.exr").unlink()
    message = refusal("night-train", pipeline_copy / "data", "--out", pipeline_copy / "new")
    assert "000002" in message
    assert "night-render" in message


def with_nan(file):
    image = read_image(file)
    channels = {name: values.copy() for name, values in image.channels.items()}
    channels["itof.50MHz.Im"][3, 4] = np.nan
    write_image(file, channels, image.attributes)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda file: file.write_bytes(file.read_bytes()[:-300]), "EXR file ("),
        (lambda file: write_image(file, {"R": np.ones((18, 24))}, {}), "000001"),
        # A channel name that is not UTF-8, on which the OpenEXR library crashes.
        (
            lambda file: file.write_bytes(file.read_bytes().replace(b"itof.20", b"itof\xff20")),
            "EXR file (",
        ),
        (with_nan, "scene 000001"),
    ],
    ids=["truncated", "foreign", "no text", "NaN"],
)
def test_a_damaged_render_is_refused(pipeline_copy, damage, words):
    damage(pipeline_copy / "data" / "renders" / "000001" / "itof.exr")
    assert words in refusal("night-train", pipeline_copy / "data", "--out", pipeline_copy / "new")


def test_a_transient_of_a_damaged_time_axis_is_refused(pipeline_copy, tmp_path):
    file = pipeline_copy / "data" / "renders" / "000001" / "transient.exr"
    with TransientReader(file) as reader:
        layout = reader.layout
    with TransientWriter(file, layout, {}) as writer:
        writer.write_rows(np.ones((layout.height, layout.width, layout.bin_count)))
    content = file.read_bytes()
    for bins, words in ((b"1399", "no whole pixels of 1399 bins"), (b"many", "impossible time axis")):
        file.write_bytes(content.replace(b"1400", bins))
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


def test_another_resolution_between_stages_is_refused(pipeline_copy, render_here):
    data, half = (
        pipeline_copy / "data",
        ["--lights", 64, "--device", "cpu", "--resolution", "12x9", "--replace"],
    )
    assert render_here(data, *half, "--only", "000001").returncode == 0
    message = refusal("night-train", data, "--out", pipeline_copy / "new")
    assert "12x9" in message
    assert "24x18" in message
    assert render_here(data, *half).returncode == 0
    message = refusal("night-eval", pipeline_copy / "run", data, "--out", pipeline_copy / "report")
    assert "wrong resolution" in message


def test_a_dataset_without_a_test_split_is_refused(tmp_path, pipeline):
    (tmp_path / "my.toml").write_text(PRESET.replace("count = 7", "count = 7\ntest_fraction = 0.0"))
    made = night_here("night-gen", "scenes", tmp_path / "d", "--preset", tmp_path / "my.toml")
    assert made.returncode == 0, made.stderr
    message = refusal("night-eval", pipeline.folder / "run", tmp_path / "d", "--out", tmp_path / "report")
    assert "no test split" in message


def test_damaged_weights_are_refused(pipeline_copy):
    from safetensors.numpy import load_file, save_file

    weights = pipeline_copy / "run" / "best.safetensors"
    content, judged = weights.read_bytes(), (pipeline_copy / "run", pipeline_copy / "data")
    report = ("--out", pipeline_copy / "report")
    weights.write_bytes(content[:1000])
    assert "damaged" in refusal("night-eval", *judged, *report)
    weights.write_bytes(content)
    save_file({name: np.full_like(values, np.nan) for name, values in load_file(weights).items()}, weights)
    exr = pipeline_copy / "data" / "renders" / "000001" / "itof.exr"
    for command in (judged, ("predict", pipeline_copy / "run", exr)):
        assert "answers with NaN or infinite values" in refusal("night-eval", *command, *report)
    assert not (pipeline_copy / "report").exists()


def test_a_checkpoint_of_another_architecture_is_refused(pipeline_copy):
    config = pipeline_copy / "run" / "run.json"
    config.write_text(config.read_text().replace('"width": 4', '"width": 8'))
    judged = (pipeline_copy / "run", pipeline_copy / "data", "--out", pipeline_copy / "report")
    assert "another architecture" in refusal("night-eval", *judged)


def test_a_network_that_does_not_fit_into_memory_is_refused(pipeline_copy):
    config = pipeline_copy / "run" / "run.json"
    config.write_text(config.read_text().replace('"width": 4', '"width": 1000000'))
    judged = (pipeline_copy / "run", pipeline_copy / "data", "--out", pipeline_copy / "report")
    assert refusal("night-eval", *judged).startswith("out of memory: use a smaller")


def test_a_loss_that_explodes_ends_a_training_in_one_sentence(pipeline, tmp_path):
    out = ("--out", tmp_path / "run", *TRAINING, "--device", "cpu", "--noise-sigma", "1e300")
    assert "the loss became nan" in refusal("night-train", pipeline.folder / "data", *out)
