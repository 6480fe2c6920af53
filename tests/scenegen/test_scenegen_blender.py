"""What Blender makes of a scene: shapes, places, mirrors, and the same bytes every time."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scene_folders import contents, of_seed_5, upright_cube, with_object

from disk.partials import HOST
from scenegen import DatasetError, camera_axes, scene_id, wall_normal
from scenegen.making.generation import generate


@pytest.fixture(scope="module")
def upright():
    return upright_cube()


@pytest.fixture
def written(maker, tmp_path):
    def write(scene):
        folder = tmp_path / "scene"
        folder.mkdir(exist_ok=True)
        for name, data in maker.files(scene).items():
            (folder / name).write_bytes(data)
        return folder

    return write


# The volume of a prism or pyramid over a regular 64-gon in a circle, in units of r^2 h.
POLYGON = 64 / 2 * np.sin(2 * np.pi / 64)


@pytest.mark.parametrize(
    ("shape", "volume_m3", "tolerance"),
    [
        ("cube", 0.5**3, 1e-6),
        ("parallelepiped", 0.3 * 0.3 * 0.6, 1e-6),
        ("cylinder", POLYGON * 0.2**2 * 0.55, 1e-6),
        ("cone", POLYGON * 0.28**2 * 0.55 / 3, 1e-6),
        # An inscribed UV sphere lacks about (pi/64)^2 (1 + 1/2) of the ball.
        ("sphere", 4 / 3 * np.pi * 0.28**3, 1.5 * (np.pi / 64) ** 2 * 1.5),
    ],
)
def test_solids_have_their_volume_with_faces_turned_outwards(
    written, upright, paper, shape, volume_m3, tolerance
):
    size_m = paper.hidden_object.size_m.of(shape)
    folder = written(with_object(upright, shape=shape, size_m=size_m, rotation_deg=(20.0, -50.0, 70.0)))
    for name in ("hidden_object_0.ply", "mirrored_hidden_object_0.ply"):
        mesh = trimesh.load(folder / name)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(volume_m3, rel=tolerance)


def test_the_concave_plane_is_an_arc_of_radius_35_cm_over_two_radians(written, upright, paper):
    size_m = paper.hidden_object.size_m.concave_plane
    folder = written(with_object(upright, shape="concave_plane", size_m=size_m))
    mesh = trimesh.load(folder / "hidden_object_0.ply")
    axis = np.array([1.15 - size_m[0] / 2 + 0.35, 0.9])  # the arc's lowest point is half a sagitta below
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices[:, :2] - axis, axis=1), 0.35, atol=2e-4)
    # 64 chords of 2 r sin(1/64) each, 0.6 m high
    assert mesh.area == pytest.approx(0.6 * 64 * 2 * 0.35 * np.sin(1 / 64), rel=1e-3)


def test_an_object_is_turned_about_x_then_y_then_z(written, upright):
    folder = written(with_object(upright, rotation_deg=(30.0, 40.0, 50.0), size_m=(0.2, 0.4, 0.6)))
    mesh = trimesh.load(folder / "hidden_object_0.ply")
    euler = trimesh.transformations.euler_matrix(*np.radians([30, 40, 50]), axes="sxyz")[:3, :3]
    local = (mesh.vertices - [1.15, 0.9, 1.6]) @ euler
    np.testing.assert_allclose(np.ptp(local, axis=0), (0.2, 0.4, 0.6), atol=1e-6)


def test_walls_stand_where_the_paper_has_them(written, upright):
    folder = written(upright)
    relay, middle = (trimesh.load(folder / f"{name}.ply") for name in ("relay_wall", "middle_wall"))
    np.testing.assert_allclose(relay.bounds, [[0, -4, 0], [0, 4, 4]], atol=1e-6)
    np.testing.assert_allclose(middle.bounds, [[0.7, 0, 0], [4, 0, 4]], atol=1e-6)
    np.testing.assert_allclose(relay.face_normals, [wall_normal(upright.relay_wall)] * 2, atol=1e-6)
    np.testing.assert_allclose(middle.face_normals, [wall_normal(upright.middle_wall)] * 2, atol=1e-6)


def test_the_mirrored_object_is_the_object_reflected_through_x_0(written, upright):
    folder = written(with_object(upright, rotation_deg=(10.0, 20.0, 30.0)))
    there, here = (trimesh.load(folder / f"{name}hidden_object_0.ply") for name in ("", "mirrored_"))
    np.testing.assert_allclose(here.vertices, there.vertices * [-1, 1, 1], atol=1e-6)


def test_the_camera_of_the_paper_looks_along_minus_sin_50_cos_50(upright):
    angle = np.radians(50)
    right, down, forward = camera_axes(upright.camera)
    np.testing.assert_allclose(forward, [-np.sin(angle), np.cos(angle), 0], atol=1e-12)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(np.cross(right, down), forward, atol=1e-12)


def test_same_seed_same_bytes_and_interrupted_work_goes_on(maker, tmp_path):
    preset = of_seed_5(8)
    generate(tmp_path / "whole", preset, maker, lambda: None)
    expected = contents(tmp_path / "whole")

    class StopHereError(Exception):
        pass

    made = []

    def stop_after_three():
        made.append(1)
        if len(made) == 3:
            raise StopHereError

    with pytest.raises(StopHereError):
        generate(tmp_path / "resumed", preset, maker, stop_after_three)
    assert not (tmp_path / "resumed" / "dataset.json").exists()
    (tmp_path / "resumed" / f".dataset.json.{HOST}-999999999.1.partial").mkdir()  # killed while writing it
    generate(tmp_path / "resumed", preset, maker, lambda: None)
    assert contents(tmp_path / "resumed") == expected


def test_making_a_dataset_again_mends_its_scenes(maker, tmp_path):
    preset = of_seed_5(4)
    generate(tmp_path, preset, maker, lambda: None)
    expected = contents(tmp_path)
    scenes = tmp_path / "scenes"
    (scenes / scene_id(0) / "scene.json").write_text("{}")
    (scenes / scene_id(1) / "scene.xml").unlink()
    (scenes / scene_id(2) / "hidden_object_0.ply").write_bytes(b"")
    shutil.rmtree(scenes / scene_id(3))
    generate(tmp_path, preset, maker, lambda: None)
    assert contents(tmp_path) == expected


def test_scenes_of_an_interrupted_larger_run_are_removed_and_foreign_ones_refused(maker, tmp_path):
    preset = of_seed_5(2)
    generate(tmp_path, preset, maker, lambda: None)
    expected = contents(tmp_path)
    (tmp_path / "dataset.json").unlink()
    for name in (scene_id(2), scene_id(7), f".{scene_id(8)}.{HOST}-999999999.1.partial"):
        (tmp_path / "scenes" / name).mkdir()
        (tmp_path / "scenes" / name / "scene.json").write_text("{}")
    (tmp_path / "scenes" / "holiday").mkdir()
    with pytest.raises(DatasetError, match=r"holiday is none of the dataset's scenes"):
        generate(tmp_path, preset, maker, lambda: None)
    assert (tmp_path / "scenes" / scene_id(7)).exists()
    (tmp_path / "scenes" / "holiday").rmdir()
    generate(tmp_path, preset, maker, lambda: None)
    assert contents(tmp_path) == expected
    (tmp_path / "scenes" / scene_id(7)).mkdir()  # beside a finished dataset nothing explains it
    with pytest.raises(DatasetError, match=rf"{scene_id(7)} is none of the dataset's scenes"):
        generate(tmp_path, preset, maker, lambda: None)


MEMORY = """
import os, sys
from pathlib import Path
from scenegen import preset_from_dict, sample_valid_scene
from scenegen.geometry_check import refusal
from scenegen.making.blender import BlenderMaker

