"""The batched engine against the many-light renderer, closed forms, and itself in other batches."""

import itertools
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from batch_quadrature import CubeLight, Sides
from numpy.linalg import norm

from disk.preset_files import read_settings
from itof import TransientLayout, pixel_rays
from render.batch.candidates import CandidateLight
from render.batch.chebyshev import chebyshev, interpolation
from render.batch.light import BatchedLight
from scenegen import load_preset, preset_from_dict
from scenegen.geometry_check import refusal
from scenegen.making.outlines import clipped
from scenegen.pose import camera_axes
from scenegen.possible_scenes import sample_valid_scene
from scenegen.unit_meshes import UnitMesh, unit_mesh

HZ = (20e6, 50e6, 60e6)
WIDTH, HEIGHT = 40, 30
MANY = {"count": 14, "seed": 9}  # corners of the preset any-corner; four show the middle wall's edge


@pytest.fixture(scope="module")
def corners(make_dataset):
    """Fourteen scenes of many corners: two of each shape, and two composites."""
    data, _ = read_settings("presets", "any-corner")
    return make_dataset(data | {"dataset": MANY})


@pytest.fixture(scope="module")
def light():
    return BatchedLight(HZ, WIDTH, HEIGHT, error=0.02, device="cpu")


@pytest.fixture(scope="module")
def images(light, corners):
    return light.images([corners.scene(scene_id) for scene_id in corners.ids()])


@pytest.fixture(scope="module")
def rendered(corners, variant):
    """Phasors by many lights, and the mirrored depth, of the first seven scenes."""
    from render.options import ManyLightOptions
    from render.transport.many_light import ManyLight
    from render.transport.method import View
    from render.transport.mirrored import trace_ground_truth
    from render.transport.scene_loading import load_scene

    view = View(TransientLayout(WIDTH, HEIGHT, 2000, 0.01, 0.0), HZ, 3, 5)
    method = ManyLight(ManyLightOptions(lights=1024), variant)
    found = []
    for scene_id in corners.ids()[:7]:
        phasors = method.expose(load_scene(corners, scene_id), view).phasors()
        truth = trace_ground_truth(load_scene(corners, scene_id, mirrored=True), WIDTH, HEIGHT, HZ[0])
        found.append((phasors, truth))
    return found


def drawn(preset, count, seed):
    """Scenes of a preset, drawn without Blender."""
    preset = replace(preset, dataset=replace(preset.dataset, seed=seed))
    return [sample_valid_scene(preset, index, refusal) for index in range(count)]


def test_the_sums_over_film_and_surface_run_once_for_all_frequencies():
    import drjit as dr

    scenes = drawn(load_preset("paper"), 2, seed=1)
    for frequencies_hz in (HZ[:1], HZ):
        engine = BatchedLight(frequencies_hz, WIDTH, HEIGHT, error=1.0, device="cpu")  # of one round
        engine.images(scenes)  # makes the tables of rough walls
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            engine.images(scenes)
            kernels = dr.kernel_history()
        # Two sums over two sets of nodes, direct return, depth; smaller kernels write numbers into tables.
        assert sum((each.get("operation_count") or 0) > 200 for each in kernels) == 6


@pytest.mark.parametrize("index", range(7))
def test_the_light_is_that_of_the_renderer_to_the_wanted_error(images, rendered, index):
    hidden, direct = rendered[index][0].hidden, rendered[index][0].direct
    lights = 0.016  # error of 1024 lights
    assert norm(images.hidden[index] - hidden) / norm(hidden) < images.error[index] + lights
    assert images.error[index] <= 0.02
    # 2 % of the hidden light: the renderer divides pixels that an edge crosses, and these lines are exact
    assert norm(images.direct[index] - direct) / norm(hidden) < 0.02


@pytest.mark.parametrize("index", range(7))
def test_the_mirrored_depth_is_that_of_the_renderer(images, rendered, index):
    truth = rendered[index][1]
    found = images.radial_depth_m[index]
    assert np.array_equal(found > 0, truth.mask)
    assert np.abs(found - truth.radial_depth_m).max() < 1e-4  # metres: float32 in both


