"""The user's meshes as hidden objects: size, place and facing, and files that are refused."""

import io
import json
import re
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from night_commands import night, night_here, refusal
from scene_folders import contents, of_seed_5

from scenegen import open_dataset, sample_scene, scene_id
from scenegen.geometry_check import refusal as impossible
from scenegen.making.meshes import read_mesh
from scenegen.triangles import MAX_TRIANGLES, read_triangles

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


def scenes_of(folder, preset, *options):
    """A night-gen scenes that must succeed, in this process."""
    done = night_here("night-gen", "scenes", folder, "--preset", preset, *options)
    assert done.returncode == 0, done.stderr
    return open_dataset(folder)


def scenes_refused(folder, preset, *options):
    """The sentence of a night-gen scenes that must be refused."""
    return refusal("night-gen", "scenes", folder, "--preset", preset, *options)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "off", "glb"])
def test_a_mesh_fills_half_a_metre_with_its_volume_and_its_outside_out(tmp_path, kind):
    dataset = scenes_of(tmp_path / "data", with_mesh(tmp_path, exported(wedge(), kind), kind))
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
    dataset = scenes_of(tmp_path / "data", preset)
    mesh = trimesh.load(dataset.scene_folder(scene_id(0)) / "hidden_object_0.ply")
    centre = dataset.scene(scene_id(0)).hidden_objects[0].location_m
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - centre, axis=1), 0.15, atol=1e-6)


@pytest.mark.long
def test_meshes_are_the_same_bytes_from_workers_and_stand_in_composites(tmp_path):
    preset = with_mesh(tmp_path, exported(trimesh.creation.icosphere(subdivisions=2)))
    text = preset.read_text().replace("count = 3", "count = 24").replace("= 0.0", "= 0.5")
    preset.write_text(text.replace("[hidden_object]\nshapes = [", '[hidden_object]\nshapes = ["cube", '))
    dataset = scenes_of(tmp_path / "one", preset)
    done = night("night-gen", "scenes", tmp_path / "two", "--preset", preset, "--workers", 2)
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    pairs = [dataset.scene(scene).hidden_objects for scene in dataset.ids()]
    assert any(len(pair) == 2 and "mesh:shapes/mine.ply" in {part.shape for part in pair} for pair in pairs)


def test_a_dataset_is_not_gone_on_with_after_its_mesh_changed(tmp_path):
    preset = with_mesh(tmp_path, exported(wedge()))
    scenes_of(tmp_path / "data", preset)
    before = contents(tmp_path / "data")
    scenes_of(tmp_path / "data", preset)
    assert contents(tmp_path / "data") == before
    (tmp_path / "shapes" / "mine.ply").write_bytes(exported(trimesh.creation.box()))
    for count in (3, 5):
        message = scenes_refused(tmp_path / "data", preset, "--count", count)
        assert "was made with another mesh:shapes/mine.ply" in message
    assert contents(tmp_path / "data") == before


def ply_of(vertices, faces):
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, vertex)) for vertex in vertices]
    lines += [f"{len(face)} " + " ".join(map(str, face)) for face in faces]
    return ("\n".join(lines) + "\n").encode()


def zipped(data):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("mine.ply", data)
    return stream.getvalue()


