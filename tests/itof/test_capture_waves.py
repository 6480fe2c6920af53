"""Waves of a camera, from captures of a flat wall at several distances."""

import json
from dataclasses import replace

import numpy as np
import pytest
from measurements import write_npz
from night_commands import night_here, refusal
from wall_measurements import noise

from disk import NightError
from itof.capture.sidecar import CaptureError
from itof.capture.waves import captured_waves, write_captured_waves
from itof.sensor.binned import BinnedCamera
from itof.sensor.cameras import load_sensor
from itof.sensor.demodulation import harmonics
from itof.sensor.imperfections import PERFECT, without
from itof.wall.expected_wall import ExpectedWall

HZ = (20e6, 50e6, 60e6)
WAVES = {20e6: (0.108, 0.031), 50e6: (0.026, 0.006), 60e6: (0.014, 0.003)}  # third and fifth harmonic
SERIES_M = (0.8, 1.5, 2.1, 2.8)  # 2 m apart: more than a period of the error at 20 MHz, 1.87 m
OFFSETS_RAD = np.array([0.05, -0.08, 0.1])


def images(series_m=SERIES_M, hz=HZ, waves=WAVES, turned_rad=0.0):
    """Walls that a camera of four steps sees: exp(j φ) + C_3 exp(-3 j φ) + C_5 exp(5 j φ), in any unit."""
    for place, away_m in enumerate(series_m):
        normal = np.array([0.15 * (-1) ** place, 0.1 * np.sin(place), 1.0])
        plane = normal / np.linalg.norm(normal) / away_m
        z = ExpectedWall.of_plane(plane, 40, 30, hz, 60.0).direct * np.exp(1j * OFFSETS_RAD[: len(hz)])
        third, fifth = np.array([waves[each] for each in hz]).T
        around = np.exp(4j * np.angle(z))
        yield (1 + place) * z * (1 + third / around + fifth * around) * np.exp(1j * turned_rad)


def written(folder, series, hz=HZ, name="walls.npz"):
    """All images in a file."""
    arrays = {"phasors": np.stack([*series]), "frequencies_hz": np.array(hz), "horizontal_fov_deg": 60.0}
    return write_npz(folder / name, **arrays)


def test_waves_are_recovered_and_make_the_same_phase_error(tmp_path):
    """A block of 20 pixels takes the mean over at most 0.5 rad of 4 φ, which lowers it by 0.5² / 24."""
    lowered = 0.5**2 / 24
    found = captured_waves(written(tmp_path, images()))
    assert found.fit.orders[:2] == (5, 3)
    for (third, fifth), row, (far, near) in zip(
        WAVES.values(), found.fit.harmonics, found.fit.harmonics[:, 2:], strict=True
    ):
        assert row[1] == pytest.approx(third, abs=lowered * third + 2e-4)
        assert row[0] == pytest.approx(fifth, abs=lowered * third + 2e-4)
        assert np.abs([far, near]).max() < 1e-3
    write_captured_waves(found, tmp_path / "mine.toml")
    mine = load_sensor(tmp_path / "mine.toml")
    assert mine == found.sensor
    assert replace(mine, harmonics=()) == load_sensor("mlx75027")
    pure = replace(without(mine, *({*PERFECT} - {"wiggling"})), width=40, height=30)
    light = np.exp(2j * np.pi * np.linspace(0, 1, 1200)).reshape(30, 40, 1) * np.ones(3)
    seen, around = BinnedCamera(pure, HZ, 40, 30).mean(light), light**4
    third, fifth = np.array(list(WAVES.values())).T
    expected = light * (1 + third / around + fifth * around)
    assert np.abs(np.angle(seen / expected)).max() < 2 * lowered * 0.108 + 1e-3


