"""Bad input to every command: one sentence on stderr and exit code 2, never a traceback."""

import re
import shlex

import numpy as np
import pytest
from night_commands import PRESET, TRAINING, night_here, refusal

from itof import TransientReader, TransientWriter, read_image, write_image

BIG = "9" * 30
# Command lines, and what the sentence says. {data}, {run} and {scene} (of the rendered) are good; {file} is a
# file that is nothing of ours, {folder} a folder with such a file; {out} does not exist.
TABLE = [
    # night-gen
    ("night-gen scenes {out} --preset nowhere", "no preset nowhere: give a .toml file or one of demo, paper"),
    ("night-gen scenes {out} --preset {folder}", "no preset {folder}"),
    ("night-gen scenes {out} --preset {file}", "{file} cannot be read as TOML"),
    (f"night-gen scenes {{out}} --preset {'x' * 5000}", "File name too long"),
    ("night-gen scenes {out} --count 0", "dataset.count: Input should be greater than or equal to 1 (got 0)"),
    (
        f"night-gen scenes {{out}} --count {BIG}",
        "dataset.count: Input should be less than or equal to 1000000",
    ),
    ("night-gen scenes {out} --count many", "'many' is not a valid integer"),
    ("night-gen scenes {out} --seed -1", "dataset.seed: Input should be greater than or equal to 0 (got -1)"),
    (f"night-gen scenes {{out}} --seed {2**63}", "dataset.seed: Input should be less than"),
    ("night-gen scenes {out} --workers 0", "0 is not in the range x>=1"),
    ("night-gen scenes {file} --preset demo", "{file}"),
    ("night-gen scenes {folder} --preset demo", "{folder}"),
    ("night-gen scenes {data} --preset demo", "a dataset of another preset or seed"),
    ("night-gen preview {folder}", "{folder} is not a NIGHT dataset"),
    ("night-gen preview {data} --only 000099", "no scene 000099: its ids run from 000000 to 000006"),
    ("night-gen preview {data} --licence ''", "--licence needs the name of a licence"),
    ("night-gen preview {data} --count 0", "0 is not in the range 1<=x<=100"),
    # night-render
    ("night-render {folder}", "{folder} is not a NIGHT dataset"),
    ("night-render {out}", "there is no folder {out}"),
    ("night-render {data} more", "Got unexpected extra argument (more)"),
    ("night-render {data} --method magic", "unknown rendering method magic: choose many-light or path"),
    ("night-render {data} --spp 4", "--spp is an option of method path, and the method is many-light"),
    ("night-render {data} --product film", "'film' is not one of 'itof', 'transient', 'both'"),
    ("night-render {data} --error -1", "must be a finite number above 0, got -1.0"),
    ("night-render {data} --error nan", "must be a finite number above 0, got nan"),
    ("night-render {data} --error inf", "must be a finite number above 0, got inf"),
    ("night-render {data} --lights 0", "0 is not in the range x>=1"),
    ("night-render {data} --spp 0", "0 is not in the range x>=1"),
    ("night-render {data} --max-bounces 0", "0 is not in the range x>=1"),
    ("night-render {data} --workers 0", "0 is not in the range x>=1"),
    ("night-render {data} --device tpu", "'tpu' is not one of 'auto', 'cpu', 'cuda'"),
    ("night-render {data} --resolution 0x0", "0x0 does not have the aspect ratio of the camera"),
    ("night-render {data} --resolution 12x12", "12x12 does not have the aspect ratio of the camera"),
    ("night-render {data} --resolution 12", "'12' is no image size; write it like 160x120"),
    ("night-render {data} --resolution -4x3", "'-4x3' is no image size"),
    (f"night-render {{data}} --resolution {BIG}x3", "is no image size"),
    ("night-render {data} --resolution 240000x180000", "too large: at most 67108864 pixels"),
    ("night-render {data} --resolution 12x9", "rendered with other settings"),
    ("night-render {data} --resolution 12x9 --dry-run", "rendered with other settings"),
    ("night-render {data} --only 000099", "no scene 000099: its ids run from 000000 to 000006"),
    ("night-render {data} --only ../../x", "no scene ../../x"),
    ("night-render {data} --dry-run --cluster {out}", "{out} cannot be read: No such file or directory"),
    ("night-render {data} --dry-run --cluster {file} --scheduler x", "either --scheduler or --cluster"),
    ("night-render {data} --status", "No such option '--status'"),  # a command since it has options
    ("night-render status {folder}", "{folder} is not a NIGHT dataset"),
    ("night-render status", "Missing argument 'DATASET'"),
    ("night-render status {data} --error nan", "must be a finite number above 0, got nan"),
    ("night-render status {data} --only 000099", "no scene 000099"),
    ("night-render verify {folder}", "{folder} is not a NIGHT dataset"),
    ("night-render verify {data} --only 000099", "no scene 000099"),
    ("night-render verify {data} --workers 0", "0 is not in the range x>=1"),
    ("night-render movie {data}", "Missing argument 'ID'"),
    ("night-render movie {data} 000099", "no scene 000099"),
    ("night-render movie {data} 000001 --out {out}.avi", "cannot write {out}.avi"),
    ("night-render movie {data} 000001 --out {file}/x.mp4", "cannot write {file}/x.mp4"),
    ("night-render convert {data} --to itof", "Missing option '--out'"),
    ("night-render convert {data} --out {out}", "Missing option '--to'"),
    ("night-render convert {data} --to stl --out {out}", "'stl' is not one of 'itof', 'tal'"),
    ("night-render convert {data} --to itof --out {file}", "cannot write {file}/000000_itof.exr"),
    ("night-render convert {data} --to tal --out {file}", "cannot write {file}/000000.hdf5"),
    ("night-render convert {data} --to itof --out {out} --only 000099", "no scene 000099"),
    ("night-render convert {data} --to tal --out {out} --frequencies 20", "goes with --to itof"),
    (
        "night-render convert {data} --to itof --out {out} --frequencies 7,x",
        "'7,x' is no list of frequencies",
    ),
    ("night-render convert {data} --to itof --out {out} --frequencies ''", "'' is no list of frequencies"),
    ("night-render convert {data} --to itof --out {out} --frequencies 20,,60", "is no list of frequencies"),
    ("night-render convert {data} --to itof --out {out} --frequencies 0", "a number of MHz above 0"),
    ("night-render convert {data} --to itof --out {out} --frequencies -5", "a number of MHz above 0"),
    ("night-render convert {data} --to itof --out {out} --frequencies nan", "a number of MHz above 0"),
    ("night-render convert {data} --to itof --out {out} --frequencies inf", "a number of MHz above 0"),
    ("night-render convert {data} --to itof --out {out} --frequencies 1e400", "a number of MHz above 0"),
    ("night-render convert {data} --to itof --out {out} --frequencies 1e99999999999999999999", "no list of"),
    ("night-render convert {data} --to itof --out {out} --frequencies 15000", "cannot resolve 15000 MHz"),
    ("night-render convert {data} --to itof --out {out} --frequencies 1e300", "cannot resolve 1e+300 MHz"),
    ("night-render drop-transients {folder}", "{folder} is not a NIGHT dataset"),
    ("night-render drop-transients {data} --only 000099", "no scene 000099"),
    # night-train
    ("night-train {data}", "Missing option '--out'"),
    ("night-train {folder} --out {out}", "{folder} is not a NIGHT dataset"),
    ("night-train {data} --out {run}", "{run} exists already: resume it (--resume)"),
    ("night-train {data} --out {file}", "{file} is a file"),
    ("night-train {data} --out {folder}", "{folder} is not empty and holds no run"),
    ("night-train {data} --out {file}/run", "{file}"),
    ("night-train {data} --out {out} --resume", "there is no folder {out}"),
    ("night-train {data} --out {run} --resume --width 5", "width was 4 and is now 5"),
    ("night-train {data} --out {out} --preset nowhere", "no preset nowhere: give a .toml file or one of"),
    ("night-train {data} --out {out} --preset {file}", "{file} cannot be read as TOML"),
    ("night-train {data} --out {out} --channels colour", "'colour' is not one of 'paper', 'residual'"),
    ("night-train {data} --out {out} --loss huber", "'huber' is not one of 'mae', 'mse'"),
    ("night-train {data} --out {out} --precision int8", "'int8' is not one of 'auto', 'float32'"),
    ("night-train {data} --out {out} --width 0", "0 is not in the range 1<=x<=1000000"),
    (f"night-train {{data}} --out {{out}} --width {BIG}", "is not in the range 1<=x<=1000000"),
    ("night-train {data} --out {out} --width 1000000", "out of memory with batch size 16 and width 1000000"),
    ("night-train {data} --out {out} --batch-size 0", "0 is not in the range x>=1"),
    ("night-train {data} --out {out} --ema-decay 1", "1.0 is not in the range 0<=x<1"),
    ("night-train {data} --out {out} --learning-rate 0", "0.0 is not in the range x>0"),
    ("night-train {data} --out {out} --learning-rate inf", "learning_rate: Input should be a finite number"),
    ("night-train {data} --out {out} --alpha nan", "alpha: Input should be a finite number"),
    (
        "night-train {data} --out {out} --mask-threshold nan",
        "mask_threshold: Input should be a finite number",
    ),
    ("night-train {data} --out {out} --rotation-deg 181", "181.0 is not in the range 0<=x<=180"),
    (f"night-train {{data}} --out {{out}} --seed {2**63}", "is not in the range"),
    ("night-train {data} --out {out} --frequencies x", "'x' is no list of frequencies"),
    ("night-train {data} --out {out} --frequencies 21", "{data}: 21 MHz is not among 20, 50, 60 MHz"),
    # night-eval
    ("night-eval {run} {data}", "Missing option '--out'"),
    ("night-eval {folder} {data} --out {out}", "training run (it has no run.json)"),
    ("night-eval {run} {folder} --out {out}", "{folder} is not a NIGHT dataset"),
    ("night-eval {run} {data} --out {file}", "{file} is a file"),
    ("night-eval {run} {data} --out {folder}", "{folder} is not empty"),
    ("night-eval {run} {data} --out {out} --split all", "'all' is not one of 'train', 'validation', 'test'"),
    ("night-eval {run} {data} --out {out} --mask-threshold nan", "a mask threshold"),
    ("night-eval {run} {data} --out {out} --mask-threshold inf", "a mask threshold"),
    ("night-eval {run} {data} --out {out} --mask-threshold 0", "0.0 is not in the range x>0"),
    ("night-eval predict {run} {out} --out {out}", "{out} does not exist"),
    ("night-eval predict {run} {folder} --out {out}", "{folder} is a folder"),
    ("night-eval predict {run} {file} --out {out}", "{file} has the ending .txt"),
    ("night-eval predict {folder} {scene}/itof.exr --out {out}", "training run (it has no run.json)"),
    ("night-eval predict {run} {scene}/transient.exr --out {out}", "transient.exr holds no phasors"),
    ("night-eval predict {run} {scene}/mirrored.exr --out {out}", "the network also needs 50, 60 MHz"),
    ("night-eval predict {run} {scene}/itof.exr --out {file}", "{file} is a file"),
    ("night-eval predict {run} {scene}/itof.exr --out {folder}", "{folder} is not empty"),
    ("night-eval export {run} --out {out}", "give a file that ends in .onnx"),
    ("night-eval export {folder} --out {out}.onnx", "training run (it has no run.json)"),
]


