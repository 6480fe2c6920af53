"""``night-render export``: a dataset as one HDF5 file, read with h5py and numpy alone."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
from night_commands import night_here
from source_tree import ROOT
from synthetic_dataset import write_synthetic_dataset, write_synthetic_render

import model
from disk import sha256_of
from itof import DepthMap, read_image
from render.products.dataset_export import export_dataset
from scenegen import open_dataset, read_record

PARTS = {"phasors": "itof", "direct_phasors": "direct", "hidden_phasors": "hidden"}
IMAGES = {*PARTS, "mirrored_phasors", "radial_depth_m", "mask"}
COLUMNS = {"scene_id", "object_class", "split", "roughness", "horizontal_fov_deg", "scene", "render"}
DOCUMENTS = {"preset", "provenance", "left_out"}


def texts(file, name):
    return file[name].asstr()[()].tolist()


def test_every_image_is_that_of_the_rendered_files(exported, seven_renders):
    dataset = open_dataset(seven_renders)
    with h5py.File(exported) as file:
        assert texts(file, "scene_id") == dataset.ids()
        for row, scene_id in enumerate(dataset.ids()):
            image = read_image(dataset.render_folder(scene_id) / "itof.exr")
            for name, part in (
                ("phasors", "itof"),
                ("direct_phasors", "direct"),
                ("hidden_phasors", "hidden"),
            ):
                z, frequencies_hz = image.phasors(part)
                np.testing.assert_array_equal(file[name][row], z)
                assert tuple(file["frequencies_hz"][()]) == frequencies_hz
            truth = read_image(dataset.render_folder(scene_id) / "mirrored.exr")
            np.testing.assert_array_equal(file["mirrored_phasors"][row], truth.phasors()[0][..., 0])
            np.testing.assert_array_equal(file["radial_depth_m"][row], truth.channel("depth.R"))
            np.testing.assert_array_equal(file["mask"][row], truth.channel("mask.M"))
        assert 0 < file["mask"][()].mean() < 1


def test_parameters_are_those_of_the_scene_files(exported, seven_renders):
    dataset = open_dataset(seven_renders)
    with h5py.File(exported) as file:
        for row, entry in enumerate(dataset.index.scenes):
            text = (dataset.scene_folder(entry.id) / "scene.json").read_text()
            assert file["scene"].asstr()[row] == text
            assert file["roughness"][row] == json.loads(text)["relay_wall"]["roughness"]
            camera = json.loads(text)["camera"]
            assert file["horizontal_fov_deg"][row] == camera["horizontal_fov_deg"]
            assert file["object_class"].asstr()[row] == entry.object_class
            assert file["split"].asstr()[row] == entry.split
            record = dataclasses.asdict(read_record(dataset.render_folder(entry.id)))
            assert json.loads(file["render"].asstr()[row]) == record
        for split in ("train", "validation", "test"):
            rows = file[f"splits/{split}"][()].tolist()
            assert [dataset.ids()[row] for row in rows] == dataset.ids(split)


def test_the_file_says_what_its_arrays_are_and_how_they_were_made(exported, seven_renders):
    dataset = open_dataset(seven_renders)
    with h5py.File(exported) as file:
        assert set(file) == IMAGES | COLUMNS | DOCUMENTS | {"frequencies_hz", "splits"}
        arrays = [file[name] for name in file if name != "splits"] + list(file["splits"].values())
        for array in arrays:
            axes = array.attrs["axes"].split(",") if array.attrs["axes"] else []
            assert len(axes) == array.ndim, array.name
            assert array.attrs["units"]
            assert len(array.attrs["description"]) > 10
        for name in IMAGES:
            real = np.zeros(1, file[name].dtype).real.dtype
            assert real == (np.uint8 if name == "mask" else np.float32)
            assert file[name].compression == "gzip"
            assert file[name].fletcher32
            assert file[name].chunks[0] == 1  # a scene is read without its neighbours
        assert (file.attrs["format"], file.attrs["format_version"]) == ("NIGHT dataset", 1)
        assert "licence" not in file.attrs
        assert json.loads(file["preset"].asstr()[()])["dataset"]["seed"] == 3
        made = json.loads(file["provenance"].asstr()[()])
        assert json.loads(file["left_out"].asstr()[()]) == {}
        everything = exported.read_bytes()
    assert made["scenes"]["seed"] == 3
    assert made["scenes"]["blender_version"] == dataset.index.blender_version
    assert made["rendering"]["method"] == "many-light"
    assert made["rendering"]["packages"] == dataset.rendering.packages
    assert made["frequencies_hz"] == [20e6, 50e6, 60e6]
    assert str(seven_renders).encode() not in everything


def test_the_page_of_file_formats_names_every_array_with_its_axes(exported):
    page = (ROOT / "docs" / "reference" / "files.md").read_text()
    section = page[page.index("## Exported dataset") :].split("\n## ")[0]
    with h5py.File(exported) as file:
        named = {name: file[name].attrs["axes"] for name in file if name != "splits"}
    for name, axes in named.items():
        (line,) = re.findall(rf"^\| .*`{name}`.*$", section, re.M)
        assert f"({axes.replace(',', ', ')})" in line or not axes
    assert "`splits/train`" in section


def test_the_same_dataset_gives_the_same_bytes_whatever_was_in_memory_before(
    exported, seven_renders, tmp_path
):
    moved = shutil.copytree(seven_renders, tmp_path / "moved")
    code = (
        "import sys, render, scenegen\nrender.export_dataset(scenegen.open_dataset(sys.argv[1]), sys.argv[2])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, moved, tmp_path / "out.h5"],
        # glibc fills memory with this byte, so that bytes without a value differ from those of `exported`
        env={**os.environ, "MALLOC_PERTURB_": "170"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert sha256_of(tmp_path / "out.h5") == sha256_of(exported)


@pytest.mark.long
def test_one_scene_is_in_memory_at_a_time(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=33)
    first, *others = dataset.ids()
    write_synthetic_render(dataset, dataset.scene(first), 200, 150)
    for scene_id in others:
        shutil.copytree(dataset.render_folder(first), dataset.render_folder(scene_id), dirs_exist_ok=True)
    code = """
