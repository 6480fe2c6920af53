"""Datasets whose scenes have different fields of view and objects of different reflectance."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from captures import steps, taps_of, write_sidecar
from night_commands import night_here, refusal
from render_runs import render_scenes
from spread_cameras import SHOWN, inverse_distance_per_m, preset, preset_text
from synthetic_dataset import write_synthetic_dataset
from training_runs import assert_same_end, settings, train_on_one_thread

from itof import direct_phasors, pixel_rays, read_image
from itof.capture.importing import import_capture
from itof.exr.image import write_image
from itof.files.measurement_files import MeasurementError
from itof.sensor.cameras import load_sensor
from itof.wall.wall_view import WallView
from model.data.batches import BatchMaker
from model.data.channel_scaling import fit_input_spec
from model.data.corner import wall_view
from model.data.scene_walls import SceneWalls
from model.data.sensor_draws import view_problem
from model.data.shards import open_shards
from model.judging.evaluation import evaluate
from model.prediction.onnx_export import export_onnx
from model.prediction.prediction_files import PREDICTION_SCHEMA, predict_file
from model.prediction.predictor import InputError, load
from model.run_folder.run_config import read_config
from model.training.loop import train
from scenegen import camera_axes, open_dataset, sample_scene, scene_to_json, wall_normal

SPREAD = {"location_m": 0.1, "rotation_deg": 2.0, "horizontal_fov_deg": 8.0}
PRESET = """
[dataset]
count = 3
[hidden_object]
least_reflectance = 0.2
[camera]
width = 24
height = 18
[camera_spread]
horizontal_fov_deg = 8
[relay_wall]
material = "diffuse"
"""

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Twelve scenes in closed form, each with another field of view, camera elsewhere."""
    return write_synthetic_dataset(tmp_path_factory.mktemp("views"), camera_spread=SPREAD)


@pytest.fixture(scope="module")
def run(views, tmp_path_factory):
    out = tmp_path_factory.mktemp("seen") / "run"
    return train_on_one_thread(views, out, **SHOWN | {"max_epochs": 2})


def maker_and_rows(dataset, rows):
    shards, view = open_shards(dataset), wall_view(dataset)
    spec = fit_input_spec("residual+wall", shards, rows, reference="self", view=view)
    wall = view.expected_wall(shards.reference, spec.frequencies_hz)
    walls = SceneWalls.of_shards(view, shards, spec.frequencies_hz)
    cpu = torch.device("cpu")
    maker = BatchMaker.for_shards(spec, shards.manifest.frequencies_hz, wall, cpu, walls=walls)
    return maker, shards.read(rows)


def test_fields_of_view_are_spread_evenly_and_the_projector_has_that_of_the_camera():
    chosen = preset(camera_spread={"horizontal_fov_deg": 8.0})
    scenes = [sample_scene(chosen, index) for index in range(400)]
    wider_deg = np.array([scene.camera.horizontal_fov_deg for scene in scenes]) - 60
    assert np.abs(wider_deg).max() <= 8
    # Evenly: mean 0 and deviation 8 / sqrt(3); four standard errors.
    assert abs(wider_deg.mean()) < 4 * 8 / np.sqrt(3 * len(scenes))
    assert wider_deg.std() == pytest.approx(8 / np.sqrt(3), rel=0.12)
    assert all(scene.emitter.horizontal_fov_deg == scene.camera.horizontal_fov_deg for scene in scenes)
    assert all(scene.camera.location_m == chosen.camera.location_m for scene in scenes)
    same = sample_scene(preset(), 7)
    assert scenes[7].hidden_objects == same.hidden_objects
    assert scene_to_json(sample_scene(preset(camera_spread={"horizontal_fov_deg": 0.0}), 7)) == scene_to_json(
        same
    )


