"""Networks behind a modelled camera: ``night-eval RUN DATASET --sensor``, its numbers and refusals."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from night_commands import night_here, refusal
from PIL import Image
from synthetic_dataset import write_synthetic_dataset

from itof import read_image, write_image
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.sensor.imperfections import PERFECT, cameras_by_imperfection, without
from itof.sensor.noise import phase_noise_rad
from itof.sensor.scene_camera import SceneCamera, hidden_snr
from itof.sensor.settings import SensorSettings
from model.data.shards import open_shards
from model.judging.exposures import _Work, judge_exposures
from model.judging.refusals import EvaluationError
from model.prediction.predictor import load

pytestmark = pytest.mark.usefixtures("one_thread")

HZ = (20e6, 50e6, 60e6)
SMALL = SensorSettings(width=96, height=56, contrast=((20e6, 0.6),), shot_noise=True, integration_s=1e-2)
CAMERA = """
width = 96
height = 56
shot_noise = true
integration_s = 1e-2
vignetting = 2.0
"""


def scene(size=(14, 24), hidden=2e-3):
    rng = np.random.default_rng(0)
    direct = 0.4 * np.exp(2j * np.pi * rng.random((*size, len(HZ))))
    light = hidden * direct * np.exp(2j * np.pi * rng.random((*size, len(HZ))))
    return direct + light, direct, light


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("camera") / "camera.toml"
    file.write_text(CAMERA)
    return file


@pytest.fixture(scope="module")
def judged(finished_run, closed_form_scenes, camera_file, tmp_path_factory):
    """Folder of a judgement at three exposures, for reading only; and what the command printed."""
    out = tmp_path_factory.mktemp("exposures") / "out"
    done = night_here(
        *("night-eval", finished_run, closed_form_scenes.root, "--out", out, "--device", "cpu"),
        *("--sensor", camera_file, "--exposures", "100,1,10", "--corner-exposures", 1000),
    )
    assert done.returncode == 0, done.stderr
    return out, done.stdout


def test_noise_falls_with_the_root_of_the_exposures(judged):
    out, said = judged
    found = json.loads((out / "exposures.json").read_text())
    rows = found["rows"]
    assert [row["frames"] for row in rows] == [1, 10, 100]
    for key, power in (("phase_noise_rad", -0.5), ("snr_pixel", 0.5), ("light_s", 1), ("electrons", 1)):
        values = [row[key] for row in rows]
        np.testing.assert_allclose(values[2] / values[0], 100**power, rtol=1e-6)
    assert said.count("\n| all |") == 3
    with (out / "exposures.csv").open() as stream:
        assert [int(row["frames"]) for row in csv.DictReader(stream)] == [1, 10, 100]
    with Image.open(out / "exposures.png") as picture:
        assert min(picture.size) > 200
    assert found["corner_frames"] == 1000


def test_many_exposures_of_a_good_camera_are_the_phasors_as_rendered(
    finished_run, closed_form_scenes, tmp_path
):
    report = judge_exposures(
        *(finished_run, closed_form_scenes, tmp_path / "out", SMALL),
        exposures=(10**8,),
        device="cpu",
        progress=False,
    )
    (row,) = report.rows
    # Noise of 1e-4 of that at one exposure, which is below 1 mrad: far below the hidden light.
    assert row.metrics.depth_mae_m.mean == pytest.approx(report.perfect.depth_mae_m.mean, abs=2e-4)
    assert not (tmp_path / "out" / "exposures.png").exists()


def test_each_imperfection_is_judged_alone_and_left_out(finished_run, closed_form_scenes, tmp_path):
    sensor = replace(SMALL, read_noise_e=50.0, vignetting=2.0)
    report = judge_exposures(
        *(finished_run, closed_form_scenes, tmp_path / "out", sensor),
        each_imperfection=True,
        first=1,
        device="cpu",
        progress=False,
    )
    names = [row.name for row in report.rows]
    alone = [f"{name} alone" for name in ("shot noise", "dark noise", "vignetting")]
    assert set(names) == {
        "all",
        "none",
        *alone,
        *(f"all but {name.removesuffix(' alone')}" for name in alone),
    }
    rows = dict(zip(names, report.rows, strict=True))
    assert rows["none"].snr_pixel is None
    assert rows["none"].metrics.depth_mae_m.mean == pytest.approx(report.perfect.depth_mae_m.mean, abs=1e-6)
    assert rows["all"].snr_pixel < rows["all but dark noise"].snr_pixel < rows["shot noise alone"].snr_pixel


def test_imperfections_name_every_setting_that_disturbs():
    """What is not listed decides light and timing, or the strength of what is listed."""
    listed = {key for keys in PERFECT.values() for key in keys}
    for name in ("mlx75027", "opt8241", "cheap", "calibrated"):
        sensor = load_sensor(name)
        assert without(sensor, *PERFECT) == replace(
            sensor, **{key: getattr(SensorSettings(), key) for key in listed}
        )
        assert len(list(cameras_by_imperfection(sensor))) >= 10


def test_a_single_exposure_is_counted_and_more_are_drawn_alike():
    z, direct, hidden = scene()
    rng = np.random.default_rng(1)
    spreads = []
    for frames in (1, 2):
        camera = SceneCamera(replace(SMALL, frames=frames), HZ, 24, 14)
        errors = np.stack([camera.measure(z, direct, hidden, rng).phasor - z for _ in range(12)])
        spreads.append(np.std(errors))
    # Of 12 x 14 x 24 x 3 complex numbers: relative standard deviation 0.6 %
    assert spreads[1] / spreads[0] == pytest.approx(np.sqrt(0.5), rel=0.025)


def test_the_noise_of_other_scenes_and_exposures_is_another(closed_form_scenes, finished_run):
    dataset = closed_form_scenes
    shards = open_shards(dataset, progress=False)
    work = _Work(load(finished_run, "cpu"), dataset, shards, shards.rows("test"))
    errors = []
    for row, frames in ((0, 10), (0, 100), (1, 10), (0, 10)):
        camera = work.camera(replace(SMALL, frames=frames), 10)
        seen = work._measured(camera, row)
        phasor, direct, _ = work._light(row)
        error = (seen.phasor - phasor, seen.corner - direct)
        errors.append(np.concatenate([(each / np.std(each)).ravel() for each in error]))
    for other in errors[1:3]:
        # Of 2 x 1008 complex numbers that are independent: standard deviation 2 %.
        assert abs(np.vdot(errors[0], other)) / len(other) < 0.1
    np.testing.assert_array_equal(errors[0], errors[3])


def test_the_bound_of_the_hidden_light_is_reached_by_its_matched_filter():
    z, direct, hidden = scene()
    camera = SceneCamera(replace(SMALL, frames=3), HZ, 24, 14)
    binned = BinnedCamera(camera.settings, HZ, 24, 14)
    pixel, image = hidden_snr(binned, z, hidden)
    weight = hidden.conj() / binned.spread(z) ** 2
    rng = np.random.default_rng(2)
    strengths = []
    for _ in range(400):
        seen = camera._mean_of(3, z, rng)
        strengths.append(((seen - direct) * weight).sum().real / (hidden * weight).sum().real)
    assert np.mean(strengths) == pytest.approx(1, abs=4 / image / np.sqrt(400))
    assert 1 / np.std(strengths) == pytest.approx(image, rel=0.15)  # 400 draws: 3.5 %
    assert pixel == pytest.approx(image / np.sqrt(2 * hidden.size))
    noise = phase_noise_rad(camera.settings, camera.measure(z, direct, hidden, rng).electrons, 60e6)
    assert camera.phase_noise_rad(1e4) < noise
    assert hidden_snr(replace(binned, settings=replace(SMALL, shot_noise=False)), z, hidden)[0] == np.inf


def test_a_capture_of_the_corner_comes_from_the_same_camera():
    z, direct, hidden = scene()
    square = {"emitter_waveform": "square", "reference_waveform": "square", "shot_noise": False}
    camera = SceneCamera(replace(SMALL, **square), HZ, 24, 14, corner_frames=5)
    seen = camera.measure(z, direct, hidden, np.random.default_rng(0))
    assert np.abs(np.angle(seen.phasor / z)).max() > 0.05
    ratio = seen.phasor / seen.corner
    # Square waves measure a diamond instead of a circle, at most 45 degrees off its direction and with 0.9 of
    # its speed: |0.9 exp(j π/4) - 1| = 0.73 of the hidden light.
    assert np.abs(ratio - z / direct).max() < 0.75 * 2e-3


def test_bad_requests_are_refused_in_a_sentence(finished_run, closed_form_scenes, camera_file, tmp_path):
    run, data, out = finished_run, closed_form_scenes.root, tmp_path / "out"
    basis = ("night-eval", run, data, "--out", out)
    behind = (*basis, "--sensor", camera_file)
    for more, words in (
        (("--exposures", "1,10"), "--exposures: for a camera; name one with --sensor"),
        (("--first", 3, "--each-imperfection"), "--each-imperfection, --first: for a camera"),
        (("--sensor", "nikon"), "nikon"),
        (("--sensor", camera_file, "--exposures", "1,0"), "whole numbers from 1 on"),
        (("--sensor", camera_file, "--exposures", "many"), "whole numbers from 1 on"),
        (("--sensor", camera_file, "--mask-threshold", 0.3), "--mask-threshold: for the report"),
        (("--sensor", camera_file, "--scene", "000001"), "--scene: for the report"),
        (("--sensor", "mlx75027"), "is no binned image of a sensor of 640x480"),
    ):
        assert words in refusal(*basis, *more)
    assert not out.exists()
    out.mkdir()
    (out / "mine.txt").write_text("keep me")
    assert "holds other things than an earlier judgement of exposures: mine.txt" in refusal(*behind)
    assert [file.name for file in out.iterdir()] == ["mine.txt"]
    wide = tmp_path / "wide.toml"
    wide.write_text(CAMERA + "horizontal_fov_deg = 80.0\n")
    assert "the camera sees 80 degrees" in refusal(*basis[:3], "--out", tmp_path / "o", "--sensor", wide)


def test_numbers_that_make_no_sense_and_changed_results_are_refused(
    finished_run, closed_form_scenes, tmp_path
):
    for number in ((), (0,), (1, 0)):
        with pytest.raises(EvaluationError, match="exposures are whole numbers"):
            judge_exposures(finished_run, closed_form_scenes, tmp_path / "o", SMALL, exposures=number)
    with pytest.raises(EvaluationError, match="that of scenes at least 1"):
        judge_exposures(finished_run, closed_form_scenes, tmp_path / "o", SMALL, first=0)
    with pytest.raises(EvaluationError, match="imperfections are judged at one number of exposures"):
        judge_exposures(
            *(finished_run, closed_form_scenes, tmp_path / "o", SMALL),
            exposures=(1, 2),
            each_imperfection=True,
        )
    slow = replace(SMALL, frames=2000)
    for numbers in ({"exposures": (1, 999_999)}, {"corner_exposures": 999_999}):
        with pytest.raises(EvaluationError, match="999999 exposures of 2000 frames are more than"):
            judge_exposures(finished_run, closed_form_scenes, tmp_path / "o", slow, **numbers)
    # Earlier results are replaced, unless one of their files was changed.
    done = judge_exposures(
        finished_run, closed_form_scenes, tmp_path / "r", SMALL, first=1, progress=False, device="cpu"
    )
    again = judge_exposures(
        finished_run, closed_form_scenes, tmp_path / "r", SMALL, first=1, progress=False, device="cpu"
    )
    assert done == again
    (tmp_path / "r" / "exposures.csv").write_text("mine")
    with pytest.raises(EvaluationError, match=r"exposures\.csv"):
        judge_exposures(finished_run, closed_form_scenes, tmp_path / "r", SMALL, first=1, progress=False)


@pytest.mark.parametrize(
    ("parts", "words"),
    [(False, r"no channel direct.* a camera needs the direct and the hidden light"), (True, "not finite")],
)
def test_measurements_without_the_hidden_light_are_named(finished_run, tmp_path, parts, words):
    data = write_synthetic_dataset(tmp_path / "data", count=4, parts=parts)
    for scene_id in data.ids() if parts else ():
        file = data.render_folder(scene_id) / "itof.exr"
        image = read_image(file)
        name = next(name for name in image.channels if name.startswith("hidden."))
        write_image(file, {**image.channels, name: np.full_like(image.channels[name], np.nan)}, {})
    with pytest.raises(EvaluationError, match=words) as caught:
        judge_exposures(finished_run, data, tmp_path / "o", SMALL, progress=False, device="cpu")
    assert "itof.exr" in str(caught.value)
    assert not (tmp_path / "o").exists()


def test_a_camera_of_several_frames_counts_exposures(finished_run, closed_form_scenes, tmp_path, monkeypatch):
    (tmp_path / "camera.toml").write_text(CAMERA + "frames = 3\n")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    done = night_here(
        *("night-eval", finished_run, closed_form_scenes.root, "--out", ".", "--device", "cpu"),
        *("--sensor", tmp_path / "camera.toml", "--exposures", "4,2", "--first", 1),
    )
    assert done.returncode == 0, done.stderr
    rows = [
        [cell.strip() for cell in line.split("|")] for line in done.stdout.splitlines() if "| all |" in line
    ]
    assert [row[2] for row in rows] == ["2", "4"]
    with (tmp_path / "here" / "exposures.csv").open() as stream:
        assert [row["frames"] for row in csv.DictReader(stream)] == ["6", "12"]
