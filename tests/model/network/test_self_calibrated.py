"""Runs whose channels calibrate themselves, or that need a capture: training, prediction, refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from measurements import write_npz
from night_commands import refusal
from synthetic_dataset import write_synthetic_dataset
from training_runs import SEEING, config_of, settings, train_on_one_thread
from wall_measurements import farther

from itof.files.measurement_files import MeasurementError
from itof.wall.wall_view import WallPlaceError
from model.data.batches import BatchMaker
from model.data.channel_scaling import fit_input_spec
from model.data.corner import wall_view
from model.data.shards import open_shards
from model.prediction.prediction_files import predict_file
from model.prediction.predictor import InputError, load
from model.run_folder.run_config import RunError
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
SELF = SEEING | {"reference": "self", "channels": "residual", "noise_sigma": 0.0}


@pytest.fixture(scope="module")
def self_run(closed_form_scenes, tmp_path_factory):
    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("self") / "run", **SELF)


@pytest.fixture(scope="module")
def capture_run(closed_form_scenes, tmp_path_factory):
    out = tmp_path_factory.mktemp("capture") / "run"
    return train_on_one_thread(closed_form_scenes, out, **SEEING | {"reference": "capture", "max_epochs": 1})


def elsewhere(predictor, shift_m=0.01, turn=0.01):
    """The predictor with a wall that is moved and turned, as if nobody had measured it."""
    view = predictor.config.geometry
    point_m = tuple((np.array(view.wall_point_m) - shift_m * np.array(view.wall_normal)).tolist())
    normal = np.array(view.wall_normal) + turn * np.array(view.camera_axes[0])
    moved = replace(view, wall_point_m=point_m, wall_normal=tuple((normal / np.linalg.norm(normal)).tolist()))
    return replace(predictor, config=replace(predictor.config, geometry=moved))


def test_a_prediction_does_not_depend_on_the_wall_that_was_assumed_nor_on_phase_offsets(self_run, shards):
    predictor, phasors = load(self_run, "cpu"), shards.read(range(4)).phasors
    assert config_of(self_run)["inputs"]["reference"] == "self"
    drift = np.exp(1j * np.array([0.005, -0.005, 0.005]))
    straight = predictor.predict(phasors).phasor
    shifted = elsewhere(predictor).predict(phasors * drift).phasor
    known = replace(
        predictor,
        config=replace(predictor.config, inputs=replace(predictor.config.inputs, reference="geometry")),
    )
    lost = elsewhere(known).predict(phasors * drift).phasor
    size, small, large = (np.linalg.norm(each) for each in (straight, shifted - straight, lost - straight))
    assert small < 0.1 * size  # the pixels are large, and what is left falls with their area
    assert large > 10 * small


def test_the_channels_of_the_training_scenes_have_unit_variance(self_run, shards):
    predictor = load(self_run, "cpu")
    phasors = shards.read(shards.rows("train")).phasors
    inputs = predictor.config.inputs
    channels = inputs.apply(phasors, inputs.reference_for(phasors, predictor.wall))
    np.testing.assert_allclose(channels.std(axis=(0, 2, 3)), 1, rtol=1e-4)  # float32 of 1e-3 beside 1


def test_a_batch_has_the_channels_of_a_prediction(self_run, shards, monkeypatch):
    monkeypatch.setattr("model.data.batches.IMAGES_AT_ONCE", 5)
    predictor, block = load(self_run, "cpu"), shards.read(range(12))
    maker = BatchMaker.for_shards(
        predictor.config.inputs, shards.manifest.frequencies_hz, predictor.wall, torch.device("cpu")
    )
    rows = maker.upload(block)
    assert rows.reference.nbytes == 12 * maker.reference_bytes
    assert torch.equal(rows.take([3, 11]).reference, rows.reference[[3, 11]])
    assert torch.equal(rows.take([3]).joined(rows.take([11])).reference, rows.reference[[3, 11]])
    phasors, inputs = rows.phasors, maker.inputs
    plain = inputs.apply(phasors, inputs.reference_of_image(phasors, maker.wall), is_weighted=True)
    # complex64: 1e-7 of 1, divided by the residual's scale of 3e-4
    torch.testing.assert_close(maker.batch(rows).channels, plain, rtol=0, atol=5e-4)


def test_a_reference_kept_without_noise_keeps_the_share_of_the_noise_that_a_fit_takes():
    config = load("night-40x30", "cpu").config
    rng, shares = np.random.default_rng(0), []
    for width, height in ((40, 30), (80, 60)):
        view, frequencies_hz = config.geometry, config.inputs.frequencies_hz
        wall = view.expected_wall(view.direct_phasors(width, height, frequencies_hz), frequencies_hz)
        z = np.broadcast_to(wall.direct, (6, *wall.direct.shape))
        noise = rng.standard_normal((*z.shape, 2)) @ np.array([1, 1j])
        noisy = z + 1e-3 * np.abs(z[..., :1]) * noise
        kept = config.inputs.apply(noisy, config.inputs.reference_of_image(z, wall), is_weighted=True)
        fitted, plain = (config.inputs.apply(a, config.inputs.reference_for(a, wall)) for a in (noisy, z))
        shares.append(((kept - fitted) ** 2).mean() / ((fitted - plain) ** 2).mean())
    # Six unknowns of 3 x 4800 values are 0.04 %; in the dark corners, which have little weight, it is more.
    assert shares[1] < 0.01
    assert shares[1] < shares[0] / 2  # as the number of pixels


def test_a_capture_of_the_empty_corner_takes_its_own_errors_along(self_run, shards):
    predictor, phasors = load(self_run, "cpu"), shards.read([0, 1]).phasors
    height, width = phasors.shape[1:3]
    y, x = np.mgrid[:height, :width]
    error = np.exp(0.02j * np.sin(0.5 * x + 0.9 * y))[..., None]  # of each pixel, no plane and no offset
    capture = 7 * predictor.reference * error
    straight, captured = (predictor.predict(*a).phasor for a in ((phasors,), (phasors * error, capture)))
    # They turn the wall that the capture shows by some tenths of a degree.
    np.testing.assert_allclose(captured, straight, atol=0.06 * np.abs(straight).max())
    assert np.abs(predictor.predict(phasors * error).phasor - straight).max() > 0.1 * np.abs(straight).max()


def test_it_is_told_where_a_capture_of_the_empty_corner_shows_the_wall(
    self_run, capture_run, shards, tmp_path
):
    predictor, phasors = load(self_run, "cpu"), shards.read([0]).phasors
    there = elsewhere(predictor).wall
    unsure = there.direct * np.exp(0.6j * np.random.default_rng(0).standard_normal(there.direct.shape))
    told = {}
    for name, corner in (("there", there.direct), ("unsure", unsure), ("computed", predictor.reference)):
        file = write_npz(tmp_path / f"{name}.npz", phasors=phasors, reference=corner)
        found = predict_file(self_run, file, tmp_path / name, device="cpu", progress=False, force=True)
        record = json.loads((tmp_path / name / "prediction.json").read_text())
        told[name] = (
            record["reference_wall"],
            [each for each in found.sentences if "the empty corner" in each],
        )
    # The file has complex64, and a fit with unknown offsets magnifies its rounding (measured: 7e-6).
    np.testing.assert_allclose(told["there"][0]["plane_per_m"], there.plane_per_m, atol=1e-4)
    assert told["there"][0]["used"]
    assert " farther than expected, uncertain by " in told["there"][1][0]
    assert not told["unsure"][0]["used"]
    assert told["unsure"][1][0].endswith("so the wall is taken to be where it is expected")
    assert told["computed"] == (None, [])
    file = tmp_path / "there.npz"  # of a network that knows only captures, and needs no wall
    found = predict_file(capture_run, file, tmp_path / "capture", device="cpu", progress=False, force=True)
    assert found.wall is None


def test_the_error_of_a_square_wave_is_taken_out_on_request(self_run, shards):
    predictor, phasors = load(self_run, "cpu"), shards.read([0, 1]).phasors
    phases, error = np.angle(phasors), 0.0
    for _ in range(5):  # the error is a function of the phase that has it
        error = 0.01 * np.cos(4 * (phases + error)) + 0.005 * np.sin(4 * (phases + error))
    measured = phasors * np.exp(1j * error)
    changes = {}
    for reference in ("self", "self+wiggling"):
        inputs = replace(predictor.config.inputs, reference=reference)
        before, after = (
            inputs.apply(z, inputs.reference_for(z, predictor.wall)) for z in (phasors, measured)
        )
        changes[reference] = np.linalg.norm(after - before) / np.linalg.norm(before)
    assert changes["self+wiggling"] < 0.05 < changes["self"] / 5


def test_a_file_of_another_wall_is_predicted_without_a_warning_about_it(self_run, shards, tmp_path):
    predictor = load(self_run, "cpu")
    wall = predictor.wall
    moved = shards.read([0]).phasors * np.exp(1j * wall.slope * 0.008 * wall.radial_depth_m[..., None])
    file = write_npz(tmp_path / "m.npz", phasors=-moved)  # and a camera whose sign is the opposite
    found = predict_file(self_run, file, tmp_path / "out", device="cpu", progress=False, force=True)
    assert {each.code for each in found.check.findings} <= {"unexplained"}  # by a network of a few scenes
    (seen,) = found.check.walls
    assert seen.distance_shift_m == pytest.approx(0.008, abs=0.002)
    assert len(seen.plane_per_m) == 3


def test_a_wall_of_another_corner_is_refused(self_run, shards, tmp_path):
    far = farther(shards.read([0]).phasors[0], load(self_run, "cpu").wall, 0.4)
    file = write_npz(tmp_path / "m.npz", phasors=far)
    with pytest.raises(MeasurementError, match=r"farther away.*: the run was trained on another corner"):
        predict_file(self_run, file, tmp_path / "out", device="cpu", progress=False)


def test_a_run_for_captures_needs_one(capture_run, shards, tmp_path):
    predictor, phasors = load(capture_run, "cpu"), shards.read([0]).phasors
    with pytest.raises(InputError, match="for a capture of the empty corner: give one as reference"):
        predictor.predict(phasors)
    assert predictor.predict(phasors, predictor.reference).mask.shape == phasors.shape[:3]
    file = write_npz(tmp_path / "m.npz", phasors=phasors)
    told = refusal("night-eval", "predict", capture_run, file, "--out", tmp_path / "out", "--device", "cpu")
    assert told == (
        f"{file} has no array reference, and {capture_run} was trained for a capture of the empty corner: "
        "give one as reference"
    )


def test_fine_tuning_keeps_the_reference(self_run, closed_form_scenes, tmp_path):
    other = settings(**SELF | {"reference": "geometry"})
    with pytest.raises(RunError, match=r"reference is geometry, but .* was trained with self"):
        train(closed_form_scenes, tmp_path / "run", other, start_from=self_run)
    train(closed_form_scenes, tmp_path / "run", settings(**SELF | {"max_epochs": 1}), start_from=self_run)
    assert config_of(tmp_path / "run")["inputs"] == config_of(self_run)["inputs"]


def test_the_geometry_is_that_of_the_dataset(self_run, closed_form_scenes):
    assert load(self_run, "cpu").config.geometry == wall_view(closed_form_scenes)


def test_a_camera_in_the_plane_of_the_wall_is_refused(self_run):
    predictor = load(self_run, "cpu")
    view = predictor.config.geometry
    inside = replace(view, wall_point_m=view.camera_location_m)
    with pytest.raises(WallPlaceError, match="the camera is in the plane of the wall"):
        inside.expected_wall(predictor.reference, predictor.config.inputs.frequencies_hz)
    broken = replace(predictor, config=replace(predictor.config, geometry=inside))
    with pytest.raises(RunError, match="the geometry of the run cannot be"):
        _ = broken.wall


def test_channels_that_calibrate_themselves_cannot_be_scaled_without_camera_and_wall(shards):
    with pytest.raises(ValueError, match="the reference self needs the camera and the wall"):
        fit_input_spec("residual", shards, shards.rows("train"), reference="self")


@pytest.mark.parametrize("reference", ["self", "self+wiggling"])
@pytest.mark.parametrize("size", [(20, 15), (37, 29), (80, 60)])
def test_the_reference_of_an_image_does_not_depend_on_the_images_beside_it(size, reference, tmp_path):
    """To the last bit, as a resumed run prepares others together; also beside images with dark pixels."""
    width, height = size
    dataset = write_synthetic_dataset(tmp_path / "data", count=8, width=width, height=height)
    shards, view = open_shards(dataset, progress=False), wall_view(dataset)
    inputs = fit_input_spec("residual+wall", shards, range(8), reference=reference, view=view)
    wall = view.expected_wall(shards.reference, shards.manifest.frequencies_hz)
    phasor = np.tile(shards.read(range(8)).phasors, (8, 1, 1, 1))
    phasor[::5, :, width // 2 :] = 0
    rng = np.random.default_rng(0)
    phasor *= np.exp(0.1j * rng.standard_normal((64, 1, 1, phasor.shape[-1])).astype(np.float32))
    for convert in (np.asarray, torch.from_numpy):
        here, images = wall.converted(convert), convert(phasor)
        together = np.asarray(inputs.reference_of_image(images, here))
        for rows in ([5], [0], [7, 0, 40], list(range(63, -1, -3))):
            some = np.asarray(inputs.reference_of_image(images[rows], here))
            np.testing.assert_array_equal(some, together[rows])