import pathlib, re, sys
import render, scenegen
dataset, peaks = scenegen.open_dataset(sys.argv[1]), []
status = pathlib.Path("/proc/self/status")
note = lambda: peaks.append(re.search(r"VmHWM:\\s+(\\d+) kB", status.read_text())[1])
render.export_dataset(dataset, sys.argv[2], on_scene=note)
print(peaks[2], peaks[-1])
"""
    done = subprocess.run(
        [sys.executable, "-c", code, dataset.root, tmp_path / "x.h5"],
        capture_output=True,
        text=True,
        check=False,
    )
    third_kb, last_kb = map(int, done.stdout.split())
    with h5py.File(tmp_path / "x.h5") as file:
        scene_bytes = sum(file[name][0].nbytes for name in ("phasors", "mirrored_phasors", "radial_depth_m"))
    assert scene_bytes > 1e6
    # The cache of HDF5 has at most 8 MiB for each of four arrays, of which every scene fills less than 1 MB.
    assert last_kb - third_kb < 10 * scene_bytes / 1024  # of the 30 scenes that came after the third


def test_the_licence_of_the_card_is_that_of_the_file(closed_form_scenes, tmp_path):
    dataset = open_dataset(shutil.copytree(closed_form_scenes.root, tmp_path / "data"))
    card = '<!-- night-gen preview writes this file; licence: "CC BY 4.0" -->\n'
    (dataset.root / "README.md").write_text(card)
    export_dataset(dataset, tmp_path / "x.hdf5")
    with h5py.File(tmp_path / "x.hdf5") as file:
        assert file.attrs["licence"] == "CC BY 4.0"
        assert json.loads(file["provenance"].asstr()[()])["licence"] == "CC BY 4.0"


def test_measurements_of_another_program_have_no_parts_and_no_record(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=4, parts=False)
    result = export_dataset(dataset, tmp_path / "x.h5")
    assert set(result.arrays) == (IMAGES | COLUMNS) - {"direct_phasors", "hidden_phasors"}
    with h5py.File(tmp_path / "x.h5") as file:
        assert set(texts(file, "render")) == {"null"}
        z = read_image(dataset.render_folder("000003") / "itof.exr").phasors()[0]
        np.testing.assert_array_equal(file["phasors"][3], z)


def test_a_diffuse_wall_has_no_roughness(tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=2, relay_wall={"material": "diffuse"})
    export_dataset(dataset, tmp_path / "x.h5")
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["roughness"][()].tolist() == [-1, -1]


def test_images_of_several_chunks_are_whole(tmp_path, monkeypatch):
    monkeypatch.setattr("render.products.export_rows._CHUNK_BYTES", 5 * 24 * 3 * 8 + 1)  # 5 of 14 lines
    dataset = write_synthetic_dataset(tmp_path / "data", count=2)
    export_dataset(dataset, tmp_path / "x.h5")
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["phasors"].chunks == (1, 5, 24, 3)
        for row, scene_id in enumerate(dataset.ids()):
            z = read_image(dataset.render_folder(scene_id) / "itof.exr").phasors()[0]
            np.testing.assert_array_equal(file["phasors"][row], z)


def test_the_result_as_json(three_missing, tmp_path):
    out = tmp_path / "x.h5"
    done = night_here("night-render", "export", three_missing, "--out", out, "--partial", "--json")
    (line,) = done.stdout.splitlines()
    result = json.loads(line)
    assert result.keys() == {"file", "bytes", "sha256", "scenes", "left_out", "arrays"}
    assert (result["file"], result["bytes"]) == (str(out), out.stat().st_size)
    assert result["sha256"] == sha256_of(out)
    assert list(result["left_out"]) == ["000004", "000005", "000006"]
    assert sum(result["scenes"].values()) == 4
    assert result["arrays"]["phasors"] == [4, 18, 24, 3]
    assert "left out: scene 000004" in done.stderr
    page = (ROOT / "docs" / "reference" / "files.md").read_text()
    (row,) = re.findall(r"^\| `night-render export` \|.*$", page, re.M)
    assert set(re.findall(r"`(\w+)`", row)) >= result.keys()


def test_the_sentences_count_the_scenes_of_each_split(closed_form_scenes, tmp_path):
    out = tmp_path / "x.h5"
    lines = export_dataset(closed_form_scenes, out).sentences()
    assert lines[0].startswith(f"12 scenes in {out}: 7 train, 2 validation, 3 test; ")
    assert lines[1:] == [f"SHA-256: {sha256_of(out)}"]


@pytest.mark.long
def test_the_network_predicts_from_the_file_as_from_the_renders(finished_run, tmp_path):
    dataset = write_synthetic_dataset(tmp_path / "data", count=2)
    export_dataset(dataset, tmp_path / "x.h5")
    model.predict_file(finished_run, tmp_path / "x.h5", tmp_path / "all", rescale=False)
    for row, scene_id in enumerate(dataset.ids()):
        out = tmp_path / scene_id
        model.predict_file(finished_run, dataset.render_folder(scene_id) / "itof.exr", out)
        found, expected = (
            DepthMap.read(file) for file in (tmp_path / f"all/{row:06d}.exr", out / "000000.exr")
        )
        # the same network on the same numbers: float32 rounding of another batch
        np.testing.assert_allclose(found.phasor, expected.phasor, atol=1e-5)


def test_the_lines_of_the_page_that_need_h5py_alone_run(exported, tmp_path):
    page = (ROOT / "docs" / "guide" / "datasets.md").read_text()
    block = re.search(r"^```python\n(import json\n.*?)^```", page, re.M | re.S)[1]
    shutil.copy(exported, tmp_path / "paper.h5")
    check = """
import sys
assert not {"scenegen", "itof", "render", "model"} & set(sys.modules)
assert z.shape == (18, 24, 3) and z.dtype.kind == "c" and depth_m.shape == (18, 24)
assert scene["relay_wall"]["material"] == "rough" and len(test_rows) == 1
"""
    (tmp_path / "page.py").write_text(block + check)
    done = subprocess.run(
        [sys.executable, "page.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
