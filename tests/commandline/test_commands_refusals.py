"""Bad input to every command: one sentence on stderr and exit code 2, never a traceback."""

import re
import shlex

import pytest
from night_commands import refusal

BIG = "9" * 30
# Command lines, and what the sentence says. {data}, {run} and {scene} (of the rendered) are good; {file} is a
# file that is nothing of ours, {folder} a folder with such a file; {out} does not exist.
TABLE = [
    # night-gen
    (
        "night-gen scenes {out} --preset nowhere",
        "no preset nowhere: give a .toml file or one of any-corner, demo, generalist, judge, ",
    ),
    ("night-gen scenes {out} --preset {folder}", "no preset {folder}"),
    ("night-gen scenes {out} --preset ''", "no preset : give a .toml file"),
    ("night-gen scenes ''", "the name is empty; write . for the current folder"),
    ("night-gen scenes {out} --preset {file}", "{file} cannot be read as TOML"),
    (f"night-gen scenes {{out}} --preset {'x' * 5000}", "File name too long"),
    ("night-gen scenes {out} --count 0", "dataset.count must be greater than or equal to 1 (got 0)"),
    (f"night-gen scenes {{out}} --count {BIG}", "dataset.count must be less than or equal to 1000000"),
    ("night-gen scenes {out} --count many", "'many' is not a valid integer"),
    ("night-gen scenes {out} --seed -1", "dataset.seed must be greater than or equal to 0 (got -1)"),
    (f"night-gen scenes {{out}} --seed {2**63}", "dataset.seed must be less than"),
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
    ("night-render {file}", "{file} is a file: give the folder of a dataset"),
    ("night-eval {file} {data} --out {out}", "{file} is a file: give the folder of a run"),
    (
        "night-gen scenes {file}/scenes --preset demo --count 1",
        "Not a directory: a part of this path is a file",
    ),
    ("night-render {out}", "there is no folder {out}"),
    ("night-render {data} more", "Got unexpected extra argument (more)"),
    ("night-render stauts {data}", "No such command or folder 'stauts'. Did you mean 'status'?"),
    ("night-eval exprt {run} --out {out}.onnx", "No such command or folder 'exprt'. Did you mean 'export'?"),
    ("night-eval capture check {file} --fov nan", "nan is not in the range 1<=x<=170"),
    ("night-eval night-40x30 {data} --out {out} --mask-from depth", "the network predicts the mask itself"),
    ("night-eval night-40x30 {data} --out {out} --mask-threshold 1", "give a --mask-threshold below 1"),
    (
        "night-render {data} --method magic",
        "unknown rendering method magic: choose batched or many-light or path",
    ),
    ("night-render {data} --spp 4", "--spp is an option of method path, and the method is many-light"),
    ("night-render {data} --product film", "'film' is not one of 'itof', 'transient', 'both'"),
    ("night-render {data} --error -1", "must be a finite number above 0, got -1.0"),
    ("night-render {data} --error nan", "must be a finite number above 0, got nan"),
    ("night-render {data} --error inf", "must be a finite number above 0, got inf"),
    ("night-render {data} --lights 0", "0 is not in the range 1<=x<=1000000000"),
    (f"night-render {{data}} --lights {BIG}", "is not in the range 1<=x<=1000000000"),
    ("night-render {data} --spp 0", "0 is not in the range 1<=x<=1000000000"),
    ("night-render {data} --max-bounces 0", "0 is not in the range 1<=x<=64"),
    ("night-render {data} --max-bounces 65", "65 is not in the range 1<=x<=64"),
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
    ("night-render plot {data} 000099", "no scene 000099"),
    ("night-render plot {data} 000001 --out {out}.gif", "a plot is a .png file: cannot write {out}.gif"),
    ("night-render plot {data} 000001 --out {file}/x.png", "cannot write {file}/x.png"),
    ("night-render plot {data} 000001 --pixel 24,0", "its pixels are 0,0 to 23,17"),
    ("night-render plot {data} 000001 --pixel 1;2", "'1;2' is no pixel; write it like 12,7"),
    ("night-render panels {data} 000099", "no scene 000099"),
    ("night-render panels {data} 000099 --out {out}.png", "no scene 000099"),
    (
        "night-render panels {data} 000001 --out {out}.gif",
        "the panels are a .png file: cannot write {out}.gif",
    ),
    ("night-render panels {data} 000001 --out {file}/x.png", "cannot write {file}/x.png"),
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
    (
        "night-render convert {data} --to itof --out {out} --frequencies 15000",
        "cannot carry a hidden signal at 15000 MHz",
    ),
    (
        "night-render convert {data} --to itof --out {out} --frequencies 1e300",
        "cannot carry a hidden signal at 1e+300 MHz",
    ),
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
    ("night-train {data} --out {run} --resume --width 5", "network.width was 4 and is now 5"),
    ("night-train {data} --out {out} --preset nowhere", "no preset nowhere: give a .toml file or one of"),
    ("night-train {data} --out {out} --preset {file}", "{file} cannot be read as TOML"),
    ("night-train {data} --out {out} --channels colour", "'colour' is not one of 'paper', 'residual'"),
    (
        "night-train {data} --out {out} --preset paper --set target.loss=huber",
        "target.loss must be 'mae', 'mse'",
    ),
    ("night-train {data} --out {out} --set run.precision=int8", "run.precision must be 'auto', 'float32'"),
    ("night-train {data} --out {out} --width 0", "0 is not in the range 1<=x<=1000000"),
    (f"night-train {{data}} --out {{out}} --width {BIG}", "is not in the range 1<=x<=1000000"),
    ("night-train {data} --out {out} --width 1000000", "out of memory with batch size 16 and width 1000000"),
    ("night-train {data} --out {out} --batch-size 0", "0 is not in the range 1<=x<=1000000000"),
    ("night-train {data} --out {out} --set optimiser.ema_decay=1", "optimiser.ema_decay must be less than 1"),
    ("night-train {data} --out {out} --learning-rate 0", "0.0 is not in the range 1e-37<=x<="),
    ("night-train {data} --out {out} --learning-rate inf", "inf is not in the range 1e-37<=x<="),
    (
        "night-train {data} --out {out} --preset paper --set target.alpha=nan",
        "target.alpha must be a finite number",
    ),
    (
        "night-train {data} --out {out} --set target.alpha=1",
        "target.alpha goes with target.kind components or depth, and it is mask+depth: leave it out",
    ),
    (
        "night-train {data} --out {out} --preset paper --set target.smooth_l1_beta=1",
        "target.smooth_l1_beta goes with target.kind mask+depth, and it is components: leave it out",
    ),
    (
        "night-train {data} --out {out} --preset paper --reference self",
        "input.channels.reference goes with input.channels.kind residual or paper+residual or residual+wall",
    ),
    ("night-train {data} --out {out} --levels 8 --block 16", "take fewer levels or a smaller block"),
    (
        "night-train {data} --out {out} --set augmentation.paper.rotation_deg=181",
        "augmentation.paper.rotation_deg must be 0 to 180 degrees (got 181)",
    ),
    (f"night-train {{data}} --out {{out}} --seed {2**63}", "is not in the range"),
    ("night-train {data} --out {out} --frequencies x", "'x' is no list of frequencies"),
    ("night-train {data} --out {out} --frequencies 21", "{data}: 21 MHz is not among 20, 50, 60 MHz"),
    # night-eval
    ("night-eval {run} {data}", "Missing option '--out'"),
    ("night-eval {folder} {data} --out {out}", "training run (it has no run.json)"),
    ("night-eval {run} {folder} --out {out}", "{folder} is not a NIGHT dataset"),
    ("night-eval {run} {data} --out {file}", "{file} is a file"),
    ("night-eval {run} {data} --out {folder}", "holds other things than an earlier report: diary.txt; move"),
    ("night-eval {run} {data} --out {out} --split all", "'all' is not one of 'train', 'validation', 'test'"),
    ("night-eval {run} {data} --out {out} --mask-threshold nan", "nan is not in the range x>0"),
    ("night-eval {run} {data} --out {out} --mask-threshold inf", "a mask threshold"),
    ("night-eval {run} {data} --out {out} --mask-threshold 0", "0.0 is not in the range x>0"),
    ("night-eval predict {run} {out} --out {out}", "{out} does not exist"),
    ("night-eval predict {run} {folder} --out {out}", "{folder} is a folder"),
    ("night-eval predict {run} {file} --out {out}", "{file} has the ending .txt"),
    ("night-eval predict {folder} {scene}/itof.exr --out {out}", "training run (it has no run.json)"),
    ("night-eval predict {run} {scene}/transient.exr --out {out}", "transient.exr holds no phasors"),
    ("night-eval predict {run} {scene}/mirrored.exr --out {out}", "the network also needs 50, 60 MHz"),
    ("night-eval predict {run} {scene}/itof.exr --out {file}", "{file} is a file"),
    (
        "night-eval predict {run} {scene}/itof.exr --out {folder}",
        "holds other things than an earlier prediction: diary.txt; move",
    ),
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
    "line", ["night-render {data}", "night-train {data} --out {out}", "night-eval {run} {data} --out {out}"]
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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("count = " + "9" * 5000, "as TOML"),
        ("count = " + "[" * 100_000, "as TOML"),
        ("count = \xe9", ": it is not UTF-8, but perhaps Windows-1252 or Latin-1"),
    ],
)
def test_a_preset_that_no_program_can_read_is_refused(tmp_path, text, words):
    (tmp_path / "my.toml").write_bytes(text.encode("latin-1"))
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert re.search(rf"my.toml cannot be read ?{words}", message)


def test_a_preset_that_leaves_no_room_is_refused(tmp_path):
    size = "cube = [2.5, 2.5, 2.5]"  # reaches through the relay wall
    table = f'shapes = ["cube"]\ncomposite_fraction = 0\nsize_m = {{ {size} }}\n'
    (tmp_path / "my.toml").write_text(f"[hidden_object]\n{table}")
    message = refusal("night-gen", "scenes", tmp_path / "out", "--preset", tmp_path / "my.toml")
    assert "none of 1000 draws fits the room" in message