@pytest.fixture(scope="session")
def places(pipeline, tmp_path_factory):
    """What the names of TABLE mean; {out} comes with each test."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "diary.txt").write_text("dear diary")
    data = pipeline.folder / "data"
    return {
        "data": data,
        "run": pipeline.folder / "run",
        "scene": data / "renders" / "000001",
        "file": folder / "diary.txt",
        "folder": folder,
    }


@pytest.mark.parametrize(("line", "sentence"), TABLE, ids=[line[:70] for line, _ in TABLE])
def test_bad_input_is_refused_in_one_sentence_and_writes_nothing(places, tmp_path, line, sentence):
    named = {**places, "out": tmp_path / "out"}
    assert sentence.format(**named) in refusal(*shlex.split(line.format(**named)))
    assert (
        not list(tmp_path.glob("out*")) or "--out" in line
    )  # a run folder may hold what is needed to resume


@pytest.mark.parametrize(
    "line",
    ["night-render {data}", "night-train {data} --out {out}", "night-eval {run} {data} --out {out}"],
)
def test_cuda_where_there_is_none_is_refused(places, tmp_path, line):
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has a CUDA GPU, so asking for one is no error")
    command = shlex.split(line.format(**places, out=tmp_path / "out"))
    assert "cuda" in refusal(*command, "--device", "cuda").lower()


def test_a_name_that_is_not_utf_8_is_refused():
    folder = b"data\xff".decode(errors="surrogateescape")  # as Python gives it to a command
    assert "is not UTF-8" in refusal("night-render", folder)


def test_an_unknown_preset_key_is_named(tmp_path):
    (tmp_path / "my.toml").write_text("[camera]\nwidht = 320\n")
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert "unknown key camera.widht" in message
    assert not (tmp_path / "out").exists()


def test_a_preset_that_leaves_no_room_is_refused(tmp_path):
    (tmp_path / "my.toml").write_text("[hidden_object]\nlocation_m = { x = [0.1, 0.1] }\n")
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert "none of 1000 draws fits the room" in message


def test_a_dataset_of_another_schema_is_refused(pipeline_copy):
    file = pipeline_copy / "data" / "dataset.json"
    changed, count = re.subn('"schema_version": [0-9]+', '"schema_version": 99', file.read_text())
    assert count == 1
    file.write_text(changed)
    assert "schema version 99" in refusal("night-render", pipeline_copy / "data")
    file.write_text("{")
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
