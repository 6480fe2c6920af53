"""Datasets whose scenes have their cameras elsewhere, and networks that are told where the wall is."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from night_commands import night_here, refusal
from render_runs import render_scenes
from spread_cameras import SHOWN, inverse_distance_per_m, preset, preset_text
from synthetic_dataset import write_synthetic_dataset
from training_runs import assert_same_end, config_of, settings, train_on_one_thread

from disk import PresetError
from model.data.augmentation import Augmentation, Draws
from model.data.batches import BatchMaker
from model.data.channel_scaling import fit_input_spec
from model.data.corner import wall_view
from model.data.shards import open_shards
from model.judging.evaluation import evaluate
from model.judging.refusals import EvaluationError
from model.prediction.predictor import load
from model.refinement.judged_refinement import refine_split
from model.run_folder.run_config import read_config
from model.training.loop import train
from model.training.refusals import TrainingError
from scenegen import sample_scene, scene_to_json

SPREAD = {"location_m": 0.2, "rotation_deg": 4.0}
PRESET = """
[dataset]
count = 4
[camera]
width = 24
height = 18
[camera_spread]
location_m = 0.2
rotation_deg = 4.0
[relay_wall]
material = "diffuse"
"""

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def corners(tmp_path_factory):
    """Twelve scenes in closed form, each with its camera elsewhere."""
    return write_synthetic_dataset(tmp_path_factory.mktemp("corners"), camera_spread=SPREAD)


@pytest.fixture(scope="module")
def run(corners, tmp_path_factory):
    out = tmp_path_factory.mktemp("shown") / "run"
    return train_on_one_thread(corners, out, **SHOWN | {"max_epochs": 2})


def test_cameras_are_spread_evenly_about_that_of_the_preset_and_carry_the_projector():
    chosen = preset(camera_spread=SPREAD)
    scenes = [sample_scene(chosen, index) for index in range(400)]
    for name, by in (("location_m", 0.2), ("rotation_deg", 4.0)):
        middle = getattr(chosen.camera, name)
        moves = np.array([getattr(scene.camera, name) for scene in scenes]) - middle
        assert np.abs(moves).max() <= by
        # Evenly: mean 0 and deviation by / sqrt(3); four standard errors.
        assert np.all(np.abs(moves.mean(axis=0)) < 4 * by / np.sqrt(3 * len(scenes)))
        np.testing.assert_allclose(moves.std(axis=0), by / np.sqrt(3), rtol=0.12)
        assert np.abs(np.corrcoef(moves.T) - np.eye(3)).max() < 0.2
    for scene in scenes:
        assert (scene.emitter.location_m, scene.emitter.rotation_deg) == (
            scene.camera.location_m,
            scene.camera.rotation_deg,
        )
    again = sample_scene(chosen, 7)
    assert scene_to_json(again) == scene_to_json(scenes[7])


def test_the_objects_are_those_of_the_dataset_without_spread():
    one, many = (sample_scene(preset(**tables), 3) for tables in ({}, {"camera_spread": SPREAD}))
    assert many.hidden_objects == one.hidden_objects
    assert many.relay_wall == one.relay_wall
    assert many.camera != one.camera
    zero = sample_scene(preset(camera_spread={"location_m": 0.0}), 3)
    assert scene_to_json(zero) == scene_to_json(one)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"camera_spread": {"location_m": -0.1}}, "camera_spread.location_m must be 0 to 100 m (got -0.1)"),
        ({"camera_spread": {"turn_deg": 3}}, "unknown key camera_spread.turn_deg"),
        (
            {"camera_spread": {"location_m": 1.2}},
            "camera.location_m, moved by camera_spread.location_m, is 0.2 m",
        ),
        ({"itof": {"frequencies_hz": [33e6]}, "camera_spread": {"location_m": 0.5}}, "put a lower frequency"),
    ],
)
def test_spreads_that_cannot_be_are_refused(tables, words, tmp_path):
    file = tmp_path / "p.toml"
    file.write_text(preset_text(**tables))
    assert words in refusal("night-gen", "scenes", tmp_path / "data", "--preset", file)


def test_without_the_spread_the_same_frequency_is_accepted(tmp_path):
    file = tmp_path / "p.toml"
    file.write_text("[dataset]\ncount = 1\n[itof]\nfrequencies_hz = [33e6]\n")
    done = night_here("night-gen", "scenes", tmp_path / "data", "--preset", file)
    assert done.returncode == 0, done.stderr


def test_the_wall_channel_is_the_inverse_distance_of_each_scenes_wall(corners):
    shards = open_shards(corners)
    rows = range(12)
    view = wall_view(corners)
    assert view.camera_location_m == corners.preset.camera.location_m
    spec = fit_input_spec("residual+wall", shards, rows, reference="self", view=view)
    z = shards.read(rows).phasors
    wall = view.expected_wall(shards.reference, spec.frequencies_hz)
    channels = spec.apply(z, spec.reference_for(z, wall))
    assert channels.shape[1] == spec.channel_count == 6
    mean, spread = spec.wall_scale_per_m
    truth = np.stack([inverse_distance_per_m(corners.scene(i), *z.shape[1:3]) for i in corners.ids()])
    found = channels[:, 5] * spread + mean
    # The hidden light, 2e-3 of the whole, turns phases by up to 2 mrad: 2.4 mm of wall at 20 MHz, which are
    # 2.4e-3 of the inverse distance at 1 m. Offsets of the phases are fitted besides: twice of that.
    np.testing.assert_allclose(found, truth, atol=5e-3)
    assert np.abs(truth - truth[0]).max() > 0.1
    assert (channels[:, 5].mean(), channels[:, 5].std()) == pytest.approx((0, 1), abs=1e-4)
    plain = replace(spec, channels="residual", wall_scale_per_m=None)
    np.testing.assert_array_equal(channels[:, :5], plain.apply(z, plain.reference_for(z, wall)))


def test_beside_pixels_without_light_the_residual_channels_are_zero_and_the_wall_goes_on(corners):
    shards, view = open_shards(corners), wall_view(corners)
    spec = fit_input_spec("residual+wall", shards, range(12), reference="self", view=view)
    z = shards.read([0]).phasors
    z[..., 18:, :] = 0  # the middle wall, which is dark
    wall = view.expected_wall(shards.reference, spec.frequencies_hz)
    channels = spec.apply(z, spec.reference_for(z, wall))
    assert not channels[0, :5, :, 17:].any()
    assert channels[0, :5, :, :17].any(axis=0).all()
    truth = inverse_distance_per_m(corners.scene("000000"), *z.shape[1:3])
    mean, spread = spec.wall_scale_per_m
    np.testing.assert_allclose(channels[0, 5] * spread + mean, truth, atol=2e-2)  # half of it is not seen
    kept = replace(spec, wall_alone=False)  # as in runs before this was so
    assert kept.apply(z, kept.reference_for(z, wall))[0, :5, :, 17].any()


def test_torch_gives_the_channels_of_numpy_and_flips_turn_the_wall_over(corners):
    shards, rows, view = open_shards(corners), list(range(4)), wall_view(corners)
    spec = fit_input_spec("residual+wall", shards, rows, reference="self", view=view)
    frequencies_hz = shards.manifest.frequencies_hz
    wall = view.expected_wall(shards.reference, frequencies_hz)
    maker = BatchMaker.for_shards(spec, frequencies_hz, wall, torch.device("cpu"))
    block = maker.upload(shards.read(rows))
    assert block.reference.shape[-1] == 4
    assert maker.reference_bytes * len(rows) == block.reference.nbytes
    batch = maker.batch(block)
    z = shards.read(rows).phasors
    numpy = spec.apply(z, spec.reference_of_image(z, wall), is_weighted=True)
    # A dozen operations in float32, each with one rounding of the light, over the channel's deviation.
    rounding = 12 * np.finfo(np.float32).eps / np.array(spec.residual_scale)
    difference = np.abs(batch.channels.numpy() - numpy).max(axis=(0, 2, 3))
    assert np.all(difference[:5] < rounding)
    assert difference[5] < 12 * np.finfo(np.float32).eps * np.abs(numpy[:, 5]).max()
    draws = Draws.of(4, torch.Generator().manual_seed(0))
    flipped = Augmentation(flip_rows=True)(block, maker, draws)
    for index in range(4):
        expected = batch.channels[index].flip(-2) if draws.coins[index, 0] else batch.channels[index]
        assert torch.equal(flipped.channels[index], expected)


def test_a_network_learns_resumes_and_is_judged_on_many_corners(corners, run, tmp_path):
    config = read_config(run)
    assert config.inputs.channels == "residual+wall"
    assert config_of(run)["inputs"]["wall_scale_per_m"] == list(config.inputs.wall_scale_per_m)
    assert config_of(run)["inputs"]["wall_alone"] is True
    assert config.geometry == wall_view(corners)
    train(corners, tmp_path / "parts", settings(**SHOWN | {"max_epochs": 1}))
    train(corners, tmp_path / "parts", settings(**SHOWN | {"max_epochs": 2}), resume=True)
    assert_same_end(tmp_path / "parts", run)
    report = evaluate(run, corners, tmp_path / "report", device="cpu", progress=False)
    assert len(report.scenes) == len(corners.ids("test"))


def test_a_fine_tuned_network_knows_the_walls_of_its_own_training(run, tmp_path):
    """And no longer those of the other: the largest shift tells which walls a prediction may show."""
    one_corner = write_synthetic_dataset(tmp_path / "data")
    tuning = SHOWN | {"max_epochs": 1}
    train(one_corner, tmp_path / "tuned", settings(**tuning), start_from=run)
    before, after = read_config(run).inputs, read_config(tmp_path / "tuned").inputs
    assert before.largest_shift_m > 0.05
    assert after.largest_shift_m < 0.02  # of hidden light alone
    assert replace(after, largest_shift_m=before.largest_shift_m) == before


def test_a_dataset_elsewhere_is_seen_with_its_own_wall(run, tmp_path):
    """The fit starts at the wall of the dataset: the channels see where it is, not where the run's was."""
    away = write_synthetic_dataset(
        tmp_path / "away", count=8, camera={"location_m": [1.3, -1.2, 1.65], "width": 24, "height": 14}
    )
    shards, seen = open_shards(away), []
    moved = load(run, "cpu").at(wall_view(away))
    z = shards.read([0]).phasors
    for predictor in (moved, load(run, "cpu")):
        channels = predictor._channels(z, predictor.wall)
        mean, spread = predictor.config.inputs.wall_scale_per_m
        seen.append(channels[0, 5] * spread + mean)
    truth = inverse_distance_per_m(away.scene("000000"), 14, 24)
    for found in seen:  # also from the run's own wall, 0.3 m from this one
        np.testing.assert_allclose(found, truth, atol=5e-3)


