"""A dataset of somebody else cannot make any command read or write outside of its folder."""

import json
import shutil

import pytest
from night_commands import TRAINING, night_here, refusal
from scene_folders import contents

from disk import NightError
from itof.capture.sidecar_files import load_sidecar
from model.settings.presets import training_preset

DEVICE = ("--device", "cpu")
COMMANDS = {
    "scenes": ("night-gen", "scenes", "{data}"),
    "preview": ("night-gen", "preview", "{data}", "--count", 1),
    "render": ("night-render", "{data}", *DEVICE),
    "dry run": ("night-render", "{data}", "--dry-run", *DEVICE),
    "accept": ("night-render", "{data}", "--accept", "edited", "--dry-run", *DEVICE),
    "status": ("night-render", "status", "{data}"),
    "verify": ("night-render", "verify", "{data}"),
    "movie": ("night-render", "movie", "{data}", "000001", "--out", "{out}/movie.gif"),
    "plot": ("night-render", "plot", "{data}", "000001", "--out", "{out}/plot.png"),
    "panels": ("night-render", "panels", "{data}", "000001", "--out", "{out}/panels.png", *DEVICE),
    "itof": ("night-render", "convert", "{data}", "--to", "itof", "--out", "{out}/itof"),
    "tal": ("night-render", "convert", "{data}", "--to", "tal", "--out", "{out}/tal"),
    "export": ("night-render", "export", "{data}", "--out", "{out}/all.h5"),
    "drop": ("night-render", "drop-transients", "{data}", "--yes"),
    "train": ("night-train", "{data}", "--out", "{out}/run", *TRAINING, *DEVICE),
    "eval": ("night-eval", "{run}", "{data}", "--out", "{out}/report", *DEVICE),
}