preset, maker, made_bytes = preset_from_dict({}, "paper"), BlenderMaker(), 0
warm, last = int(sys.argv[1]), int(sys.argv[2])
for index in range(last + 1):
    scene = sample_valid_scene(preset, index, refusal)
    made_bytes += sum(len(contents) for contents in maker.files(scene).values()) * (index > warm)
    if index in (warm, last):
        print(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
print(made_bytes)
"""


@pytest.mark.long
@pytest.mark.parametrize(("warm", "last"), [(50, 300), pytest.param(100, 3000, marks=pytest.mark.thorough)])
def test_memory_stays_constant_however_many_scenes_are_made(warm, last):
    command = [sys.executable, "-c", MEMORY, str(warm), str(last)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    warm_bytes, late_bytes, made_bytes = map(int, done.stdout.split())
    # If a scene's meshes stayed in memory, they would take at least as much as its files (40 kB). A tenth of
    # that is less than Blender's objects of a scene without their meshes.
    assert late_bytes - warm_bytes < made_bytes / 10


def test_the_dataset_folder_keeps_its_contract(make_dataset):
    dataset = make_dataset({"dataset": {"count": 7}})
    index = json.loads((dataset.root / "dataset.json").read_text())
    assert index["schema_version"] == 4
    assert index["preset"]["transient"]["bin_count"] == 2000
    assert [entry["id"] for entry in index["scenes"]] == [f"{i:06d}" for i in range(7)]
    simple = {file.name for file in dataset.scene_folder("000000").iterdir()}
    assert simple == {
        "scene.json",
        "scene.xml",
        "mirrored.xml",
        "emitter.pfm",
        "relay_wall.ply",
        "middle_wall.ply",
        "hidden_object_0.ply",
        "mirrored_hidden_object_0.ply",
    }