def test_some_of_these_corners_show_the_middle_wall(images):
    shows_edge = [(image == 0).any() for image in images.direct[..., 0]]
    assert 2 <= sum(shows_edge) < len(shows_edge)


def test_a_scene_has_the_same_bits_in_any_batch(light, images, corners):
    scenes = [corners.scene(scene_id) for scene_id in corners.ids()]
    other = light.images(scenes[::-1][:5])
    alone = light.images(scenes[-1:])
    for name in ("direct", "hidden", "radial_depth_m", "error"):
        expected = getattr(images, name)
        assert np.array_equal(getattr(other, name), expected[::-1][:5])
        assert np.array_equal(getattr(alone, name), expected[-1:])


COMPILED = """
import drjit as dr
from render.batch.light import BatchedLight
from scenegen import load_preset
from scenegen.geometry_check import refusal
from scenegen.possible_scenes import sample_valid_scene

light = BatchedLight((20e6, 50e6, 60e6), 40, 30, error=0.02, device="cpu")
dr.set_flag(dr.JitFlag.KernelHistory, True)
for first in (0, 20):
    dr.kernel_history_clear()
    scenes = range(first, first + 6 + first // 20)
    light.images([sample_valid_scene(load_preset("any-corner"), index, refusal) for index in scenes])
    print(*sorted({entry["hash"] for entry in dr.kernel_history([dr.KernelType.JIT])}))
"""


@pytest.mark.long
def test_another_batch_has_the_same_kernels():
    """In a process of its own: the history of kernels changes what is computed after it."""
    done = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True, check=True)
    first, second = (set(line.split()) for line in done.stdout.splitlines())
    assert second
    assert second <= first


@pytest.fixture(scope="module")
def cubes():
    """Scenes with one cube and a diffuse wall that darkens, in twelve corners far from the paper's.

    The camera is rolled about its axis in half of them, so that edges are upright or level.
    """
    data, _ = read_settings("presets", "any-corner")
    wall = {"material": "diffuse", "reflectance": 0.9, "least_reflectance": 0.3}
    spread = {"location_m": 0.4, "rotation_deg": 8.0, "horizontal_fov_deg": 8.0}
    one_cube = data["hidden_object"] | {"shapes": ["cube"], "composite_fraction": 0.0}
    changed = {"relay_wall": wall, "camera_spread": spread, "hidden_object": one_cube}
    cameras = ({"rotation_deg": [90.0, roll_deg, 50.0]} for roll_deg in (0.0, 85.0))
    presets = (preset_from_dict(data | changed | {"camera": camera}, "test") for camera in cameras)
    return [scene for preset in presets for scene in drawn(preset, 6, 3)]


def test_an_independent_quadrature_agrees_in_twelve_corners(light, cubes):
    images = light.images(cubes)
    shows_edge = [(image == 0).any() for image in images.direct[..., 0]]
    assert 3 <= sum(shows_edge) < 12  # a quarter of them, at least
    for scene, direct, hidden, error in zip(cubes, images.direct, images.hidden, images.error, strict=True):
        coarse, fine = (
            CubeLight(scene, HZ, cells, nodes).over_direct(WIDTH, HEIGHT)
            for cells, nodes in ((8, 6), (12, 9))
        )
        seen = np.isfinite(fine[..., 0]) & (direct[..., 0] != 0)
        weight = np.abs(direct[seen])  # errors count as in the image
        expected, change = fine[seen] * weight, (fine - coarse)[seen] * weight
        found = (hidden[seen] / direct[seen]) * weight
        # The error of even cells falls with at least the first power of their number: it is 12 / 8 - 1 = 1/2
        # of that of the finer ones from one to the other, and so less than twice the change.
        allowed = np.hypot(error, 2 * norm(change) / norm(expected))
        assert norm(found - expected) / norm(expected) < allowed


