"""Relay walls that get darker towards one side: drawn, stored, loaded, rendered, refused where damaged."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from many_light_scenes import SMALL, assert_agrees_with_paths, measure, path_phasors
from night_commands import night_here, refusal
from render_runs import render_scenes
from spread_cameras import preset, preset_text

from itof import pixel_rays
from render.transport.scene_loading import SceneLoadingError, load_scene
from scenegen import camera_axes, open_dataset, rotation_matrix, sample_scene, scene_to_json, wall_normal
from scenegen.scene_folder import differences
from scenegen.triangles import MeshError

DARK = {
    "dataset": {"count": 2, "seed": 3},
    "relay_wall": {"least_reflectance": 0.0, "reflectance": 0.9, "material": "diffuse", "size_m": (4.0, 4.0)},
    "camera": {"width": SMALL.width, "height": SMALL.height},
}
PLAIN = DARK | {"relay_wall": {k: v for k, v in DARK["relay_wall"].items() if k != "least_reflectance"}}


@pytest.fixture(scope="module")
def dark(make_dataset):
    return make_dataset(DARK)


@pytest.fixture
def copied(dark, tmp_path):
    shutil.copytree(dark.root, tmp_path / "data")
    return open_dataset(tmp_path / "data")


def reflectance_at(wall, points):
    """Reflectance of a wall at points (..., 3), from what `Darkening` says: linear between two corners."""
    angle = np.radians(wall.darkening.direction_deg)
    turned = rotation_matrix(wall.rotation_deg)
    fall = turned[:, 0] * np.cos(angle) + turned[:, 1] * np.sin(angle)
    corners = [
        wall.location_m + x * wall.size_m[0] / 2 * turned[:, 0] + y * wall.size_m[1] / 2 * turned[:, 1]
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    along = sorted(corner @ fall for corner in corners)
    ends = wall.reflectance, wall.darkening.least_reflectance
    return np.interp(points @ fall, [along[0], along[-1]], ends)


def seen_places(scene, width, height):
    """(H, W, 3) where the centres of pixels see the wall, metres."""
    rays = pixel_rays(width, height, scene.camera.horizontal_fov_deg) @ camera_axes(scene.camera)
    normal, camera_m = wall_normal(scene.relay_wall), np.array(scene.camera.location_m)
    distance_m = ((np.array(scene.relay_wall.location_m) - camera_m) @ normal) / (rays @ normal)
    return camera_m + rays * distance_m[..., None]


def test_each_scene_draws_how_dark_its_wall_gets_and_where():
    chosen = preset(relay_wall={"least_reflectance": 0.2, "reflectance": 0.8})
    scenes = [sample_scene(chosen, index) for index in range(400)]
    least = np.array([scene.relay_wall.darkening.least_reflectance for scene in scenes])
    turns = np.array([scene.relay_wall.darkening.direction_deg for scene in scenes])
    # All of 400 draws miss a sixtieth of the range with the probability (59 / 60)^400 = 1e-3.
    assert 0.2 <= least.min() < 0.21
    assert 0.79 < least.max() <= 0.8
    # Evenly: four standard errors of the mean, and of the mean direction.
    assert least.mean() == pytest.approx(0.5, abs=4 * 0.6 / np.sqrt(12 * len(scenes)))
    assert abs(np.exp(1j * np.radians(turns)).mean()) < 4 / np.sqrt(len(scenes))
    same = sample_scene(preset(relay_wall={"reflectance": 0.8}), 7)
    assert replace(scenes[7], relay_wall=replace(scenes[7].relay_wall, darkening=None)) == same
    assert "darkening" not in scene_to_json(same)


def test_a_least_reflectance_above_the_largest_is_refused(tmp_path):
    file = tmp_path / "p.toml"
    file.write_text(preset_text(relay_wall={"least_reflectance": 0.9, "reflectance": 0.5}))
    assert "relay_wall.least_reflectance is 0.9, above relay_wall.reflectance = 0.5" in refusal(
        "night-gen", "scenes", tmp_path / "data", "--preset", file
    )


@pytest.mark.parametrize("scene_id", ["000000", "000001"])
def test_the_wall_reflects_what_its_darkening_says_also_in_plain_mitsuba(dark, variant, scene_id):
    import mitsuba as mi

    from render.transport.kernels.arrays import upload
    from render.transport.kernels.rays import camera_hits

    scene = dark.scene(scene_id)
    expected = reflectance_at(scene.relay_wall, seen_places(scene, 12, 9))
    assert np.ptp(expected) > 0.05
    x, y = np.meshgrid((np.arange(12) + 0.5) / 12, (np.arange(9) + 0.5) / 9)
    exported = mi.load_file(str(dark.scene_folder(scene_id) / "scene.xml"))
    for loaded in (load_scene(dark, scene_id), exported):
        si = camera_hits(loaded, upload(x.ravel()), upload(y.ravel()))
        found = np.array(si.bsdf().eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1))).reshape(9, 12) * np.pi
        np.testing.assert_allclose(found, expected, rtol=1e-4)  # float32 texture coordinates
    assert load_scene(dark, scene_id, mirrored=True) is not None  # which has no relay wall


def test_the_direct_return_is_that_of_a_uniform_wall_times_the_reflectance(dark, make_dataset, variant):
    uniform = make_dataset(PLAIN)
    for scene_id in dark.ids():
        scene = dark.scene(scene_id)
        darker, plain = (
            measure(load_scene(each, scene_id), variant, layout=SMALL) for each in (dark, uniform)
        )
        ratio = darker.direct / plain.direct
        expected = reflectance_at(scene.relay_wall, seen_places(scene, 12, 9)) / scene.relay_wall.reflectance
        # Within a pixel of 12 x 9, reflectance and brightness vary together by a few percent.
        np.testing.assert_allclose(ratio.real, np.broadcast_to(expected[..., None], ratio.shape), rtol=0.02)
        assert np.abs(np.angle(ratio)).max() < 0.02
        # The hidden light is reflected twice by the wall, at places between its brightest and its darkest.
        share = np.abs(darker.hidden).sum() / np.abs(plain.hidden).sum()
        assert expected.min() ** 2 < share < expected.max() ** 2


@pytest.mark.long
@pytest.mark.parametrize("material", ["diffuse", "rough"])
def test_many_lights_agree_with_the_path_tracer_on_a_darkening_wall(make_dataset, variant, material):
    wall = DARK["relay_wall"] | {"material": material}
    scene = load_scene(make_dataset(DARK | {"relay_wall": wall}), "000000")
    image = measure(scene, variant, layout=SMALL)
    assert_agrees_with_paths(image, path_phasors(scene, variant, seeds=range(12), spp=2048, layout=SMALL))


@pytest.mark.parametrize(
    ("damage", "error", "words"),
    [
        (lambda f: (f / "relay_wall.pfm").unlink(), SceneLoadingError, r"relay_wall\.pfm is missing"),
        (
            lambda f: (f / "relay_wall.pfm").write_bytes(b"Pf"),
            SceneLoadingError,
            r"relay_wall\.pfm is damaged",
        ),
        (lambda f: put_image(f, [0.9, np.nan]), SceneLoadingError, "has a reflectance outside 0 to 1"),
        (lambda f: put_image(f, [0.9, 7.0]), SceneLoadingError, "has a reflectance outside 0 to 1"),
        (
            lambda f: shutil.copy(f / "middle_wall.ply", f / "relay_wall.ply"),
            MeshError,
            "no texture coordinates",
        ),
    ],
    ids=["missing", "cut", "nan", "seven", "mesh"],
)
def test_damaged_files_of_a_darkening_wall_are_refused(copied, variant, damage, error, words):
    folder = copied.scene_folder("000000")
    damage(folder)
    with pytest.raises(error, match=words) as refused:
        load_scene(copied, "000000")
    assert str(folder) in str(refused.value)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / "relay_wall.pfm").unlink(), "relay_wall.pfm is missing"),
        (lambda folder: put_image(folder, [0.9, 0.5]), "relay_wall.pfm was changed"),
    ],
)
def test_a_changed_image_of_the_wall_is_named(copied, damage, words):
    folder = copied.scene_folder("000000")
    damage(folder)
    assert words in differences(folder)


def test_an_image_where_the_wall_is_uniform_is_not_one_of_its_files(make_dataset, tmp_path):
    folder = shutil.copytree(make_dataset(PLAIN).scene_folder("000000"), tmp_path / "000000")
    assert re.search("was changed$", differences(folder))
    put_image(folder, [0.9, 0.5])
    assert "relay_wall.pfm is not one of its files" in differences(folder)


def test_a_dataset_of_darkening_walls_is_rendered_and_verified(copied):
    render_scenes(copied.root, product="itof", resolution=(12, 9), lights=256)
    done = night_here("night-render", "verify", copied.root)
    assert done.returncode == 0, done.stdout + done.stderr


def put_image(folder, pixels):
    contents = b"Pf\n2 1\n-1.0\n" + np.array(pixels, "<f4").tobytes()
    (folder / "relay_wall.pfm").write_bytes(contents)