@pytest.fixture
def hostile(pipeline_copy, tmp_path):
    """Runs a command on a copy of a rendered dataset; the place outside, with a file, must stay as it is."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "victim").write_text("victim")
    (tmp_path / "out").mkdir()

    def run(name, ends=refusal):
        before = contents(outside)
        places = {"data": tmp_path / "data", "run": tmp_path / "run", "out": tmp_path / "out"}
        words = [str(word).format(**places) for word in COMMANDS[name]]
        ended = ends(*words)
        assert contents(outside) == before
        assert contents(tmp_path / "out") == {}
        return ended

    return run


def replace_by_link(path, target):
    """Move a file or folder to `target` and leave a symbolic link to it."""
    shutil.move(path, target)
    path.symlink_to(target)


@pytest.mark.parametrize(
    "identity", ["x/../../../outside/victim", "/outside/victim", "..", "0", "000001\u0000"]
)
def test_an_id_that_is_no_number_is_refused_by_every_command(hostile, tmp_path, identity):
    file = tmp_path / "data" / "dataset.json"
    index = json.loads(file.read_text())
    index["scenes"][1]["id"] = (
        identity.replace("/outside", str(tmp_path / "outside")) if identity[0] == "/" else identity
    )
    file.write_text(json.dumps(index))
    for name in COMMANDS if identity[0] == "x" else ("render", "drop"):
        assert "scenes.1.id: String should match pattern" in hostile(name)


def test_an_id_that_occurs_twice_is_refused(hostile, tmp_path):
    file = tmp_path / "data" / "dataset.json"
    file.write_text(file.read_text().replace('"id": "000001"', '"id": "000000"'))
    assert "two scenes have the same id" in hostile("status")


@pytest.mark.parametrize("name", ["scenes", "renders", "shards"])
def test_a_linked_folder_of_the_dataset_is_refused_by_every_command(hostile, tmp_path, name):
    (tmp_path / "data" / name).mkdir(exist_ok=True)
    replace_by_link(tmp_path / "data" / name, tmp_path / "outside" / name)
    for command in COMMANDS if name == "renders" else ("scenes", "render", "train"):
        sentence = hostile(command)
        assert f"{tmp_path / 'data' / name} is a symbolic link to a place outside" in sentence


def test_a_linked_scene_is_refused_by_every_command_that_reads_scenes(hostile, tmp_path):
    scene = tmp_path / "data" / "scenes" / "000000"
    replace_by_link(scene, tmp_path / "outside" / "scene")
    shutil.rmtree(tmp_path / "data" / "renders" / "000000")
    for command in ("scenes", "render", "dry run", "preview"):
        assert str(scene) in hostile(command)
    assert hostile("status", night_here).returncode == 0
    shutil.copytree(tmp_path / "data" / "renders" / "000001", tmp_path / "data" / "renders" / "000000")
    for command in ("verify", "tal", "train"):
        assert f"{scene} is a symbolic link to a place outside" in hostile(command)


def test_a_linked_render_is_refused_by_every_command_that_reads_or_writes_renders(hostile, tmp_path):
    render = tmp_path / "data" / "renders" / "000000"
    replace_by_link(render, tmp_path / "outside" / "render")
    for command in ("preview", "render", "status", "verify", "itof", "drop", "train", "eval"):
        assert f"{render} is a symbolic link to a place outside" in hostile(command), command


def test_a_linked_mesh_is_not_read(hostile, tmp_path):
    mesh = tmp_path / "data" / "scenes" / "000000" / "hidden_object_0.ply"
    replace_by_link(mesh, tmp_path / "outside" / "mesh.ply")
    for command in ("scenes", "render", "dry run"):
        assert str(mesh) in hostile(command)
    verified = hostile("verify", night_here)
    assert verified.returncode == 1
    assert f"scene files damaged: 000000: {mesh} is a symbolic link" in verified.stdout
    accepted = hostile("accept", night_here)  # rendering this scene fails, and says why
    assert accepted.returncode in (0, 2)


def test_a_linked_folder_of_pictures_is_refused(hostile, tmp_path):
    (tmp_path / "data" / "preview").symlink_to(tmp_path / "outside")
    assert f"{tmp_path / 'data' / 'preview'} is a symbolic link to a place outside" in hostile("preview")


@pytest.mark.parametrize("name", [".run", ".note", ".claims", "night-render.log"])
def test_a_linked_file_of_a_run_is_not_written(hostile, tmp_path, name):
    link = tmp_path / "data" / "renders" / name
    link.unlink(missing_ok=True) if not link.is_dir() else shutil.rmtree(link)
    (tmp_path / "outside" / "folder").mkdir()
    link.symlink_to(tmp_path / "outside" / ("folder" if name == ".claims" else "victim"))
    shutil.rmtree(tmp_path / "data" / "renders" / "000000")
    assert str(link) in hostile("render")


@pytest.mark.parametrize("name", ["../base.toml", "{folder}/base.toml"])
def test_a_training_preset_extends_one_of_its_folder(tmp_path, name):
    (tmp_path / "base.toml").write_text("[network]\nwidth = 2\n")
    preset = tmp_path / "mine" / "my.toml"
    preset.parent.mkdir()
    preset.write_text(f'extends = "{name.format(folder=tmp_path)}"\n')
    with pytest.raises(NightError, match=f"is not the name of a file inside {preset.parent}"):
        training_preset(preset)


def test_names_in_a_file_are_not_looked_for_in_the_current_folder(tmp_path, monkeypatch):
    here, mine = tmp_path / "here", tmp_path / "mine"
    here.mkdir()
    mine.mkdir()
    (here / "base.toml").write_text("[network]\nwidth = 2\n")
    (here / "camera.toml").write_text("width = 640\nheight = 480\n")
    monkeypatch.chdir(here)
    for key, name in (("extends", "base.toml"), ("augmentation.camera.sensor", "camera.toml")):
        (mine / "my.toml").write_text(f'{key} = "{name}"\n')
        with pytest.raises(NightError, match=f"there is no {name}: those that come with NIGHT are"):
            training_preset(mine / "my.toml")
    (here / "format").write_text('layout = "taps"\n')
    (mine / "sidecar.toml").write_text('format = "format"\n')
    with pytest.raises(NightError, match=r"sidecar\.toml, key format: there is no format: those that come"):
        load_sidecar(mine / "sidecar.toml")


@pytest.mark.parametrize("path", ["../bunny.ply", "meshes/../../bunny.ply", "linked.ply"])
def test_a_mesh_of_a_preset_lies_in_its_folder(tmp_path, path):
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "bunny.ply").write_text("victim")
    (folder / "linked.ply").symlink_to("../bunny.ply")
    shapes = f'shapes = ["mesh:{path}"]\ncomposite_fraction = 0.0\n'
    (folder / "my.toml").write_text(f"[dataset]\ncount = 1\n[hidden_object]\n{shapes}")
    sentence = refusal("night-gen", "scenes", tmp_path / "data", "--preset", folder / "my.toml")
    assert f"inside {folder}" in sentence or f"a place outside {folder}" in sentence
    assert not (tmp_path / "data").exists()
