"""Renders against closed forms, conservation laws and geometry, read back from the EXR files."""

import dataclasses
import shutil

import numpy as np
import pytest
import trimesh

from disk import NightError
from itof import (
    TransientLayout,
    TransientReader,
    depth_from_phase,
    direct_phasors,
    phase,
    phase_per_metre,
    phasors,
    pixel_rays,
    read_image,
)
from render.farm.inventory import Inventory
from render.options import PathOptions
from render.rendering import Renderer
from render.settings import RenderError, RenderSettings
from render.transport.method import View
from render.transport.path_tracer import PathTracer
from render.transport.scene_loading import load_scene
from scenegen import Dataset, camera_axes, wall_normal

WIDTH, HEIGHT = 32, 24
CAMERA = {"width": WIDTH, "height": HEIGHT}
FREQUENCIES_HZ = (20e6, 50e6, 60e6)
PLACE = {"location_m": {"x": [1.15, 1.15], "y": [0.9, 0.9], "z": [1.6, 1.6]}}
LAYOUT = TransientLayout(WIDTH, HEIGHT, 1500, 0.01, 0.0)


def one_scene(make_dataset, shape, **sections):
    hidden = {"shapes": [shape], "composite_fraction": 0, **PLACE}
    return make_dataset({"dataset": {"count": 1}, "hidden_object": hidden, "camera": CAMERA, **sections})


def load(dataset, **which):
    return load_scene(dataset, "000000", **which)


def measure(scene, spp, variant, *, max_bounces=3, seed=1, layout=LAYOUT):
    view = View(layout, FREQUENCIES_HZ, max_bounces, seed)
    return np.concatenate(list(PathTracer(PathOptions(spp=spp), variant).expose(scene, view).row_blocks()))


def path_settings(spp, **others):
    return RenderSettings(product="both", options=PathOptions(spp=spp), device="cpu", **others)


@pytest.fixture(scope="module")
def diffuse_sphere(make_dataset):
    return one_scene(make_dataset, "sphere", relay_wall={"material": "diffuse"})


@pytest.fixture(scope="module")
def rough_cube(make_dataset):
    return one_scene(make_dataset, "cube", relay_wall={"roughness": [0.3]})


@pytest.fixture(scope="module")
def rendered(diffuse_sphere):
    """The diffuse wall with a sphere behind the corner, one bounce, through the whole renderer."""
    index = diffuse_sphere.index
    transient = dataclasses.replace(index.preset.transient, max_bounces=1, bin_count=1500)
    preset = dataclasses.replace(index.preset, transient=transient)
    dataset = Dataset(diffuse_sphere.root, dataclasses.replace(index, preset=preset))
    Renderer(dataset, path_settings(256)).render("000000")
    return dataset


def exact_direct(dataset, frequencies_hz, subpixels=16):
    scene = dataset.scene("000000")
    camera, wall = scene.camera, scene.relay_wall
    return direct_phasors(
        WIDTH,
        HEIGHT,
        camera.horizontal_fov_deg,
        frequencies_hz,
        camera_axes(camera),
        camera.location_m,
        wall.location_m,
        wall_normal(wall),
        subpixels=subpixels,
    )


def test_the_direct_return_of_a_diffuse_wall_has_its_closed_form_value_in_every_pixel(rendered):
    with TransientReader(rendered.render_folder("000000") / "transient.exr") as reader:
        radiance = np.concatenate(list(reader.row_blocks())).sum(axis=-1, dtype=np.float64)
    # A frequency of 1 Hz has no phase: its phasor is the energy. 256 jittered strata in a pixel over which
    # the radiance varies by 15 % leave 0.15 / sqrt(12) / 256^(3/4) = 7e-4 at most (one sigma).
    expected = np.abs(exact_direct(rendered, [1.0])[..., 0])
    np.testing.assert_allclose(radiance, expected, rtol=5 * 7e-4)
    assert radiance.sum() == pytest.approx(expected.sum(), rel=5 * 7e-4 / np.sqrt(WIDTH * HEIGHT))


def test_the_direct_return_has_its_closed_form_path_length_in_every_pixel(rendered):
    z, frequencies_hz = read_image(rendered.render_folder("000000") / "itof.exr").phasors()
    error_rad = np.angle(z / exact_direct(rendered, frequencies_hz))
    # Paths within a pixel spread over 0.2 m at most: the same strata leave 2e-3 of that spread's sigma.
    allowed = 5 * phase_per_metre(frequencies_hz) * 0.2 / np.sqrt(12) / 256**0.75
    assert np.all(np.abs(error_rad) < allowed)
    assert np.all(np.abs(error_rad.mean(axis=(0, 1))) < allowed / np.sqrt(WIDTH * HEIGHT))