def test_noise_and_phase_offsets_leave_the_phase_error_as_certain_as_said(tmp_path):
    series = [z * (1 + 5e-3 * noise(z.shape, seed)) for seed, z in enumerate(images())]
    found = captured_waves(written(tmp_path, series))
    wrong = np.subtract(*found.fit.harmonics[:, :2].T) - [fifth - third for third, fifth in WAVES.values()]
    assert (np.abs(wrong) < 3 * found.fit.phase_error_std).all()
    assert found.fit.phase_error_std.max() < 5e-3
    assert repr(found).split("\n") == [f"CapturedWaves: {found.sentences[0]}", "3 more in sentences"]


def test_harmonics_that_the_steps_do_not_show_stay_those_of_the_camera(tmp_path):
    camera = tmp_path / "three.toml"
    camera.write_text('extends = "calibrated"\nphase_steps = 4\nharmonics = [[20e6, [0.02, 0.0, 0.03]]]\n')
    found = captured_waves(written(tmp_path, images()), camera)
    assert {h: harmonics(found.sensor, 20e6)[h] for h in (2, 4)} == {2: 0.02, 4: 0.03}
    assert found.sensor.wiggling_left == 1
    assert max(harmonics(found.sensor, 20e6)) == 9  # higher ones fold, too, and are not in the series
    write_captured_waves(found, tmp_path / "mine.toml")
    assert load_sensor(tmp_path / "mine.toml") == found.sensor
    (tmp_path / "below").mkdir()
    with pytest.raises(NightError, match="write it beside that file"):
        write_captured_waves(found, tmp_path / "below" / "mine.toml")


def test_phases_turned_after_the_measurement_show_the_same_harmonics_with_a_warning(tmp_path):
    found = captured_waves(written(tmp_path, images(turned_rad=0.2)))
    assert found.fit.turned_rad[0] == pytest.approx(0.2, abs=0.01)
    assert found.fit.harmonics[0, 1] == pytest.approx(0.108, abs=1e-3)
    assert "warning: the error at 20 MHz is that of phases before an offset of 200 mrad" in found.sentences[0]
    assert not any("warning" in each for each in captured_waves(written(tmp_path, images())).sentences)


@pytest.mark.parametrize(
    ("series_m", "hz"), [((1.0,), HZ), ((1.0, 1.2), HZ), ((2.0, 2.3), HZ[:1])], ids=["one", "two", "20-MHz"]
)
def test_a_series_within_a_part_of_a_period_is_refused(tmp_path, series_m, hz):
    with pytest.raises(
        CaptureError, match=r"add captures at other distances, over at least 1\.87 m, a period"
    ):
        captured_waves(written(tmp_path, images(series_m, hz), hz))


def test_waves_of_other_steps_are_refused(tmp_path):
    with pytest.raises(CaptureError, match=r"waves of 16 phase steps leave \d+ mrad .* at 20 MHz"):
        captured_waves(written(tmp_path, images()), "sixteen-steps")


def test_what_is_no_series_of_walls_is_refused(tmp_path):
    (wall,) = images(SERIES_M[:1])
    files = [written(tmp_path, [noise(wall.shape)]), written(tmp_path, [wall[..., :2]], HZ[:2], "two.npz")]
    with pytest.raises(CaptureError, match=r"two\.npz has 20, 50 MHz, and .*walls\.npz 20, 50, 60 MHz"):
        captured_waves(files)
    with pytest.raises(CaptureError, match=r"walls\.npz shows no flat wall"):
        captured_waves(files[0])


def test_the_command_writes_the_camera_file(tmp_path):
    out = tmp_path / "mine.toml"
    command = ("night-eval", "capture", "waves", written(tmp_path, images()), "--out", out)
    done = night_here(*command, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["phase_errors_rad"][0] == pytest.approx(0.108 - 0.031, abs=3e-3)
    assert load_sensor(out).harmonics[0][1][1] == round(told["harmonics"][0][1], 4)
    assert f"phase error is {1e3 * told['phase_errors_rad'][0]:.1f} ± " in done.stderr
    assert "mrad, instead of 73.4" in done.stderr  # of mlx75027
    assert "mine.toml exists already" in refusal(*command)
    assert "must end in .toml" in refusal(*command[:-1], tmp_path / "mine.txt")
