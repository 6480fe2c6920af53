"""Training behind a modelled camera: what the network sees, settings, resume, refusals."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from night_commands import refusal
from training_runs import config_of, settings
from wall_rows import FREQUENCIES_HZ, HEIGHT, WIDTH, draws_of, measured_rows

from disk import PresetError
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.sensor.imperfections import PERFECT
from itof.sensor.settings import SensorSettings
from model.data.augmentation import Augmentation
from model.data.batches import BatchMaker
from model.data.rows import ARRAYS
from model.data.sensor_draws import SensorDraws
from model.run_folder.run_config import RunError
from model.settings.keys import merged, tables
from model.settings.presets import training_preset
from model.settings.train_settings import settings_from_dict
from model.training.loop import train
from model.training.refusals import TrainingError

pytestmark = pytest.mark.usefixtures("one_thread")

SENSOR = SensorSettings(
    width=4 * WIDTH, height=4 * HEIGHT, shot_noise=True, contrast=((20e6, 0.6),), vignetting=1.0
)
SQUARE = replace(
    SENSOR,
    shot_noise=False,
    vignetting=0.0,
    emitter_waveform="square",
    reference_waveform="square",
    wiggling_left=0.1,
)


def binned(sensor):
    return BinnedCamera(sensor, FREQUENCIES_HZ, WIDTH, HEIGHT)


def scenes(count=5):
    return torch.from_numpy(measured_rows(count)[2].astype(np.complex64))


def test_the_noise_of_the_images_is_that_of_the_camera():
    z, camera = scenes(1), binned(SENSOR)
    noiseless = replace(SENSOR, **PERFECT["shot noise"], **PERFECT["dark noise"], **PERFECT["converter"])
    seen, mean = (
        SensorDraws(each)(z.expand(600, -1, -1, -1), range(600)) for each in (camera, binned(noiseless))
    )
    error = (seen - mean) / camera.spread(z)
    for part in (error.real, error.imag):
        # chi-squared of 600 values in each pixel, 72000 in all: relative standard deviation 0.5 %
        assert (part**2).mean().item() == pytest.approx(1, abs=0.02)
    assert abs((error.real * error.imag).mean().item()) < 0.02


def test_an_image_depends_on_its_seed_alone():
    z = scenes()
    draws = SensorDraws(binned(replace(SENSOR, phase_drift_rad=0.01, scattering=0.01)))
    together = draws(z, [7, 3, 5, 1, 2])
    torch.testing.assert_close(draws(z[2:3], [5])[0], together[2], rtol=1e-6, atol=1e-7)
    assert (draws(z[2:3], [6])[0] - together[2]).abs().max() > 1e-4


def test_each_image_has_its_own_part_of_the_wiggling():
    z, draws = scenes(1), SensorDraws(binned(SQUARE))
    seen = draws(z.expand(200, -1, -1, -1), range(200))
    whole = torch.angle(binned(replace(SQUARE, wiggling_left=1.0)).mean(z) / z)[0, 2, 3, 0]
    parts = torch.angle(seen / z)[:, 2, 3, 0] / whole  # of all wiggling
    assert parts.min() >= -1e-4
    assert parts.max() <= 0.1 * 1.1  # rise times and duty cycles differ, too
    assert parts.mean().item() == pytest.approx(0.05, abs=0.1 / np.sqrt(12 * 200) * 4)


def test_a_capture_of_the_corner_takes_out_what_the_camera_does_to_direct_light():
    _, _, phasor, direct = measured_rows()
    z, wall = (torch.from_numpy(each.astype(np.complex64)) for each in (phasor, direct))
    camera = binned(replace(SQUARE, phase_steps=5))
    alone, divided = SensorDraws(camera)(z, range(5)), SensorDraws(camera, wall)(z, range(5))
    left = torch.angle(divided / z).abs().max()
    # What stays is the slope of the error, at most a tenth of 4 cycles' 0.28, times 2 mrad of hidden light.
    assert left < 0.1 * 0.3 * 2.5e-3
    assert left < 0.02 * torch.angle(alone / z).abs().max()
    # The wall itself comes out as it went in.
    torch.testing.assert_close(SensorDraws(camera, wall)(wall[None], [0])[0], wall, rtol=1e-5, atol=1e-6)


def test_batches_are_measured_and_their_references_fitted_to_the_measurement():
    rows, maker, *_ = measured_rows()
    inputs = replace(maker.inputs, reference="self")
    camera = SensorDraws(binned(replace(SENSOR, phase_drift_rad=0.5)))
    drifting = BatchMaker(inputs, maker.places, maker.wall, camera)
    plain = BatchMaker(inputs, maker.places, maker.wall)
    draws = draws_of(5)
    bare = replace(rows, reference=None)
    with_camera = Augmentation()(bare, drifting, draws)
    without = Augmentation()(bare, plain, draws)
    residual = slice(5, None)
    change = (with_camera.channels - without.channels)[:, residual]
    noise = camera.camera.spread(rows.phasors).max() / 0.05
    assert 0 < change.abs().median() < noise / 1e-3  # noise, not half a radian of drift over a scale of 1e-3
    again = Augmentation()(bare, drifting, draws)
    torch.testing.assert_close(again.channels, with_camera.channels, rtol=0, atol=0)


def test_validation_scenes_are_measured_by_their_row():
    rows, maker, *_ = measured_rows()
    camera = SensorDraws(binned(SENSOR))
    measuring = replace(maker, camera=camera)
    block = replace(rows, **{name: getattr(rows, name).numpy() for name in ARRAYS})
    seen = measuring.upload(block)
    expected = camera(rows.phasors, rows.rows)
    torch.testing.assert_close(seen.phasors, expected)
    torch.testing.assert_close(seen.reference, measuring.reference(expected))
    augmented = measuring.upload_to_augment(block)
    assert augmented.reference is None
    assert torch.equal(augmented.phasors, rows.phasors)


BEHIND = {
    "sensor": replace(SENSOR, width=48, height=28, integration_s=1e-2),
    "sensor_capture": True,
    "channels": "residual",
    "reference": "self",
    "flip_columns": False,
    "rotation_deg": 0.0,
    "translation": 0.0,
}


def test_a_training_behind_a_camera_resumes_to_the_bit(closed_form_scenes, tmp_path):
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    train(closed_form_scenes, whole, settings(**BEHIND))
    train(closed_form_scenes, halves, settings(**BEHIND, max_epochs=1))
    train(closed_form_scenes, halves, settings(**BEHIND), resume=True)
    for name in ("best.safetensors", "history.csv"):
        assert (whole / name).read_bytes() == (halves / name).read_bytes()
    recorded = config_of(whole)["settings"]
    assert recorded["augmentation"]["camera"]["sensor"]["integration_s"] == 1e-2
    assert recorded["augmentation"]["camera"]["empty_corner"] is True
    other = settings(**BEHIND | {"sensor": replace(BEHIND["sensor"], frames=2)})
    with pytest.raises(
        RunError, match=r"cannot be resumed: augmentation\.camera\.sensor\.frames was 1 and is now 2"
    ):
        train(closed_form_scenes, halves, other, resume=True)
    # The validation loss is that of noisy scenes.
    plain, bare = tmp_path / "plain", {k: v for k, v in BEHIND.items() if "sensor" not in k}
    train(closed_form_scenes, plain, settings(**bare))
    assert (plain / "history.csv").read_text() != (whole / "history.csv").read_text()


def test_cameras_that_cannot_measure_the_scenes_are_refused(closed_form_scenes, tmp_path):
    for changes, words in (
        ({"width": 50}, "is no binned image of a sensor of 50x28"),
        ({"horizontal_fov_deg": 70.0}, "the camera sees 70 degrees and the scenes of .* are rendered for 60"),
    ):
        sensor = replace(BEHIND["sensor"], **changes)
        with pytest.raises(TrainingError, match=words):
            train(closed_form_scenes, tmp_path / "run", settings(**BEHIND | {"sensor": sensor}))
    assert not list(tmp_path.rglob("*.*"))  # neither run.json nor weights


def test_settings_name_a_camera_and_hold_what_it_is(tmp_path):
    file = tmp_path / "preset.toml"
    file.write_text('[augmentation.camera]\nsensor = "calibrated"\n')
    data, origin = training_preset(file)
    found = settings_from_dict(data, origin)
    assert found.augmentation.camera.sensor == load_sensor("calibrated")
    assert settings_from_dict(json.loads(json.dumps(asdict(found))), "run.json") == found
    (tmp_path / "mine.toml").write_text("f_number = 2.5\n")
    file.write_text('[augmentation.camera]\nsensor = "mine.toml"\n')
    assert training_preset(file)[0]["augmentation"]["camera"]["sensor"]["f_number"] == 2.5
    for name in ("nothing", "../mine.toml"):
        file.write_text(f'[augmentation]\ncamera.sensor = "{name}"\n')
        with pytest.raises(PresetError, match=r"preset\.toml, key augmentation\.camera\.sensor: "):
            training_preset(file)
    for key, value, words in (
        ("input.channels.reference", "capture", "take reference self"),
        ("augmentation.camera.empty_corner", True, ""),
        ("augmentation.camera.sensor.f_number", 0.0, r"sensor.f_number must be 0\.1 to 1000 \(got 0\)"),
    ):
        changes = merged(data, tables({key: value}))
        if not words:
            assert settings_from_dict(changes, "options").augmentation.camera.empty_corner
            continue
        with pytest.raises(PresetError, match=words):
            settings_from_dict(changes, "options")
    with pytest.raises(PresetError, match=r"key augmentation\.camera\.sensor is missing"):
        settings_from_dict(tables({"augmentation.camera.empty_corner": True}), "options")


def test_night_train_refuses_an_unknown_camera_in_a_sentence(closed_form_scenes, tmp_path):
    said = refusal("night-train", closed_form_scenes.root, "--out", tmp_path / "run", "--sensor", "mlx")
    assert "mlx" in said
    assert not (tmp_path / "run").exists()
