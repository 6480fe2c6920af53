"""Many scenes, many processes, more scenes later, and shapes of the user's own."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

import cli
from scenegen import DatasetError, RenderingProvenance, open_dataset, preset_from_dict, scene_id, write_index
from scenegen.making.generation import check_target, generate
from scenegen.making.meshes import MAX_TRIANGLES, read_mesh

NIGHT_GEN = Path(sys.executable).with_name("night-gen")


def night_gen(*arguments):
    words = [str(word) for word in (NIGHT_GEN, "scenes", *arguments)]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def refusal(*arguments):
    """The one sentence on stderr of a `night-gen scenes` that must end with exit code 2."""
    result = CliRunner().invoke(cli.night_gen, ["scenes", *(str(word) for word in arguments)])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert result.stderr.count("\n") == 1
    return result.stderr.removeprefix("Error: ").strip()


def contents(root):
    return {str(f.relative_to(root)): f.read_bytes() for f in sorted(root.rglob("*")) if f.is_file()}


def identities(root):
    """What changes when a file or folder is written anew, though it be with the same bytes."""
    stats = {str(entry.relative_to(root)): entry.stat() for entry in sorted(root.rglob("*"))}
    return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in stats.items()}


def of_seed_5(count, **tables):
    return preset_from_dict({"dataset": {"count": count, "seed": 5}, **tables}, "seed 5")


# --- several processes -----------------------------------------------------------------------------------


def test_one_and_three_processes_write_the_same_bytes(maker, tmp_path):
    generate(tmp_path / "one", of_seed_5(50), maker, lambda: None)  # three chunks of 16, and two scenes
    done = night_gen(tmp_path / "three", "--count", 50, "--seed", 5, "--workers", 3)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"50 scenes in {tmp_path / 'three'}: ")
    assert contents(tmp_path / "three") == contents(tmp_path / "one")


def workers_of(process):
    """Process ids of the workers that a night-gen has started, without the one that tracks its semaphores."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def working(tmp_path):
    """A night-gen of two workers in the middle of more scenes than it will make."""
    words = [NIGHT_GEN, "scenes", tmp_path / "data", "--count", "100000", "--workers", "2"]
    process = subprocess.Popen([str(w) for w in words], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (tmp_path / "data" / "scenes" / scene_id(40)).exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    yield process
    process.kill()
    process.communicate()


def assert_ended(workers):
    deadline = time.monotonic() + 20
    while any(is_running(worker) for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_killed_worker_ends_the_command_with_one_sentence(working, tmp_path):
    workers = workers_of(working)
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    _, stderr = working.communicate(timeout=60)
    assert working.returncode == 2
    assert "Traceback" not in stderr
    assert stderr.splitlines()[-1].startswith("Error: a worker process was killed")
    assert_ended(workers)
    assert not (tmp_path / "data" / "dataset.json").exists()


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 128 + signal.SIGINT), (signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGKILL, -9)],
)
def test_the_workers_end_with_the_command(working, number, code):
    workers = workers_of(working)
    for pid in (*workers, working.pid) if number == signal.SIGINT else (working.pid,):
        os.kill(pid, number)  # Ctrl-C goes to every process of a terminal
    _, stderr = working.communicate(timeout=60)
    assert working.returncode == code
    assert "Traceback" not in stderr
    assert_ended(workers)


def test_a_preset_without_room_is_refused_by_workers_in_the_same_words(tmp_path):
    (tmp_path / "my.toml").write_text("[hidden_object]\nlocation_m = { x = [0.1, 0.1] }\n")
    done = [night_gen(tmp_path / "out", "--preset", tmp_path / "my.toml", "--workers", n) for n in (1, 2)]
    assert [one.returncode for one in done] == [2, 2]
    errors = [one.stderr.splitlines()[-1] for one in done]
    assert errors[0] == errors[1]
    assert "scene 0: none of 1000 draws fits the room" in errors[0]


# --- more scenes later -----------------------------------------------------------------------------------