def test_a_network_that_needs_one_wall_is_refused(corners, finished_run, tmp_path):
    known = {name: SHOWN[name] for name in ("width", "batch_size")} | {"max_epochs": 1}
    with pytest.raises(TrainingError, match=r"has its camera elsewhere .* train with --reference self"):
        train(corners, tmp_path / "run", settings(**known))
    train(corners, tmp_path / "paper", settings(**known | {"channels": "paper"}))
    if read_config(finished_run).inputs.uses_residual:
        with pytest.raises(EvaluationError, match=r"camera elsewhere"):
            evaluate(finished_run, corners, tmp_path / "report", device="cpu", progress=False)
        with pytest.raises(EvaluationError, match=r"camera elsewhere"):
            refine_split(finished_run, corners, tmp_path / "refined", device="cpu", progress=False)
    with pytest.raises(PresetError, match=r"channels\.reference must be 'self' or 'self\+wiggling'"):
        settings(channels="residual+wall", reference="geometry")


def test_renders_of_many_corners_are_those_of_their_cameras_in_any_order(tmp_path):
    file = tmp_path / "p.toml"
    file.write_text(PRESET)
    assert night_here("night-gen", "scenes", tmp_path / "a", "--preset", file).returncode == 0
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    render_scenes(tmp_path / "a", product="itof", lights=400)
    for scene_id in ("000003", "000001"):
        render_scenes(tmp_path / "b", only=[scene_id], product="itof", lights=400)
        for image in ("itof.exr", "mirrored.exr"):
            one, other = (tmp_path / name / "renders" / scene_id / image for name in ("a", "b"))
            assert one.read_bytes() == other.read_bytes()
    assert json.loads((tmp_path / "a" / "dataset.json").read_text())["preset"]["camera_spread"] == SPREAD