def test_phasors_in_itof_exr_are_phi_of_the_transient(rendered):
    folder = rendered.render_folder("000000")
    z, frequencies_hz = read_image(folder / "itof.exr").phasors()
    assert frequencies_hz == FREQUENCIES_HZ
    with TransientReader(folder / "transient.exr") as reader:
        assert reader.layout == LAYOUT
        np.testing.assert_allclose(reader.phasors(frequencies_hz), z, rtol=1e-6)  # one float32 rounding


def test_the_mirrored_sphere_is_where_ray_sphere_geometry_puts_it(rendered):
    image = read_image(rendered.render_folder("000000") / "mirrored.exr")
    depth_m, mask = image.channel("depth.R"), image.channel("mask.M")
    scene = rendered.scene("000000")
    rays = pixel_rays(WIDTH, HEIGHT, 60.0) @ camera_axes(scene.camera)
    to_centre = np.array([-1.15, 0.9, 1.6]) - scene.camera.location_m
    along = rays @ to_centre
    squared_miss = to_centre @ to_centre - along**2
    expected = along - np.sqrt(np.maximum(0.28**2 - squared_miss, 0))
    # The mesh is inscribed: its facets lie up to r (1 - cos^2(pi/64)) inside the sphere.
    sagitta = 0.28 * (1 - np.cos(np.pi / 64) ** 2)
    inside = squared_miss < (0.28 - sagitta) ** 2
    outside = squared_miss > 0.28**2
    np.testing.assert_array_equal(mask[inside], 1)
    np.testing.assert_array_equal(mask[outside], 0)
    np.testing.assert_array_equal(depth_m[mask == 0], 0)
    deepest = along - np.sqrt(np.maximum((0.28 - sagitta) ** 2 - squared_miss, 0))
    assert np.all(depth_m[inside] > expected[inside] - 1e-5)
    assert np.all(depth_m[inside] < deepest[inside] + 1e-5)
    assert inside.sum() > 20


def test_the_mirrored_cube_is_where_its_planes_are(rough_cube, variant):
    from render.transport.mirrored import trace_ground_truth

    truth = trace_ground_truth(load(rough_cube, mirrored=True), WIDTH, HEIGHT, 20e6)
    scene = rough_cube.scene("000000")
    mesh = trimesh.load(rough_cube.scene_folder("000000") / "hidden_object_0.ply")
    rays = pixel_rays(WIDTH, HEIGHT, 60.0) @ camera_axes(scene.camera) * [-1, 1, 1]  # into the mirror
    origin = np.array(scene.camera.location_m) * [-1, 1, 1]
    corners = mesh.triangles  # (M, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = rays @ normals.T  # (H, W, M)
    # The nearest front side of a convex solid is the farthest of the entered planes.
    distance = np.einsum("mk,mk->m", corners[:, 0] - origin, normals) / towards
    enter = np.where(towards < 0, distance, -np.inf).max(axis=-1)
    leave = np.where(towards > 0, distance, np.inf).min(axis=-1)
    clear = np.abs(leave - enter) > 1e-4
    np.testing.assert_array_equal(truth.mask[clear], (leave > enter)[clear])
    np.testing.assert_allclose(truth.radial_depth_m[truth.mask], enter[truth.mask], atol=1e-5)


def test_the_target_phasor_is_one_on_the_object_with_the_phase_of_its_depth(rendered):
    image = read_image(rendered.render_folder("000000") / "mirrored.exr")
    z, frequencies_hz = image.phasors()
    mask = image.channel("mask.M") == 1
    assert frequencies_hz == (20e6,)
    np.testing.assert_allclose(np.abs(z[..., 0]), mask, atol=1e-6)
    recovered_m = depth_from_phase(phase(z[..., 0]), 20e6)[mask]
    np.testing.assert_allclose(recovered_m, image.channel("depth.R")[mask], atol=1e-5)


def test_the_mirrored_transient_tells_the_same_depth_inside_the_object(rendered):
    folder = rendered.render_folder("000000")
    image = read_image(folder / "mirrored.exr")
    with TransientReader(folder / "mirrored_transient.exr") as reader:
        depth_m = depth_from_phase(phase(reader.phasors([20e6])[..., 0]), 20e6)
    mask = image.channel("mask.M") == 1
    inner = mask.copy()
    for axis in (0, 1):
        inner &= np.roll(mask, 1, axis) & np.roll(mask, -1, axis)
    # A pixel of angle p = 0.0326 rad at distance d sees a cap of the sphere whose depth rises by
    # (d p)^2 / (2 r cos^3 b) to its corners, b being the angle of incidence: 45 degrees at most inside.
    pixel_m = image.channel("depth.R").max() * 2 * np.tan(np.radians(30)) / WIDTH
    bound_m = pixel_m**2 / (2 * 0.28 * np.cos(np.radians(45)) ** 3)
    assert inner.any()
    np.testing.assert_allclose(depth_m[inner], image.channel("depth.R")[inner], atol=bound_m)