def test_extending_equals_making_at_once_and_touches_no_scene_that_is_there(maker, tmp_path):
    generate(tmp_path / "once", of_seed_5(20), maker, lambda: None)
    generate(tmp_path / "grown", of_seed_5(9), maker, lambda: None)
    before = identities(tmp_path / "grown" / "scenes")
    generate(tmp_path / "grown", of_seed_5(20), maker, lambda: None)
    after = identities(tmp_path / "grown" / "scenes")
    assert {name: after[name] for name in before} == before
    assert contents(tmp_path / "grown") == contents(tmp_path / "once")


def test_workers_extend_too_and_touch_nothing_that_is_there(maker, tmp_path):
    generate(tmp_path / "once", of_seed_5(40), maker, lambda: None)
    generate(tmp_path / "grown", of_seed_5(9), maker, lambda: None)
    before = identities(tmp_path / "grown" / "scenes")
    done = night_gen(tmp_path / "grown", "--count", 40, "--seed", 5, "--workers", 2)
    assert done.returncode == 0, done.stderr
    after = identities(tmp_path / "grown" / "scenes")
    assert {name: after[name] for name in before} == before
    assert contents(tmp_path / "grown") == contents(tmp_path / "once")


def test_making_a_dataset_again_keeps_the_record_of_its_renders(maker, tmp_path):
    dataset = generate(tmp_path, of_seed_5(3), maker, lambda: None)
    rendering = RenderingProvenance(
        *("many-light", "both", 3, {"error": 0.01}, 24, 18, {"mitsuba": "3.9"}, 3, 0.008, 0.01)
    )
    write_index(tmp_path, replace(dataset.index, rendering=rendering))
    for count in (3, 5):
        generate(tmp_path, of_seed_5(count), maker, lambda: None)
        assert open_dataset(tmp_path).index.rendering == rendering


def test_an_interrupted_extension_goes_on_or_is_taken_back(maker, tmp_path):
    generate(tmp_path, of_seed_5(4), maker, lambda: None)
    four = contents(tmp_path)

    class StopHereError(Exception):
        pass

    made = []

    def stop_after_six():
        made.append(1)
        if len(made) == 6:
            raise StopHereError

    with pytest.raises(StopHereError):
        generate(tmp_path, of_seed_5(9), maker, stop_after_six)
    assert len(open_dataset(tmp_path).ids()) == 4
    assert (tmp_path / "scenes" / scene_id(5)).exists()
    generate(tmp_path, of_seed_5(4), maker, lambda: None)
    assert contents(tmp_path) == four
    made.clear()
    with pytest.raises(StopHereError):
        generate(tmp_path, of_seed_5(9), maker, stop_after_six)
    generate(tmp_path, of_seed_5(9), maker, lambda: None)
    generate(tmp_path / "once", of_seed_5(9), maker, lambda: None)
    once = contents(tmp_path / "once")
    assert {name: data for name, data in contents(tmp_path).items() if not name.startswith("once")} == once


@pytest.mark.parametrize("count", [3, 9])
@pytest.mark.parametrize("damage", ["no scene.json", "no JSON", "another seed", "another index"])
def test_a_folder_beside_a_finished_dataset_that_is_not_its_own_is_refused(maker, tmp_path, damage, count):
    root = tmp_path / "data"
    generate(root, of_seed_5(3), maker, lambda: None)
    file = root / "scenes" / scene_id(7) / "scene.json"
    file.parent.mkdir()
    ours = json.loads((root / "scenes" / scene_id(1) / "scene.json").read_text())
    if damage == "no JSON":
        file.write_text("{")
    elif damage == "another seed":
        file.write_text(json.dumps(ours | {"index": 7, "dataset_seed": 6}))
    elif damage == "another index":
        file.write_text(json.dumps(ours))
    with pytest.raises(DatasetError, match=rf"{scene_id(7)} is none of the dataset's scenes"):
        generate(root, of_seed_5(count), maker, lambda: None)
    assert file.parent.exists()
    file.write_text(json.dumps(ours | {"index": 7}))
    check_target(root, of_seed_5(count))


