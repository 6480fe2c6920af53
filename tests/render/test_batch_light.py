"""The batched engine against the many-light renderer, closed forms, and itself in other batches."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm

from disk.preset_files import read_settings
from itof import TransientLayout, direct_phasors
from render.batch.light import BatchedLight
from scenegen import load_preset, preset_from_dict
from scenegen.geometry_check import refusal
from scenegen.pose import wall_geometry
from scenegen.sampling import sample_valid_scene
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
    method = ManyLight(ManyLightOptions(lights=4096), variant)
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


@pytest.mark.parametrize("index", range(7))
def test_the_light_is_that_of_the_renderer_to_the_wanted_error(images, rendered, index):
    hidden, direct = rendered[index][0].hidden, rendered[index][0].direct
    lights = 0.008  # error of 4096 lights
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
from scenegen.sampling import sample_valid_scene

light = BatchedLight((20e6, 50e6, 60e6), 40, 30, error=0.02, device="cpu")
dr.set_flag(dr.JitFlag.KernelHistory, True)
for first in (0, 20):
    dr.kernel_history_clear()
    scenes = range(first, first + 6 + first // 20)
    light.images([sample_valid_scene(load_preset("any-corner"), index, refusal) for index in scenes])
    print(*sorted({entry["hash"] for entry in dr.kernel_history([dr.KernelType.JIT])}))
"""


def test_another_batch_has_the_same_kernels():
    """In a process of its own: the history of kernels changes what is computed after it."""
    done = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True, check=True)
    first, second = (set(line.split()) for line in done.stdout.splitlines())
    assert second
    assert second <= first


def test_a_diffuse_wall_returns_the_closed_form():
    preset = preset_from_dict({"relay_wall": {"material": "diffuse", "reflectance": 0.7}}, "test")
    (scene,) = drawn(preset, 1, 3)
    found = BatchedLight(HZ, WIDTH, HEIGHT, error=0.1, device="cpu").images([scene]).direct[0]
    geometry = wall_geometry(scene.camera, scene.relay_wall)
    fov_deg, *place = geometry.values()
    at_centres = direct_phasors(WIDTH, HEIGHT, fov_deg, HZ, *place)
    scale = np.vdot(at_centres, found) / np.vdot(at_centres, at_centres)
    assert scale.real == pytest.approx(0.7, rel=1e-3)  # π E ρ / π: a projector of 1 W/m² on a wall of ρ / π


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


@pytest.mark.parametrize("error", [0.04, 0.01])
def test_smaller_errors_are_kept(error):
    """Against the same engine with a tenth of the error, 95 % of the scenes are within the wanted error."""
    scenes = drawn(load_preset("any-corner"), 21, 6)
    found, finer = (
        BatchedLight(HZ, WIDTH, HEIGHT, error=e, device="cpu").images(scenes) for e in (error, 0.004)
    )
    errors = [norm(a - b) / norm(b) for a, b in zip(found.hidden, finer.hidden, strict=True)]
    assert np.count_nonzero(np.array(errors) > error) <= 3  # of 21: 5 % of them, and two standard deviations