def test_each_scene_draws_one_reflectance_for_all_of_its_objects():
    chosen = preset(hidden_object={"least_reflectance": 0.2, "reflectance": 0.8})
    scenes = [sample_scene(chosen, index) for index in range(400)]
    drawn = np.array([scene.hidden_objects[0].reflectance for scene in scenes])
    # All of 400 draws miss a sixtieth of the range with the probability (59 / 60)^400 = 1e-3.
    assert 0.2 <= drawn.min() < 0.21
    assert 0.79 < drawn.max() <= 0.8
    assert drawn.mean() == pytest.approx(0.5, abs=4 * 0.6 / np.sqrt(12 * len(scenes)))
    composites = [scene for scene in scenes if len(scene.hidden_objects) == 2]
    assert composites
    for one, two in (scene.hidden_objects for scene in composites):
        assert one.reflectance == two.reflectance
    known = sample_scene(preset(hidden_object={"reflectance": 0.8}), 3)
    darker = [replace(part, reflectance=0.8) for part in scenes[3].hidden_objects]
    assert darker == list(known.hidden_objects)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"camera_spread": {"horizontal_fov_deg": 59.5}}, "out of 1 to 170 degrees: got 59.5"),
        ({"camera_spread": {"horizontal_fov_deg": -1.0}}, "camera_spread.horizontal_fov_deg must be"),
        ({"hidden_object": {"least_reflectance": 0.9, "reflectance": 0.5}}, "0.9, above hidden_object.refl"),
        ({"hidden_object": {"least_reflectance": 1.5}}, "hidden_object.least_reflectance must be"),
    ],
)
def test_views_and_reflectances_that_cannot_be_are_refused(tables, words, tmp_path):
    file = tmp_path / "p.toml"
    file.write_text(preset_text(**tables))
    assert words in refusal("night-gen", "scenes", tmp_path / "data", "--preset", file)


def test_the_wall_of_each_scene_is_found_along_the_rays_of_its_own_camera(views):
    maker, block = maker_and_rows(views, list(range(12)))
    mean, spread = maker.inputs.wall_scale_per_m
    channels = maker.batch(maker.upload(block)).channels.numpy()
    found = channels[:, 5] * spread + mean
    truth = np.stack([inverse_distance_per_m(views.scene(i), 14, 24) for i in views.ids()])
    np.testing.assert_allclose(found, truth, atol=5e-3)  # as in tests/model/data/test_many_corners.py
    one_view = replace(maker, walls=None)
    wrong = one_view.batch(one_view.upload(block)).channels.numpy()
    # Rays that are wrong by up to four degrees bend a plane by centimetres: tens of times the hidden light.
    assert np.abs(wrong[:, :3]).max() > 10 * np.abs(channels[:, :3]).max()


@pytest.mark.parametrize(
    ("low_deg", "high_deg", "scenes", "computed"),
    [
        (55.0, 65.0, 60, 16),
        (50.0, 70.0, 60, 16 + 32),
        (20.0, 150.0, 60, 16 + 32 + 60),  # at the widest, rays miss the wall
        (55.0, 65.0, 12, 16),
    ],
)
def test_the_walls_of_many_views_are_those_of_each_view(
    low_deg, high_deg, scenes, computed, views, monkeypatch
):
    view, views_deg = wall_view(views), tuple(np.linspace(low_deg, high_deg, scenes).tolist())
    exact = {fov_deg: view.with_fov(fov_deg).direct_phasors(24, 14, (20e6, 60e6)) for fov_deg in views_deg}
    made, compute = [], WallView.direct_phasors
    monkeypatch.setattr(WallView, "direct_phasors", lambda *given: made.append(1) or compute(*given))
    found = SceneWalls(view, (low_deg, high_deg), 24, 14, (20e6, 60e6)).of(views_deg).direct
    assert len(made) == computed
    wanted = np.stack([exact[fov_deg] for fov_deg in views_deg])
    # complex64 rounds each part by half of this: a ten-thousandth of the hidden light.
    assert np.all(np.abs(found - wanted) <= np.finfo(np.float32).eps * np.abs(wanted))


