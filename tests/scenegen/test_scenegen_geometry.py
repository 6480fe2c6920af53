"""Drawing scenes without Blender: the meshes of the primitives, and the check that a scene is possible."""

from collections import Counter

import numpy as np
import pytest
import trimesh
from scene_folders import upright_cube, with_object
from scipy.spatial import KDTree

from scenegen import load_preset, preset_from_dict, sample_scene
from scenegen.geometry_check import refusal
from scenegen.making.meshes import read_mesh
from scenegen.shapes import PRIMITIVES
from scenegen.unit_meshes import unit_mesh

MESH = "mesh:mine.ply"


@pytest.fixture(scope="module")
def upright():
    return upright_cube()


@pytest.fixture(scope="module")
def maker_with_mesh(tmp_path_factory):
    """A Blender that knows a mesh that is not convex."""
    from scenegen.making.blender import BlenderMaker

    ball, box = trimesh.creation.icosphere(subdivisions=1, radius=0.6), trimesh.creation.box((1, 2, 0.5))
    file = tmp_path_factory.mktemp("mesh") / "mine.ply"
    file.write_bytes(trimesh.util.concatenate([ball, box]).export(file_type="ply"))
    return BlenderMaker({MESH: read_mesh(file)})


def each_from_its_smallest(triangles):
    turned = [np.roll(triangle, -np.argmin(triangle)).tolist() for triangle in triangles]
    return sorted(turned)


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_unit_meshes_have_the_vertices_and_the_triangles_of_blender_with_their_winding(maker, shape):
    from scenegen.making.blender_shapes import primitive

    blenders, mesh = primitive(shape), unit_mesh(shape)
    blenders.calc_loop_triangles()
    vertices = np.array([vertex.co for vertex in blenders.vertices])
    triangles = np.array([triangle.vertices for triangle in blenders.loop_triangles])
    distance, ours = KDTree(mesh.vertices).query(vertices)
    assert distance.max() < 1e-6  # Blender's sphere is rounded several times in float32
    assert sorted(ours) == list(range(len(mesh.vertices)))
    assert each_from_its_smallest(ours[triangles]) == each_from_its_smallest(mesh.triangles)


@pytest.mark.parametrize("shape", [shape for shape in PRIMITIVES if shape != "concave_plane"])
def test_unit_meshes_of_solids_are_closed_with_their_outside_out(shape):
    mesh = unit_mesh(shape)
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume > 0


def test_unit_meshes_are_made_once_and_cannot_be_written():
    mesh = unit_mesh("sphere")
    assert unit_mesh("sphere") is mesh
    for array in (mesh.vertices, mesh.triangles, mesh.outermost, mesh.hull):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("location_m", "reason"),
    [
        ((0.2, 0.9, 1.6), "through the relay wall"),
        ((1.15, 0.2, 1.6), "beside the middle wall"),  # reaches through it
        ((0.5, 0.4, 1.6), "beside the middle wall"),
        ((1.15, -0.7, 1.6), "beside the middle wall"),  # on the camera's side
        ((1.15, 0.9, 7.0), "beside the middle wall"),  # looks over its top
    ],
)
def test_an_object_that_could_be_seen_or_meets_a_wall_is_refused(upright, location_m, reason):
    assert reason in refusal(with_object(upright, location_m=location_m))


def test_an_object_behind_the_middle_wall_is_accepted(upright):
    assert refusal(upright) is None


def test_the_check_agrees_with_the_shadow_of_the_wall_computed_by_hand(upright):
    # A point (x, y) behind the wall is hidden when its sight line meets y = 0 at x in [0.7, 4].
    rng = np.random.default_rng(2)
    camera = np.array([1.0, -1.0])
    for _ in range(200):
        x, y = rng.uniform([0.05, 0.05], [2.0, 1.5])
        small = with_object(upright, location_m=(x, y, 1.6), size_m=(1e-4, 1e-4, 1e-4))
        crossing = camera[0] + (x - camera[0]) * -camera[1] / (y - camera[1])
        if abs(crossing - 0.7) > 1e-3:
            assert (refusal(small) is None) == (crossing > 0.7)


def random_corner(rng):
    """A preset with other walls, objects and cameras; in half of the cases reflected in the middle wall."""
    side = float(rng.choice([-1, 1]))

    def near(*centre, by):
        return [value + by * float(rng.uniform(-1, 1)) for value in centre]

    return preset_from_dict(
        {
            "dataset": {"seed": int(rng.integers(2**32))},
            "hidden_object": {
                "shapes": [*PRIMITIVES, MESH],
                "location_m": {"x": [0.3, 1.7], "y": sorted([0.4 * side, 1.6 * side]), "z": [0.8, 2.6]},
            },
            "relay_wall": {"location_m": near(0.4, 0, 2, by=0.4), "rotation_deg": near(0, 90, 0, by=10)},
            "middle_wall": {
                "size_m": near(3, 3.5, by=0.7),
                "location_m": near(2.35, 0, 2, by=0.3),
                "rotation_deg": near(90 * rng.choice([-1, 1]), 0, 0, by=15),
            },
            "camera": {"location_m": near(1, -1.5 * side, 1.65, by=0.4)},
            "camera_spread": {"location_m": 0.3},
        },
        "random corner",
    )


def verdicts(maker, presets, scenes_each):
    """How often each sentence is said, without the object's name, after the rays have said the same."""
    from blender_ray_cast import ray_cast_refusal

    said = Counter()
    for preset in presets:
        for number in range(scenes_each):
            scene = sample_scene(preset, *divmod(number, 4))
            reason = refusal(scene, maker.meshes)
            assert reason == ray_cast_refusal(maker, scene), scene
            said[reason and reason.partition(") ")[2]] += 1
    return said


def test_the_check_says_what_rays_in_blender_say(maker_with_mesh):
    rng = np.random.default_rng(3)
    said = verdicts(maker_with_mesh, [random_corner(rng) for _ in range(15)], 20)
    assert len(said) == 3
    assert min(said.values()) > 15


@pytest.mark.long
def test_the_check_says_what_rays_in_blender_say_of_ten_thousand_scenes(maker_with_mesh, paper):
    rng = np.random.default_rng(4)
    said = verdicts(maker_with_mesh, [paper, load_preset("any-corner")], 2500)
    said += verdicts(maker_with_mesh, [random_corner(rng) for _ in range(250)], 20)
    assert said.total() == 10_000
    assert len(said) == 3
    assert min(said.values()) > 500