def test_fewer_scenes_than_there_are_are_refused_with_the_number_there_is(maker, tmp_path):
    generate(tmp_path, preset_from_dict({"dataset": {"count": 3}}, "three"), maker, lambda: None)
    message = refusal(tmp_path, "--preset", "paper", "--count", 2)
    assert "already holds 3 scenes" in message
    assert "--count 3 or more" in message
    assert "another preset or seed" in refusal(tmp_path, "--preset", "paper", "--count", 3, "--seed", 1)
    assert len(open_dataset(tmp_path).ids()) == 3


def test_the_index_says_by_what_the_scenes_were_made(maker, tmp_path):
    index = generate(tmp_path, of_seed_5(1), maker, lambda: None).index
    assert set(index.packages) == {"night-nlos", "bpy", "numpy", "trimesh"}
    assert index.packages["numpy"] == np.__version__
    assert index.packages["trimesh"] == trimesh.__version__
    assert index.blender_version.startswith(index.packages["bpy"])


# --- memory ----------------------------------------------------------------------------------------------

MEMORY = """
import os
from pathlib import Path
from scenegen import preset_from_dict, sample_valid_scene
from scenegen.making.blender import BlenderMaker

preset, maker, made_bytes = preset_from_dict({}, "paper"), BlenderMaker(), 0
for index in range(700):
    scene = sample_valid_scene(preset, index, maker.refusal)
    made_bytes += sum(len(contents) for contents in maker.files(scene).values()) * (index >= 100)
    if index in (99, 699):
        print(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
print(made_bytes)
"""


def test_memory_stays_where_it_is_however_many_scenes_are_made():
    done = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True)
    warm_bytes, late_bytes, made_bytes = map(int, done.stdout.split())
    # Kept meshes would be at least what the files of 600 scenes are (40 MB). A tenth of it, some kB a scene,
    # is less than Blender's four objects of every scene would take.
    assert late_bytes - warm_bytes < made_bytes / 10


# --- the user's meshes -----------------------------------------------------------------------------------

PRESET = """
[dataset]
count = 3
[hidden_object]
shapes = ["mesh:shapes/mine.{kind}"]
composite_fraction = 0.0
"""


def with_mesh(folder, data, kind="ply"):
    """A preset file that names a mesh, and the mesh."""
    (folder / "shapes").mkdir(exist_ok=True)
    if data is not None:
        (folder / "shapes" / f"mine.{kind}").write_bytes(data)
    (folder / "my.toml").write_text(PRESET.format(kind=kind))
    return folder / "my.toml"


def exported(mesh, kind="ply"):
    data = mesh.export(file_type=kind)
    return data if isinstance(data, bytes) else data.encode()


def wedge():
    """A solid without any symmetry, 4 x 2 x 1, far from the origin."""
    corners = np.add([[0, 0, 0], [4, 0, 0], [0, 2, 0], [0.5, 0.25, 1]], [100.0, -200.0, 300.0])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    return trimesh.Trimesh(corners, faces, process=False)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "off", "glb"])