def test_a_network_learns_resumes_and_is_judged_on_many_views(views, run, tmp_path):
    seen = [views.scene(scene).camera.horizontal_fov_deg for scene in views.ids()]
    assert read_config(run).fields_of_view_deg == (min(seen), max(seen))
    train(views, tmp_path / "parts", settings(**SHOWN | {"max_epochs": 1}))
    train(views, tmp_path / "parts", settings(**SHOWN | {"max_epochs": 2}), resume=True)
    assert_same_end(tmp_path / "parts", run)
    report = evaluate(run, views, tmp_path / "report", device="cpu", progress=False)
    shards, rows = open_shards(views), open_shards(views).rows("test")
    block = shards.read(rows)
    fields_of_view_deg = shards.fields_of_view_deg(rows)
    found = load(run, "cpu").predict(block.phasors, fields_of_view_deg=fields_of_view_deg)
    own_mm = [
        1e3 * np.abs(found.radial_depth_m[n] - block.radial_depth_m[n]).mean() for n in range(len(rows))
    ]
    judged_mm = [1e3 * scene.prediction.depth_mae_m for scene in report.scenes]
    np.testing.assert_allclose(own_mm, judged_mm, rtol=1e-5)
    predictor = load(run, "cpu")
    one = predictor.at(predictor.config.geometry.with_fov(fields_of_view_deg[0]))
    alone = one.predict(block.phasors[0])
    np.testing.assert_allclose(found[0].radial_depth_m, alone.radial_depth_m, rtol=1e-5)


def test_a_network_that_knows_rays_reads_images_of_other_sizes(views, tmp_path):
    """It learns and resumes as others do; images of about as many pixels a row are judged."""
    knowing = SHOWN | {"channels": "residual+wall+rays", "max_epochs": 2}
    run = train_on_one_thread(views, tmp_path / "run", **knowing)
    train(views, tmp_path / "parts", settings(**knowing | {"max_epochs": 1}))
    train(views, tmp_path / "parts", settings(**knowing), resume=True)
    assert_same_end(tmp_path / "parts", run)
    large = write_synthetic_dataset(tmp_path / "large", count=8, width=28, height=17, camera_spread=SPREAD)
    report = evaluate(run, large, tmp_path / "report", device="cpu", progress=False)
    rows = open_shards(large).rows("test")
    z, views_deg = (open_shards(large).read(rows).phasors, open_shards(large).fields_of_view_deg(rows))
    predictor = load(run, "cpu")
    with pytest.raises(InputError, match="for_size reads other sizes"):
        predictor.predict(z, fields_of_view_deg=views_deg)
    assert predictor.for_size(96, 60) is predictor  # 48 pixels a row after averaging, and the training had 24
    assert predictor.for_size(24, 20) is predictor  # another aspect ratio
    found = predictor.for_size(28, 17).predict(z, fields_of_view_deg=views_deg)
    assert found.mask.shape[1:] == (17, 28)
    judged_m = [scene.prediction.depth_mae_m for scene in report.scenes]
    truth_m = open_shards(large).read(rows).radial_depth_m
    np.testing.assert_allclose(np.abs(found.radial_depth_m - truth_m).mean((1, 2)), judged_m, rtol=1e-5)
    check = export_onnx(run, tmp_path / "net.onnx")
    assert check.largest_difference <= check.tolerance


def test_images_and_fields_of_view_must_go_together(views, run):
    predictor, z = load(run, "cpu"), open_shards(views).read([0, 1]).phasors
    with pytest.raises(InputError, match="2 images have 1 fields_of_view_deg: give one each"):
        predictor.predict(z, fields_of_view_deg=[60.0])
    for bad in (0.0, np.nan, 180.0):
        with pytest.raises(InputError, match="fields_of_view_deg are between 1 and 170 degrees, got"):
            predictor.predict(z, fields_of_view_deg=[60.0, bad])
    listed, array = (predictor.predict(z, fields_of_view_deg=kind([60.0, 61.0])) for kind in (list, np.array))
    assert np.array_equal(listed.radial_depth_m, array.radial_depth_m)
    with pytest.raises(InputError, match="a reference is that of one camera"):
        predictor.predict(z, predictor.reference, fields_of_view_deg=[60.0, 60.0])