def repeated(count):
    """A small file whose nodes all show the same sphere of 20480 triangles."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.icosphere(subdivisions=5), geom_name="ball")
    for place in range(1, count):
        scene.graph.update(frame_to=f"n{place}", geometry="ball")
    return scene.export(file_type="glb")


def declaring(count, *, in_bytes=False):
    """A small GLB file whose header gives an array so many entries, in its bytes or out of nothing."""
    contents = exported(wedge(), "glb")
    length = int.from_bytes(contents[12:16], "little")
    tree = json.loads(contents[20 : 20 + length])
    place = tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    tree["accessors"][place]["count"] = count
    if not in_bytes:
        del tree["accessors"][place]["bufferView"]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = contents[20 + length :]
    head = b"glTF" + struct.pack("<III", 2, 20 + len(text) + len(rest), len(text)) + b"JSON"
    return head + text + rest


SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


@pytest.mark.parametrize(
    ("kind", "data", "words"),
    [
        ("ply", None, "is missing"),
        ("ply", b"", "is empty"),
        ("ply", b"hello", "cannot be read as PLY"),
        (
            "ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\n",
            "cannot be read as PLY: it is damaged, or of another format",
        ),
        ("obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "cannot be read as OBJ"),
        ("ply", ply_of(SQUARE, [(0, 1, 9)]), "names? vertices that it does not have"),
        ("ply", exported(wedge())[:-20], "cannot be read as PLY"),
        ("stl", exported(wedge(), "stl")[:-20], "no triangles"),
        ("txt", b"hello", "no known format"),
        ("zip", zipped(exported(wedge())), "no known format"),
        (
            "glb",
            declaring(10**8),
            "declares 100000000 corners and .* numbers: simplify it to at most 2000000",
        ),
        ("glb", declaring(10**8, in_bytes=True), "declares 100000000 corners"),
        ("glb", declaring("many"), "cannot be read as GLB"),
        ("glb", repeated(100), "has 2048000 triangles: simplify it"),
        ("ply", ply_of(SQUARE, []), "no triangles"),
        ("ply", ply_of([*SQUARE[:3], (0, 0, "nan")], [(0, 1, 2)]), "infinite or not a number"),
        ("ply", ply_of([*SQUARE[:2], ("inf", 1, 0)], [(0, 1, 2)]), "infinite or not a number"),
        ("ply", ply_of([(5, 5, 5)] * 3, [(0, 1, 2)]), "0 units across"),
        ("ply", ply_of([(0, 0, 0), (1, 1, 1), (3, 3, 3)], [(0, 1, 2), (0, 0, 1)]), "has no area"),
    ],
)
def test_a_mesh_that_is_no_surface_is_refused_by_name(tmp_path, kind, data, words):
    message = scenes_refused(tmp_path / "out", with_mesh(tmp_path, data, kind))
    assert f"mine.{kind}" in message
    assert re.search(words, message)
    assert not (tmp_path / "out").exists()


def test_a_folder_is_no_mesh(tmp_path):
    (tmp_path / "shapes" / "mine.ply").mkdir(parents=True)
    assert "mine.ply cannot be read: Is a directory" in scenes_refused(
        tmp_path / "out", with_mesh(tmp_path, None)
    )


def test_a_mesh_of_too_many_triangles_says_how_many_are_allowed(tmp_path):
    count = MAX_TRIANGLES + 1
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    header += f"property float z\nelement face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    face = np.zeros(count, [("n", "u1"), ("corners", "<i4", 3)])
    face["n"], face["corners"] = 3, (0, 1, 2)
    data = header.encode() + np.array(SQUARE, "<f4").tobytes() + face.tobytes()
    message = scenes_refused(tmp_path / "out", with_mesh(tmp_path, data))
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


def test_places_that_differ_by_the_sign_of_zero_are_one_vertex(tmp_path):
    # Two squares left and right of the y axis: the second names the shared edge as -0.0.
    vertices = [(-1, -1, 0), (0.0, -1, 0), (0.0, 1, 0), (-1, 1, 0)]
    vertices += [("-0.0", -1, "-0.0"), (1, -1, 0), (1, 1, 0), ("-0.0", 1, "-0.0")]
    (tmp_path / "two.ply").write_bytes(ply_of(vertices, [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)]))
    mesh = read_mesh(tmp_path / "two.ply")
    places = [[x, y, 0] for x in (-0.5, 0, 0.5) for y in (-0.5, 0.5)]
    np.testing.assert_array_equal(mesh.vertices, places)
    assert not np.signbit(mesh.vertices[mesh.vertices == 0]).any()
    np.testing.assert_array_equal(mesh.triangles, [(0, 2, 3), (0, 3, 1), (2, 4, 5), (2, 5, 3)])


def test_vertices_and_triangles_are_those_of_a_search_one_by_one(tmp_path):
    rng = np.random.default_rng(0)
    for _ in range(30):
        vertices = rng.integers(-2, 3, (12, 3)).astype(float)  # on few places, so that many are the same
        faces = rng.integers(0, 12, (80, 3))
        (tmp_path / "random.ply").write_bytes(ply_of(vertices.tolist(), faces.tolist()))
        mesh = read_mesh(tmp_path / "random.ply")
        corners = [[tuple(vertices[corner]) for corner in face] for face in faces]
        corners = [face for face in corners if np.any(np.cross(*np.diff(face, axis=0)))]
        first = {}
        for face in corners:
            first.setdefault(frozenset(face), face)
        places = sorted({place for face in corners for place in face})
        np.testing.assert_array_equal(
            mesh.triangles, [[places.index(place) for place in face] for face in first.values()]
        )
        low, high = np.min(places, axis=0), np.max(places, axis=0)
        unit = (np.array(places) - (low + high) / 2) / (high - low).max()
        np.testing.assert_allclose(mesh.vertices, unit, atol=1e-7)


def test_the_outermost_vertices_of_a_mesh_decide_like_all_of_them(tmp_path):
    inner, outer = trimesh.creation.icosphere(subdivisions=2, radius=0.9), trimesh.creation.box((2, 2, 2))
    (tmp_path / "both.ply").write_bytes(exported(trimesh.util.concatenate([inner, outer])))
    mesh = read_mesh(tmp_path / "both.ply")
    np.testing.assert_array_equal(np.abs(mesh.vertices[mesh.outermost]), np.full((8, 3), 0.5))
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
        refused.append(impossible(cube))
        of_mesh = impossible(replace(cube, hidden_objects=(part,)), {"mesh:both.ply": mesh})
        assert of_mesh == (refused[-1] and refused[-1].replace("cube", "both.ply"))
    assert 20 < sum(reason is None for reason in refused) < 180


def test_pictures_in_a_mesh_file_are_not_unpacked(monkeypatch):
    from PIL import Image

    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.visual = trimesh.visual.TextureVisuals(
        uv=np.zeros((len(ball.vertices), 2)), image=Image.new("RGB", (8, 8))
    )
    contents = ball.export(file_type="glb")
    assert b"image/png" in contents
    monkeypatch.setattr(Image, "open", lambda *_: pytest.fail("a picture was opened"))
    _, triangles = read_triangles(contents, "glb", "ball.glb")
    assert len(triangles) == len(ball.faces)