def test_a_mesh_fills_half_a_metre_with_its_volume_and_its_outside_out(tmp_path, kind):
    done = night_gen(tmp_path / "data", "--preset", with_mesh(tmp_path, exported(wedge(), kind), kind))
    assert done.returncode == 0, done.stderr
    dataset = open_dataset(tmp_path / "data")
    shape = f"mesh:shapes/mine.{kind}"
    assert {entry.object_class for entry in dataset.index.scenes} == {shape}
    assert str(tmp_path) not in (dataset.root / "dataset.json").read_text()
    for scene in dataset.ids():
        part = dataset.scene(scene).hidden_objects[0]
        assert (part.shape, part.size_m) == (shape, (0.5, 0.5, 0.5))
        euler = trimesh.transformations.euler_matrix(*np.radians(part.rotation_deg), axes="sxyz")[:3, :3]
        for name, mirror in (("", 1), ("mirrored_", -1)):
            mesh = trimesh.load(dataset.scene_folder(scene) / f"{name}hidden_object_0.ply")
            assert mesh.is_watertight
            # A tetrahedron of legs 4 and 2 and height 1, at 0.5 m to 4; float32 coordinates of about 1 m.
            assert mesh.volume == pytest.approx(4 * 2 / 6 / 8**3, rel=1e-5)
            local = (mesh.vertices * [mirror, 1, 1] - part.location_m) @ euler
            np.testing.assert_allclose(local.min(axis=0), [-0.25, -0.125, -0.0625], atol=1e-6)
            np.testing.assert_allclose(local.max(axis=0), [0.25, 0.125, 0.0625], atol=1e-6)


def test_a_mesh_of_another_size_key_fills_that_box(tmp_path):
    preset = with_mesh(tmp_path, exported(trimesh.creation.icosphere(subdivisions=3)))
    preset.write_text(preset.read_text() + "size_m = { mesh = 0.3 }\n")
    assert night_gen(tmp_path / "data", "--preset", preset).returncode == 0
    dataset = open_dataset(tmp_path / "data")
    mesh = trimesh.load(dataset.scene_folder(scene_id(0)) / "hidden_object_0.ply")
    centre = dataset.scene(scene_id(0)).hidden_objects[0].location_m
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - centre, axis=1), 0.15, atol=1e-6)


def test_meshes_are_the_same_bytes_from_workers_and_stand_in_composites(tmp_path):
    preset = with_mesh(tmp_path, exported(trimesh.creation.icosphere(subdivisions=2)))
    text = preset.read_text().replace("count = 3", "count = 24").replace("= 0.0", "= 0.5")
    preset.write_text(text.replace("[hidden_object]\nshapes = [", '[hidden_object]\nshapes = ["cube", '))
    for workers in (1, 2):
        done = night_gen(tmp_path / f"{workers}", "--preset", preset, "--workers", workers)
        assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "1") == contents(tmp_path / "2")
    dataset = open_dataset(tmp_path / "1")
    pairs = [dataset.scene(scene).hidden_objects for scene in dataset.ids()]
    assert any(len(pair) == 2 and "mesh:shapes/mine.ply" in {part.shape for part in pair} for pair in pairs)


def test_a_dataset_is_not_gone_on_with_after_its_mesh_changed(tmp_path):
    preset = with_mesh(tmp_path, exported(wedge()))
    assert night_gen(tmp_path / "data", "--preset", preset).returncode == 0
    before = contents(tmp_path / "data")
    assert night_gen(tmp_path / "data", "--preset", preset).returncode == 0
    assert contents(tmp_path / "data") == before
    (tmp_path / "shapes" / "mine.ply").write_bytes(exported(trimesh.creation.box()))
    for count in (3, 5):
        message = refusal(tmp_path / "data", "--preset", preset, "--count", count)
        assert "was made with another mesh:shapes/mine.ply" in message
    assert contents(tmp_path / "data") == before


def ply_of(vertices, faces):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, vertex)) for vertex in vertices]
    lines += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    return ("\n".join(lines) + "\n").encode()


SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