def test_a_transient_sums_to_the_steady_image_of_plain_mitsuba(rough_cube, variant):
    import mitsuba as mi

    scene, runs = load(rough_cube), range(8)
    steady = np.array([np.array(mi.render(scene, spp=512, seed=seed))[..., 0] for seed in runs])
    axis = TransientLayout(WIDTH, HEIGHT, 100, 0.15, 0.0)  # bins of any width hold the same light
    transient = np.array(
        [measure(scene, 512, variant, seed=seed, layout=axis).sum(-1, dtype=np.float64) for seed in runs]
    )
    difference = transient.mean(axis=0) - steady.mean(axis=0)
    sigma = np.sqrt((transient.var(axis=0, ddof=1) + steady.var(axis=0, ddof=1)) / len(runs))
    # Student's t with 7 or more degrees of freedom: mean square below 7/5, +- 2.5 sqrt(2/768) = 0.13.
    assert np.mean((difference / sigma) ** 2) < 1.4 + 3 * 0.13
    assert abs(difference.sum()) < 4 * np.sqrt(np.sum(sigma**2))
    assert difference.sum() == pytest.approx(0, abs=1e-3 * steady[0].sum())


def test_the_bounce_limit_separates_direct_from_hidden_light(rough_cube, variant):
    scene = load(rough_cube)
    direct = measure(scene, 1024, variant, max_bounces=1)
    full = measure(scene, 1024, variant, max_bounces=3)
    arrival_m = 0.01 * (np.argmax(direct > 0, axis=-1) + 0.5)
    first_m = 0.01 * (np.argmax(full > 0, axis=-1) + 0.5)
    np.testing.assert_array_equal(first_m, arrival_m)  # nothing comes before the wall's own return
    hidden_share = full.sum(dtype=np.float64) / direct.sum(dtype=np.float64) - 1
    assert 1e-3 < hidden_share < 5e-3


def test_light_that_misses_the_time_axis_is_reported(rough_cube, variant, caplog):
    measure(load(rough_cube), 16, variant, layout=TransientLayout(WIDTH, HEIGHT, 300, 0.01, 0.0))
    assert "outside the time axis" in caplog.text


def test_the_start_of_the_time_axis_shifts_bins_and_nothing_else(rough_cube, variant):
    scene = load(rough_cube)
    whole = measure(scene, 64, variant)
    late = measure(scene, 64, variant, layout=TransientLayout(WIDTH, HEIGHT, 1400, 0.01, 1.0))
    # Float32 knows 10 m to 1e-6 m: 1e-4 of the paths fall into the next bin of 1 cm, which turns their phasor
    # by 4e-3 rad. Sums in float32 have 1e-5.
    np.testing.assert_allclose(late.sum(), whole.sum(), rtol=1e-5)
    z, shifted = (phasors(x, [20e6], 0.01, start_opl_m=start) for x, start in ((whole, 0.0), (late, 1.0)))
    np.testing.assert_allclose(shifted, z, rtol=1e-4)


def test_border_pixels_have_no_more_noise_of_the_direct_return_than_others(rough_cube, variant):
    # If the projector's frustum ended where the camera's does, rounding would drop a path in a thousand of
    # border pixels, 1e-3 of the light there, in some of 80 x 60 pixels with every seed.
    scene, wide = load(rough_cube), TransientLayout(80, 60, 600, 0.01, 1.0)
    a, b = (
        phasors(measure(scene, 1024, variant, max_bounces=1, seed=s, layout=wide), [20e6], 0.01)
        for s in (1, 2)
    )
    # A fiftieth of the hidden light, 2e-3, where one path lost would be half of it.
    assert np.abs(a / b - 1).max() < 0.02 * 2e-3


def test_hidden_noise_falls_with_the_square_root_of_the_paths(rough_cube, variant):
    scene = load(rough_cube)

    def noise(spp):
        a, b = (phasors(measure(scene, spp, variant, seed=s), [20e6], 0.01) for s in (1, 2))
        return np.sqrt(np.mean(np.abs(a - b) ** 2))

    # The ratio of two such estimates over 768 pixels scatters by about 2 / sqrt(768) = 7 %.
    assert noise(64) / noise(1024) == pytest.approx(4, rel=0.35)


@pytest.mark.long
def test_many_passes_and_row_blocks_measure_the_same_scene(rough_cube, variant, monkeypatch):
    scene = load(rough_cube)
    whole = phasors(measure(scene, 1024, variant, max_bounces=1), FREQUENCIES_HZ, 0.01)
    monkeypatch.setattr("render.transport.path_tracer._WAVEFRONT", 5 * WIDTH * 256)
    monkeypatch.setattr("render.transport.path_tracer._SAMPLES_PER_PASS", 256)
    parts = phasors(measure(scene, 1024, variant, max_bounces=1), FREQUENCIES_HZ, 0.01)
    # The same 1024 float32 terms of a pixel in another order: up to 1024 x 6e-8.
    np.testing.assert_allclose(parts, whole, rtol=1e-4)