def test_pixels_that_the_edge_of_the_middle_wall_crosses_have_the_light_of_their_free_part(cubes):
    """The free part is a polygon. Light of 1 kHz has a phase of 4e-4 rad at most, its square is 2e-7."""
    pixels, light = 0, BatchedLight((1e3,), WIDTH, HEIGHT, error=0.1, device="cpu")
    for scene, image in zip(cubes, light.images(cubes).direct[..., 0], strict=True):
        model, edge = CubeLight(scene, (1e3,), 1, 1), middle_edge(scene)
        x, y = model.centres(WIDTH, HEIGHT)
        wide = x[0, 1] - x[0, 0]
        for row, column in np.ndindex(HEIGHT, WIDTH):
            middle = np.array([x[row, column], y[row, column], 1])
            square = middle + np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * wide / 2
            free = clipped(square, [(np.zeros(3), edge)])
            is_cut = len(set((square @ edge > 0).tolist())) == 2
            if is_cut and len(free) > 2 and model.direct(*inner(free)[:, :2].T).all():  # no other edge
                expected = integral(free, model.direct) / wide**2
                # Rounding of float32, and of a line that may end 1e-6 of the film beside the edge.
                assert abs(image[row, column]) == pytest.approx(
                    expected, rel=1e-4, abs=1e-5 * abs(image).max()
                )
                pixels += 1
    assert pixels > 30


def integral(polygon, function):
    """Integral over a convex polygon in the plane z = 1: triangles, each of 16 with a rule of degree 2."""
    total = 0.0
    for one, two in itertools.pairwise(polygon[1:]):
        for three in fourths(np.stack([polygon[0], one, two]), 2):
            area = norm(np.cross(three[1] - three[0], three[2] - three[0])) / 2
            middles = inner((three + np.roll(three, 1, axis=0)) / 2)
            total += area * function(*middles[:, :2].T).mean()
    return total


def inner(points):
    """The points of a polygon, moved off its edge."""
    return points + 1e-9 * (points.mean(0) - points)


def fourths(triangle, times):
    """The triangle (3, 3), divided into four so many times."""
    if not times:
        return [triangle]
    middles = (triangle + np.roll(triangle, -1, axis=0)) / 2
    parts = [np.stack([triangle[n], middles[n], middles[n - 1]]) for n in range(3)]
    return [each for part in (*parts, middles) for each in fourths(part, times - 1)]


def middle_edge(scene):
    """(3,) normal, in camera axes, of the plane through the camera and the middle wall's edge at the gap.

    It points to what is free.
    """
    wall, axes = Sides(scene.middle_wall), camera_axes(scene.camera)
    ends = [wall.middle - wall.half[0] * wall.right + side * wall.half[1] * wall.up for side in (-1, 1)]
    one, two, inside = (axes @ (point - scene.camera.location_m) for point in (*ends, wall.middle))
    normal = np.cross(one, two)
    return normal * -np.sign(normal @ inside)


@pytest.mark.parametrize("shape", ["cube", "concave_plane"])
def test_a_user_mesh_shines_like_the_primitive_of_its_form(shape):
    preset = preset_from_dict(
        {
            "hidden_object": {
                "shapes": [shape],
                "composite_fraction": 0.0,
                "size_m": {shape: [0.5, 0.5, 0.5], "mesh": 0.5},
            }
        },
        "test",
    )
    scenes = drawn(preset, 3, 8)
    mesh = unit_mesh(shape)
    named = [
        replace(scene, hidden_objects=tuple(replace(p, shape="mesh:own.ply") for p in scene.hidden_objects))
        for scene in scenes
    ]
    light = BatchedLight(
        *(HZ, WIDTH, HEIGHT),
        error=0.02,
        device="cpu",
        meshes={"mesh:own.ply": UnitMesh(mesh.vertices, mesh.triangles, mesh.outermost)},
    )
    one, other = light.images(scenes), light.images(named)
    assert (
        np.abs(one.radial_depth_m - other.radial_depth_m).max() < 1e-5
    )  # metres: another cell rounds otherwise
    for a, b in zip(one.hidden, other.hidden, strict=True):
        assert norm(a - b) / norm(a) < 0.03  # 2 % each, independently


def test_twice_the_reflectance_is_twice_the_hidden_light(light):
    scenes = drawn(load_preset("any-corner"), 7, 4)
    half = [
        replace(
            scene,
            hidden_objects=tuple(replace(p, reflectance=p.reflectance / 2) for p in scene.hidden_objects),
        )
        for scene in scenes
    ]
    one, other = light.images(scenes).hidden, light.images(half).hidden
    assert np.allclose(one, 2 * other, rtol=1e-5, atol=1e-5 * np.abs(one).max())