def test_predictions_know_the_field_of_view_and_refuse_those_that_the_training_has_not_seen(
    views, run, tmp_path
):
    scene = views.ids("train")[0]
    fov_deg = views.scene(scene).camera.horizontal_fov_deg
    command = ("night-eval", "predict", run, views.render_folder(scene) / "itof.exr", "--device", "cpu")
    done = night_here(*command, "--out", tmp_path / "out", "--fov", fov_deg)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "prediction.json").read_text())
    assert record["schema_version"] == PREDICTION_SCHEMA
    assert record["images"][0]["horizontal_fov_deg"] == pytest.approx(fov_deg)
    assert_shows_the_wall(record["images"][0], views.scene(scene))
    sentence = refusal(*command, "--out", tmp_path / "x", "--fov", 75)
    assert "the field of view is 75 degrees, and the training saw " in sentence
    assert "nan is not in the range 1<=x<=170" in refusal(*command, "--out", tmp_path / "x", "--fov", "nan")
    with pytest.raises(MeasurementError, match="no camera sees nan degrees"):
        predict_file(run, command[3], tmp_path / "x", horizontal_fov_deg=float("nan"))
    assert not (tmp_path / "x").exists()


def assert_shows_the_wall(image, scene):
    """Whether a predicted image has the plane of the scene's camera, which only the right rays find."""
    rays = pixel_rays(24, 14, scene.camera.horizontal_fov_deg)
    plane = np.array(image["wall"]["plane_per_m"])
    # 3 mrad of hidden light at 60 MHz are 1.2 mm, and the wall is a metre or more away.
    np.testing.assert_allclose(rays @ plane, inverse_distance_per_m(scene, 14, 24), atol=1.2e-3)


def test_an_image_in_a_dataset_has_the_field_of_view_of_its_scene(views, run, tmp_path):
    file = views.render_folder("000001") / "itof.exr"
    assert "horizontal_fov_deg" not in read_image(file).attributes
    scene = views.scene("000001")
    done = predict_file(run, file, tmp_path / "out", device="cpu", progress=False)
    assert done.images[0].horizontal_fov_deg == scene.camera.horizontal_fov_deg
    assert_shows_the_wall(asdict(done.images[0]), scene)


def test_a_field_of_view_in_a_file_is_that_of_its_images(views, run, tmp_path):
    scenes = [views.scene(each) for each in ("000001", "000002", "000003")]
    images = [read_image(views.render_folder(scene.id) / "itof.exr") for scene in scenes]
    views_deg = [scene.camera.horizontal_fov_deg for scene in scenes]
    arrays = {"frequencies_hz": images[0].phasors()[1], "phasors": [each.phasors()[0] for each in images]}
    np.savez(tmp_path / "three.npz", **arrays, horizontal_fov_deg=views_deg)
    done = predict_file(run, tmp_path / "three.npz", tmp_path / "out", device="cpu", progress=False)
    for image, scene in zip(done.images, scenes, strict=True):
        assert image.horizontal_fov_deg == scene.camera.horizontal_fov_deg
        assert_shows_the_wall(asdict(image), scene)

    copy, out = tmp_path / "itof.exr", ("--out", tmp_path / "x", "--device", "cpu")
    write_image(copy, images[0].channels, {"horizontal_fov_deg": "75.0"})
    sentence = refusal("night-eval", "predict", run, copy, *out)
    assert "the field of view is 75 degrees, and the training saw " in sentence
    write_image(copy, images[0].channels, {"horizontal_fov_deg": "wide"})
    assert "has a field of view that is no number: 'wide'" in refusal(
        "night-eval", "predict", run, copy, *out
    )
    for wrong, words in (
        ([60.0, 61.0], "one for each of the 3 images"),
        ("sixty", "must be"),
        (200.0, "no camera sees 200 degrees"),
    ):
        np.savez(tmp_path / "three.npz", **arrays, horizontal_fov_deg=wrong)
        assert words in refusal("night-eval", "predict", run, tmp_path / "three.npz", *out)


