"""The same seed gives the same bytes as ever: scenes on any machine, renders on machines that round alike.

``tests/golden`` holds SHA-256 of every file of two small datasets. Those of renders are there for each
machine that recorded them; for machines that round in yet another way, there are the phasors of three
scenes. A change that is meant to change these files makes them again; --add records the renders of one more
machine:

    python tests/render/test_same_bytes.py
    python tests/render/test_same_bytes.py --add
"""

import argparse
import json
import shutil
import sys
import tempfile
import tomllib
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  (so that its library of linear algebra is loaded, as in a render)
from night_commands import PRESET, night
from render_runs import SETTINGS
from threadpoolctl import threadpool_info

from itof import read_image
from render.backend import select_variant
from render.options import ManyLightOptions, PathOptions
from render.rendering import Renderer
from render.settings import RenderSettings
from scenegen import open_dataset
from storage import sha256_of

GOLDEN = Path(__file__).parents[1] / "golden"
HASHES, REFERENCE = GOLDEN / "bytes.json", GOLDEN / "reference.npz"
ONE_SCENE = PRESET.replace("count = 7", "count = 1")
PATHS = ["--method", "path", "--spp", "16", "--device", "cpu"]
PACKAGES = ("numpy", "mitsuba", "mitransient", "drjit", "OpenEXR", "bpy")
PIXELS = (("many", "000000"), ("many", "000003"), ("path", "000000"))  # of the reference


@pytest.fixture(scope="module")
def datasets(seven_renders, make_dataset, render_here):
    """Today's datasets by name: seven scenes by many lights, one by paths."""
    one = make_dataset(tomllib.loads(ONE_SCENE)).root
    done = render_here(one, *PATHS)
    assert done.returncode == 0, done.stderr
    return {"many": seven_renders, "path": one}


@pytest.fixture(scope="module")
def golden():
    return json.loads(HASHES.read_text())


def hashes(root, kind):
    """SHA-256 of every file of the scenes, or of the renders, of a dataset, by path."""
    return {file.relative_to(root).as_posix(): sha256_of(file) for file in sorted(root.glob(f"{kind}/0*/*"))}


def machine():
    """What decides how renders are rounded: kernels are compiled for the processor at hand.

    The libraries of linear algebra choose theirs by the model of the processor, not by its features.
    """
    import drjit

    assert drjit.has_backend(drjit.JitBackend.LLVM)  # which loads the library
    features = np.core._multiarray_umath.__cpu_features__
    return {
        "processor": sorted(name for name, present in features.items() if present),
        "linear_algebra": sorted(
            f"{library['internal_api']} {library['version']} {library['architecture']}"
            for library in threadpool_info()
            if library["user_api"] == "blas"
        ),
        "llvm": ".".join(str(part) for part in drjit.detail.llvm_version()),
        "packages": {name: version(name) for name in PACKAGES},
    }


def pixels(datasets):
    """(H, W, F) phasors of `PIXELS`: all light, and the hidden part where the method knows it."""
    found = {}
    for name, scene_id in PIXELS:
        image = read_image(datasets[name] / "renders" / scene_id / "itof.exr")
        for part in ("itof", "hidden") if name == "many" else ("itof",):
            found[f"{name}.{scene_id}.{part}"] = image.phasors(part)[0].astype(np.complex64)
    return found


@pytest.mark.parametrize("name", ["many", "path"])
def test_scenes_are_the_same_bytes_as_ever(datasets, golden, name):
    assert hashes(datasets[name], "scenes") == golden["scenes"][name]


@pytest.mark.parametrize("name", ["many", "path"])
def test_renders_are_the_same_bytes_as_ever_on_machines_that_round_alike(datasets, golden, name):
    here = machine()
    recorded = [record for record in golden["renders"] if record["machine"] == here]
    if not recorded:
        pytest.skip(f"no renders were recorded on a machine like this one, {here}: add them with --add")
    assert hashes(datasets[name], "renders") == recorded[0][name]


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
    for threads in (1, 2, 3):
        dr.set_thread_count(threads)
        try:
            made = Renderer(open_dataset(root), settings).render("000000")  # OpenEXR gets as many
        finally:
            dr.set_thread_count(usual)
        found.append({name: file.sha256 for name, file in made.files.items()})
    assert len(found[0]) == 4
    assert found[1] == found[0]
    assert found[2] == found[0]


def write_golden(datasets):
    """Record datasets as those that all later ones must equal."""
    GOLDEN.mkdir(exist_ok=True)
    write_hashes({name: hashes(root, "scenes") for name, root in datasets.items()}, [renders(datasets)])
    np.savez_compressed(REFERENCE, **pixels(datasets))


def add_to_golden(datasets):
    """Record the renders of this machine, too; scenes and pixels must be those that are recorded."""
    golden = json.loads(HASHES.read_text())
    for name in datasets:
        test_scenes_are_the_same_bytes_as_ever(datasets, golden, name)
    test_renders_are_the_same_pixels_as_ever_on_all_machines(datasets)
    here = renders(datasets)
    others = [record for record in golden["renders"] if record["machine"] != here["machine"]]
    write_hashes(golden["scenes"], [*others, here])


def renders(datasets):
    """The machine, and SHA-256 of the renders of each dataset."""
    return {"machine": machine(), **{name: hashes(root, "renders") for name, root in datasets.items()}}


def write_hashes(scenes, machines):
    HASHES.write_text(json.dumps({"scenes": scenes, "renders": machines}, indent=1) + "\n")


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
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--add", action="store_true", help="keep what other machines recorded")
    record = add_to_golden if parser.parse_args().add else write_golden
    work = Path(tempfile.mkdtemp())
    try:
        record(make(work))
    finally:
        shutil.rmtree(work)