@pytest.mark.parametrize(
    ("kind", "data", "words"),
    [
        ("ply", None, "is missing"),
        ("ply", b"", "is empty"),
        ("ply", b"hello", "cannot be read as PLY"),
        ("obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "cannot be read as OBJ"),
        ("ply", ply_of(SQUARE, [(0, 1, 9)]), "names? vertices that it does not have"),
        ("ply", exported(wedge())[:-20], "cannot be read as PLY"),
        ("stl", exported(wedge(), "stl")[:-20], "no triangles"),
        ("txt", b"hello", "no known format"),
        ("ply", ply_of(SQUARE, []), "no triangles"),
        ("ply", ply_of([*SQUARE[:3], (0, 0, "nan")], [(0, 1, 2)]), "infinite or not a number"),
        ("ply", ply_of([*SQUARE[:2], ("inf", 1, 0)], [(0, 1, 2)]), "infinite or not a number"),
        ("ply", ply_of([(5, 5, 5)] * 3, [(0, 1, 2)]), "0 units across"),
        ("ply", ply_of([(0, 0, 0), (1, 1, 1), (3, 3, 3)], [(0, 1, 2), (0, 0, 1)]), "has no area"),
    ],
)
def test_a_mesh_that_is_no_surface_is_refused_by_name(tmp_path, kind, data, words):
    message = refusal(tmp_path / "out", "--preset", with_mesh(tmp_path, data, kind))
    assert f"mine.{kind}" in message
    assert re.search(words, message)
    assert not (tmp_path / "out").exists()


def test_a_folder_is_no_mesh(tmp_path):
    (tmp_path / "shapes" / "mine.ply").mkdir(parents=True)
    assert "mine.ply is no file" in refusal(tmp_path / "out", "--preset", with_mesh(tmp_path, None))


def test_a_mesh_of_too_many_triangles_says_how_many_are_allowed(tmp_path):
    count = MAX_TRIANGLES + 1
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    header += f"property float z\nelement face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    face = np.zeros(count, [("n", "u1"), ("corners", "<i4", 3)])
    face["n"], face["corners"] = 3, (0, 1, 2)
    data = header.encode() + np.array(SQUARE, "<f4").tobytes() + face.tobytes()
    message = refusal(tmp_path / "out", "--preset", with_mesh(tmp_path, data))
    assert f"{count} triangles" in message
    assert f"at most {MAX_TRIANGLES}" in message


def test_a_mesh_is_cleaned_of_what_has_no_area_or_stands_twice(tmp_path):
    # A square of two triangles, each also facing the other way, a line far outside, and an unused vertex.
    vertices = [*SQUARE, (50, 50, 0), (70, 70, 0), (0, 0, 9)]
    faces = [(0, 1, 2), (2, 1, 0), (0, 2, 3), (3, 2, 0), (0, 4, 5), (1, 1, 2)]
    (tmp_path / "square.ply").write_bytes(ply_of(vertices, faces))
    mesh = read_mesh(tmp_path / "square.ply")
    np.testing.assert_array_equal(
        mesh.vertices, [[-0.5, -0.5, 0], [-0.5, 0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0]]
    )
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    assert solid.area == pytest.approx(1)
    np.testing.assert_array_equal(solid.face_normals, [[0, 0, 1]] * 2)  # as the first of each faces


def test_the_outermost_vertices_of_a_mesh_decide_like_all_of_them(maker, tmp_path):
    from scenegen import sample_scene
    from scenegen.making.blender import BlenderMaker

    inner, outer = trimesh.creation.icosphere(subdivisions=2, radius=0.9), trimesh.creation.box((2, 2, 2))
    (tmp_path / "both.ply").write_bytes(exported(trimesh.util.concatenate([inner, outer])))
    mesh = read_mesh(tmp_path / "both.ply")
    np.testing.assert_array_equal(np.abs(mesh.vertices[mesh.outermost]), np.full((8, 3), 0.5))
    with_box = BlenderMaker({"mesh:both.ply": mesh})
    preset = of_seed_5(
        200,
        hidden_object={
            "shapes": ["cube"],
            "composite_fraction": 0.0,
            "location_m": {"x": [0.2, 1.5], "y": [0.2, 1.0]},
        },
    )
    refused = []
    for index in range(200):
        cube = sample_scene(preset, index)
        part = replace(cube.hidden_objects[0], shape="mesh:both.ply")
        refused.append(with_box.refusal(cube))
        assert with_box.refusal(replace(cube, hidden_objects=(part,))) == refused[-1]
    assert 20 < sum(reason is None for reason in refused) < 180