def test_an_imported_capture_brings_its_field_of_view(views, run, tmp_path):
    scene = views.ids("train")[0]
    z = read_image(views.render_folder(scene) / "itof.exr").phasors()[0]
    np.savez(tmp_path / "frames.npz", raw=taps_of(z, steps(4), steps(2))[None])
    fov_deg = views.scene(scene).camera.horizontal_fov_deg
    for seen_deg in (fov_deg, 80.0):
        sidecar = write_sidecar(tmp_path / "sidecar.toml", horizontal_fov_deg=seen_deg)
        import_capture(tmp_path / "frames.npz", sidecar, tmp_path / f"{seen_deg:g}.npz", progress=False)
    out = ("--out", tmp_path / "out", "--device", "cpu")
    done = night_here("night-eval", "predict", run, tmp_path / f"{fov_deg:g}.npz", *out)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "prediction.json").read_text())
    assert record["images"][0]["horizontal_fov_deg"] == pytest.approx(fov_deg, abs=1e-6)
    assert "the field of view is 80 degrees" in refusal(
        "night-eval", "predict", run, tmp_path / "80.npz", *out
    )
    (tmp_path / "80.npz").rename(tmp_path / "moved.npz")
    assert "80.npz" in refusal("night-eval", "predict", run, tmp_path / "80.npz", *out)
    (tmp_path / "moved.npz").rename(tmp_path / "80.npz")
    # What is said counts more than what is recorded.
    done = night_here("night-eval", "predict", run, tmp_path / "80.npz", *out, "--fov", fov_deg)
    assert done.returncode == 0, done.stderr


def test_a_modelled_camera_has_one_field_of_view(views):
    problem = view_problem(
        load_sensor("mlx75027"), views.preset, "it", 24, 14, views.preset.itof.frequencies_hz
    )
    assert "have different fields of view, and a camera has one" in problem


def test_renders_have_the_field_of_view_and_the_reflectance_of_their_scene(tmp_path):
    file = tmp_path / "p.toml"
    file.write_text(PRESET)
    plain = tmp_path / "white.toml"
    plain.write_text(PRESET.replace("least_reflectance = 0.2", "least_reflectance = 1"))
    for name, which in (("a", file), ("white", plain)):
        assert night_here("night-gen", "scenes", tmp_path / name, "--preset", which).returncode == 0
        render_scenes(tmp_path / name, product="itof", lights=400)
    dataset, white = open_dataset(tmp_path / "a"), open_dataset(tmp_path / "white")
    frequencies_hz = dataset.preset.itof.frequencies_hz
    for scene_id in dataset.ids():
        scene = dataset.scene(scene_id)
        image, bright = (read_image(each.render_folder(scene_id) / "itof.exr") for each in (dataset, white))
        assert float(image.attributes["horizontal_fov_deg"]) == scene.camera.horizontal_fov_deg
        assert json.loads(image.attributes["camera_location_m"]) == list(scene.camera.location_m)
        direct = image.phasors("direct")[0]
        wall, camera = scene.relay_wall, scene.camera
        expected = direct_phasors(
            *(24, 18, camera.horizontal_fov_deg, frequencies_hz, camera_axes(camera), camera.location_m),
            *(wall.location_m, wall_normal(wall)),
        )
        ratio = direct / expected
        # Rough plastic is no Lambertian wall: the paths within a pixel have other weights (design.md).
        np.testing.assert_allclose(ratio / np.median(np.abs(ratio)), 1, atol=2e-3)
        # Light of three bounces is in proportion to the reflectance; float32 sums of 400 points.
        darker, most = (each.phasors("hidden")[0] for each in (image, bright))
        share = scene.hidden_objects[0].reflectance / white.scene(scene_id).hidden_objects[0].reflectance
        assert 0.2 <= share < 1
        np.testing.assert_allclose(darker, share * most, atol=1e-4 * np.abs(most).max())