def test_the_same_seed_gives_the_same_paths(rough_cube, variant):
    scene = load(rough_cube)
    a, b, c = (measure(scene, 64, variant, seed=seed) for seed in (1, 1, 2))
    # Threads add up in any order, so equal means equal to float32 rounding.
    np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-9)
    assert np.abs(a - c).max() > 1e-4


def state(dataset, settings):
    return Inventory(dataset, settings).state("000000")


def test_a_finished_scene_is_kept_and_a_changed_recipe_is_not(rendered):
    assert state(rendered, path_settings(256)) == "done"
    assert state(rendered, path_settings(128)) == "other"
    assert state(rendered, path_settings(256, resolution=(WIDTH // 2, HEIGHT // 2))) == "other"


def test_a_damaged_or_changed_scene_is_not_done(rendered, tmp_path):
    shutil.copytree(rendered.root, tmp_path / "copy")
    copy = Dataset(tmp_path / "copy", rendered.index)
    for name in ("itof.exr", "mirrored.exr", "transient.exr", "mirrored_transient.exr"):
        file = copy.render_folder("000000") / name
        whole = file.read_bytes()
        file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        assert state(copy, path_settings(256)) == "damaged", name
        file.write_bytes(whole)
    assert state(copy, path_settings(256)) == "done"
    mesh = copy.scene_folder("000000") / "hidden_object_0.ply"
    mesh.write_bytes(mesh.read_bytes()[:-1] + b"\x01")
    assert state(copy, path_settings(256)) == "other"


def test_transients_of_other_settings_do_not_stay_beside_new_phasors(rendered, tmp_path):
    shutil.copytree(rendered.root, tmp_path / "copy")
    copy = Dataset(tmp_path / "copy", rendered.index)
    transient = copy.render_folder("000000") / "transient.exr"
    same = dataclasses.replace(path_settings(256), product="itof")
    Renderer(copy, same).render("000000")
    assert transient.exists()
    Renderer(copy, dataclasses.replace(same, options=PathOptions(spp=16))).render("000000")
    assert not transient.exists()


def test_a_time_axis_that_fits_no_memory_is_refused_before_rendering(rendered, monkeypatch):
    monkeypatch.setattr("render.settings._WORKING_COPIES", 10**9)
    with pytest.raises(RenderError, match=r"one image row of 32 pixels x 1500 bins needs .* GB"):
        Renderer(rendered, path_settings(4))


def test_a_transient_larger_than_openexr_writes_is_refused_before_rendering(rendered):
    larger = path_settings(4, resolution=(800, 600))  # x 1500 bins x 4 bytes: 2.88 GB
    with pytest.raises(RenderError, match=r"800x600 pixels and 1500 bins has 2.88 GB, .* at most 2.15 GB"):
        Renderer(rendered, larger)
    dataclasses.replace(larger, product="itof").layout(rendered)


def test_an_aspect_ratio_that_the_projector_does_not_have_is_refused(rendered):
    with pytest.raises(RenderError, match="aspect ratio"):
        Renderer(rendered, path_settings(4, resolution=(30, 30)))


def test_a_scene_file_that_cannot_be_used_is_named(rendered, tmp_path):
    shutil.copytree(rendered.root, tmp_path / "copy")
    copy = Dataset(tmp_path / "copy", rendered.index)
    renderer = Renderer(copy, path_settings(4, accept_edited=True))
    (copy.scene_folder("000000") / "middle_wall.ply").unlink()
    with pytest.raises(NightError, match=r"000000/middle_wall.ply is missing: run night-gen scenes"):
        renderer.render("000000")
    (copy.scene_folder("000000") / "middle_wall.ply").write_bytes(b"ply\nblob")
    with pytest.raises(NightError, match=r"000000/middle_wall.ply cannot be read as PLY"):
        renderer.render("000000")


def test_a_pixel_that_is_not_finite_stops_before_anything_is_written(rendered, tmp_path):
    shutil.copytree(rendered.root, tmp_path / "copy")
    copy = Dataset(tmp_path / "copy", rendered.index)
    shutil.rmtree(copy.render_folder("000000"))
    image = copy.scene_folder("000000") / "emitter.pfm"
    image.write_bytes(image.read_bytes()[:-4] + np.float32(np.nan).tobytes())  # a broken calibration
    with pytest.raises(RenderError, match="NaN"):
        Renderer(copy, path_settings(4, accept_edited=True)).render("000000")
    assert list(copy.render_folder("000000").iterdir()) == []
