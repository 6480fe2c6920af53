"""A scene is loaded from its data; plain Mitsuba gets the same picture from the exported scene files."""

import ast
import re
import shutil

import numpy as np
import pytest
from source_tree import sources

from render.transport.scene_loading import SceneLoadingError, load_scene
from scenegen import open_dataset
from scenegen.triangles import MeshError, scene_triangles

COMPOSITE = "000003"


@pytest.fixture
def copy(seven_scenes, tmp_path):
    shutil.copytree(seven_scenes, tmp_path / "data")
    return open_dataset(tmp_path / "data")


@pytest.mark.parametrize(("file", "mirrored"), [("scene.xml", False), ("mirrored.xml", True)])
def test_plain_mitsuba_gets_the_same_picture_from_the_exported_file(seven_scenes, variant, file, mirrored):
    import mitsuba as mi

    dataset = open_dataset(seven_scenes)
    exported = mi.load_file(str(dataset.scene_folder(COMPOSITE) / file))
    ours = load_scene(dataset, COMPOSITE, mirrored=mirrored)
    # One path a pixel: of several, threads would add up the light in any order.
    pictures = [np.array(mi.render(scene, spp=1, seed=3)) for scene in (exported, ours)]
    assert pictures[0].shape == (18, 24, 1)
    assert pictures[0].max() > 0
    np.testing.assert_array_equal(pictures[1], pictures[0])


def test_no_code_of_ours_lets_mitsuba_open_a_scene_file():
    opening = [
        (file, node.attr)
        for file, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr in ("load_file", "load_string")
    ]
    assert [found for found in opening if not found[0].startswith("model/")] == []  # safetensors has one too


def test_shapes_keep_their_names(seven_scenes, variant):
    dataset = open_dataset(seven_scenes)
    names = [shape.id() for shape in load_scene(dataset, COMPOSITE).shapes()]
    assert names == ["relay_wall", "middle_wall", "hidden_object_0", "hidden_object_1"]
    names = [shape.id() for shape in load_scene(dataset, COMPOSITE, mirrored=True).shapes()]
    assert names == ["middle_wall", "mirrored_hidden_object_0", "mirrored_hidden_object_1"]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda mesh: b"", "cannot be read as PLY"),
        (lambda mesh: mesh[: len(mesh) // 2], "cannot be read as PLY"),
        (lambda mesh: re.sub(rb"element face \d+", b"element face 0", mesh), "no triangles|cannot be read"),
        (lambda mesh: mesh[:-4] + b"\xff\xff\xff\x7f", "names? vertices that it does not have"),
        (lambda mesh: with_first_coordinate(mesh, np.nan), "infinite or not a number"),
        (lambda mesh: with_first_coordinate(mesh, 1e30), "farther than"),
    ],
)
def test_a_mesh_that_could_crash_mitsuba_is_refused(copy, variant, damage, words):
    file = copy.scene_folder("000000") / "hidden_object_0.ply"
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(MeshError, match=words) as refused:
        load_scene(copy, "000000")
    assert str(file) in str(refused.value)


def test_a_picture_that_a_mesh_names_is_not_looked_for(copy, variant, caplog):
    file = copy.scene_folder("000000") / "hidden_object_0.ply"
    before, _ = scene_triangles(file.read_bytes(), "before")
    comment = f"comment TextureFile {file.parent / 'picture.png'}\nelement vertex".encode()
    vertices, _ = scene_triangles(file.read_bytes().replace(b"element vertex", comment, 1), "after")
    np.testing.assert_array_equal(vertices, before)
    assert caplog.text == ""


def with_first_coordinate(mesh, value):
    head, end, body = mesh.partition(b"end_header\n")
    return head + end + np.float32(value).tobytes() + body[4:]


@pytest.mark.parametrize(
    "image",
    [
        b"",
        b"Pf\n4 3\n-1.0\n",
        b"Pf\n0 0\n-1.0\n",
        b"Pf\n99999 99999\n-1.0\n1234",
        b"\x76\x2f\x31\x01 an EXR file",
    ],
)
def test_a_damaged_image_of_the_projector_is_refused(copy, variant, image):
    (copy.scene_folder("000000") / "emitter.pfm").write_bytes(image)
    with pytest.raises(SceneLoadingError, match=r"emitter\.pfm is damaged"):
        load_scene(copy, "000000")


def test_an_image_of_the_projector_is_read_from_the_bottom_row_up(copy, variant):
    import mitsuba as mi

    dark = np.ones((3, 4), "<f4")
    dark[0] = 0  # the first row of a portable float map is the lowest
    (copy.scene_folder("000000") / "emitter.pfm").write_bytes(b"Pf\n4 3\n-1.0\n" + dark.tobytes())
    exported = mi.load_file(str(copy.scene_folder("000000") / "scene.xml"))
    images = []
    for scene in (exported, load_scene(copy, "000000")):
        parameters = mi.traverse(scene)
        (name,) = (name for name in parameters.keys() if name.endswith("irradiance.data"))  # noqa: SIM118
        images.append(np.array(parameters[name]).reshape(3, 4))
    np.testing.assert_array_equal(images[1], images[0])
    assert images[0].sum(axis=1).tolist() == [4, 4, 0]
