"""The same seed gives the same as ever: scenes to the byte, renders as far as rounding allows.

``tests/golden`` holds SHA-256 of every file of the scenes of two small datasets, and the phasors of three of
their renders. Bytes of renders are not recorded: their kernels are compiled for the processor at hand, and
each kind of processor rounds in its own way. A change that is meant to change these files makes them again:

    python tests/render/transport/test_same_bytes.py
"""

import json
import shutil
import sys
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import pytest
from night_commands import PRESET, night
from render_runs import SETTINGS

from disk import sha256_of
from itof import read_image
from render.backend import select_variant
from render.options import ManyLightOptions, PathOptions
from render.rendering import Renderer
from render.settings import RenderSettings
from scenegen import open_dataset

GOLDEN = Path(__file__).parents[2] / "golden"
HASHES, REFERENCE = GOLDEN / "scenes.json", GOLDEN / "reference.npz"
ONE_SCENE = PRESET.replace("count = 7", "count = 1")
PATHS = ["--method", "path", "--spp", "16", "--device", "cpu"]
PIXELS = (("many", "000000"), ("many", "000003"), ("path", "000000"))  # of the reference


@pytest.fixture(scope="module")
def datasets(seven_renders, make_dataset, render_here):
    """Today's datasets by name: seven scenes by many lights, one by paths."""
    one = make_dataset(tomllib.loads(ONE_SCENE)).root
    done = render_here(one, *PATHS)
    assert done.returncode == 0, done.stderr
    return {"many": seven_renders, "path": one}


def hashes(root):
    """SHA-256 of every file of the scenes of a dataset, by path."""
    return {file.relative_to(root).as_posix(): sha256_of(file) for file in sorted(root.glob("scenes/0*/*"))}


def pixels(datasets):
    """(H, W, F) phasors of `PIXELS`: all light, and the hidden part where the method knows it."""
    found = {}
    for name, scene_id in PIXELS:
        image = read_image(datasets[name] / "renders" / scene_id / "itof.exr")
        for part in ("itof", "hidden") if name == "many" else ("itof",):
            found[f"{name}.{scene_id}.{part}"] = image.phasors(part)[0].astype(np.complex64)
    return found


@pytest.mark.parametrize("name", ["many", "path"])
def test_scenes_are_the_same_bytes_as_ever(datasets, name):
    assert hashes(datasets[name]) == json.loads(HASHES.read_text())[name]


def test_renders_are_the_same_pixels_as_ever_on_all_machines(datasets):
    found = pixels(datasets)
    with np.load(REFERENCE) as reference:
        assert set(found) == set(reference.files)
        for key, expected in reference.items():
            name, scene_id, _ = key.split(".")
            error = np.linalg.norm(found[key] - expected, axis=(0, 1))  # (F,)
            if name == "many":
                # Rays in float32 know 10 m of path to 2^-21 m, which is 6e-7 rad at 60 MHz; with the rounding
                # of values, 1e-6 of the total. In these scenes the hidden part is 1e-3 of the total or more.
                scale = np.linalg.norm(reference[f"{name}.{scene_id}.hidden"], axis=(0, 1))
                assert np.all(error < 1e-3 * scale), key
            else:
                # One of 16 paths in one of 432 pixels may take another way at an edge.
                assert np.all(error < np.linalg.norm(expected, axis=(0, 1)) / 16 / np.sqrt(432)), key


@pytest.mark.parametrize(
    "options", [ManyLightOptions(error=0.05), PathOptions(spp=1000)], ids=["many", "path"]
)
def test_files_do_not_depend_on_the_number_of_threads(seven_scenes, tmp_path, options):
    import drjit as dr

    root = shutil.copytree(seven_scenes, tmp_path / "data")
    settings = RenderSettings(product="both", options=options, device="cpu")
    select_variant("cpu")
    usual, found = dr.thread_count(), []
    for threads in (1, 3):
        dr.set_thread_count(threads)
        try:
            made = Renderer(open_dataset(root), settings).render("000000")  # OpenEXR gets as many
        finally:
            dr.set_thread_count(usual)
        found.append({name: file.sha256 for name, file in made.files.items()})
    assert len(found[0]) == 4
    assert found[1] == found[0]


def write_golden(datasets):
    """Record datasets as those that all later ones must equal."""
    GOLDEN.mkdir(exist_ok=True)
    scenes = {name: hashes(root) for name, root in datasets.items()}
    HASHES.write_text(json.dumps(scenes, indent=1) + "\n")
    np.savez_compressed(REFERENCE, **pixels(datasets))


def make(folder):
    """Make and render the two datasets with the commands."""
    made = {}
    for name, preset, settings in (("many", PRESET, SETTINGS), ("path", ONE_SCENE, PATHS)):
        (folder / f"{name}.toml").write_text(preset)
        made[name] = folder / name
        for command in (
            ("night-gen", "scenes", made[name], "--preset", folder / f"{name}.toml"),
            ("night-render", made[name], *settings),
        ):
            done = night(*command)
            if done.returncode != 0:
                sys.exit(done.stderr)
    return made


if __name__ == "__main__":
    work = Path(tempfile.mkdtemp())
    try:
        write_golden(make(work))
    finally:
        shutil.rmtree(work)