def test_candidates_have_the_hidden_light_of_images(light, images, corners):
    candidates = CandidateLight(HZ, device="cpu", threads=1)
    errors = {True: [], False: []}
    for index, scene_id in enumerate(corners.ids()):
        scene, direct = corners.scene(scene_id), images.direct[index]
        seen = (direct[..., 0] != 0) & (np.abs(images.hidden[index][..., 0]) > 0)
        rays = pixel_rays(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg)[seen]
        expected, weight = images.hidden[index][seen] / direct[seen], np.abs(direct[seen])
        for fine, found in errors.items():
            (ratio,) = candidates.over_direct([scene], rays, fine=fine)
            error = norm((ratio - expected) * weight) / norm(expected * weight)
            found.append(error / (2 if len(scene.hidden_objects) > 1 and not fine else 1))
    # Both err: the images by 2 % at most, the candidates by 1 and 3 %, or 6 % of several objects.
    assert max(errors[True]) < np.hypot(0.02, 0.01)
    assert max(errors[False]) < np.hypot(0.02, 0.03)


def test_a_roughness_between_those_of_the_tables_is_mixed(light):
    (scene,) = drawn(load_preset("any-corner"), 1, 3)
    scene = replace(scene, relay_wall=replace(scene.relay_wall, material="rough", roughness=0.475))
    exact = light.images([scene])
    rays = pixel_rays(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg).reshape(-1, 3)
    (mixed,) = CandidateLight(HZ, device="cpu", threads=1).over_direct([scene], rays, fine=True)
    expected = (exact.hidden[0] / exact.direct[0]).reshape(-1, 3)
    # 2 % that the engine may be off by, and 1 % that mixing may add
    assert norm(mixed - expected) / norm(expected) < np.hypot(0.02, 0.01)


UPRIGHT = {  # as high as a child; the horizons of their faces cross the wall along a line of the image
    "shapes": ["cube", "cylinder", "sphere"],
    "size_m": {"cube": [0.12, 0.18, 0.88], "cylinder": [0.15, 0.5, 1.0], "sphere": [0.2, 0.3, 0.9]},
    "rotation_deg": {"x": 0, "y": 0},
    "location_m": {"x": [0.9, 1.5], "y": [0.5, 1.5], "z": [0.6, 1.0]},
}
GLOSSY = {"hidden_object": UPRIGHT, "relay_wall": {"roughness": [0.15]}}


@pytest.mark.long
@pytest.mark.parametrize("changed", [{}, GLOSSY])
def test_bounds_hold(changed):
    """Against the same engine with a tenth of the error, 95 % of the scenes are within their bound."""
    tables, _ = read_settings("presets", "any-corner")
    scenes = drawn(preset_from_dict(tables | changed, "test"), 21, 6)
    images = {
        error: BatchedLight(HZ, WIDTH, HEIGHT, error=error, device="cpu").images(scenes)
        for error in (0.04, 0.01, 0.004)
    }
    finer = images.pop(0.004).hidden
    for error, found in images.items():
        assert (found.error <= error).all()
        errors = [norm(a - b) / norm(b) for a, b in zip(found.hidden, finer, strict=True)]
        # of 21: 5 % of them, and two standard deviations
        assert np.count_nonzero(np.array(errors) > found.error) <= 3, error


@pytest.mark.parametrize("count", [6, 13, 40])
def test_polynomials_end_with_the_wall_that_an_image_shows(count):
    """Beside it they would be divided by sums that cancel: such images had values that are none."""
    beyond = np.array([-50.0, -1.9, -1.0, 1.0, 1.97, 50.0])
    shares = interpolation(count, beyond)
    np.testing.assert_allclose(shares[:3], shares[2:3].repeat(3, axis=0), atol=0)
    np.testing.assert_allclose(shares[3:], shares[3:4].repeat(3, axis=0), atol=0)
    places, _ = chebyshev(count)
    np.testing.assert_allclose(shares @ places, np.clip(beyond, -1, 1), atol=1e-12)  # exact for lines