def test_walls_within_those_of_the_training_are_no_other_corner(corners, run, tmp_path):
    inputs = read_config(run).inputs
    view, shards = wall_view(corners), open_shards(corners)
    expected_m = view.expected_wall(shards.reference, inputs.frequencies_hz).radial_depth_m
    shifts_m = [
        np.abs(1 / inverse_distance_per_m(corners.scene(i), 14, 24) - expected_m).mean()
        for i in corners.ids("train")
    ]
    # It is that of a fit: 3 mrad of hidden light at 60 MHz are 1.2 mm; 2 % of 0.37 m are six times that.
    assert inputs.largest_shift_m == pytest.approx(max(shifts_m), rel=0.02)
    file = corners.render_folder(corners.ids("train")[int(np.argmax(shifts_m))]) / "itof.exr"
    assert max(shifts_m) > 0.2  # which a network of one corner refuses
    done = night_here("night-eval", "predict", run, file, "--out", tmp_path / "seen", "--force")
    assert done.returncode == 0, done.stderr
    assert "warning: the wall" not in done.stderr
    away = {"location_m": [1.0 + 1.7 * max(shifts_m), -1.0, 1.65], "width": 24, "height": 14}
    far = write_synthetic_dataset(tmp_path / "far", count=4, camera=away)
    sentence = refusal(
        *("night-eval", "predict", run, far.render_folder("000000") / "itof.exr", "--out", tmp_path / "x")
    )
    assert "the run has seen walls up to" in sentence
