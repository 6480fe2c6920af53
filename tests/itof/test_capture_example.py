"""Frames of a wall from check to import; the page about captures has the keys of the sidecar."""

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
from night_commands import night_here

from itof import direct_phasors
from itof.capture.sidecar import Lens, Sidecar
from itof.files.measurement_files import read_measurement
from itof.wall.expected_wall import ExpectedWall

PAGE = (Path(__file__).parents[2] / "docs/guide/captures.md").read_text()


SIDECAR = """
layout = "taps"
arrays = ["raw"]
axes = ["frame", "row", "column", "frequency", "step", "tap"]
frequencies_hz = [20e6, 50e6, 60e6]
horizontal_fov_deg = 60.0
step_count = 4
tap_count = 2
bits = 16
"""


def save_frames():
    """Ten raw frames of an empty wall, with the shot noise of up to 20,000 electrons."""
    frequencies_hz = (20e6, 50e6, 60e6)
    plane = np.array([-0.5, 0.1, 0.6])  # points p of the wall have plane · p = 1; x right, y down, z forward
    camera = (np.eye(3), np.zeros(3))
    wall = direct_phasors(160, 120, 60.0, frequencies_hz, *camera, plane / (plane @ plane), plane)
    light = 20000 * wall / abs(wall).max()  # (row, column, frequency)
    steps = 2 * np.pi * np.arange(4) / 4
    differences = np.real(light[..., None] * np.exp(-1j * steps))  # (row, column, frequency, step)
    both = abs(light)[..., None]
    taps = np.stack([both + differences, both - differences], axis=-1) / 2
    raw = np.random.default_rng(0).poisson(taps, (10, *taps.shape))
    np.savez("frames.npz", raw=raw.astype("uint16"))


def test_frames_of_a_wall_are_imported_with_the_noise_of_their_electrons(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_frames()
    (tmp_path / "camera.toml").write_text(SIDECAR)
    how = ("--sidecar", "camera.toml", "--size", "40x30")
    for words in (
        ("check", "frames.npz", *how, "--out", "check.png"),
        ("import", "frames.npz", *how, "--out", "corner.npz"),
        ("check", "corner.npz"),
    ):
        done = night_here("night-eval", "capture", *words)
        assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("fine: nothing is wrong")
    wrong = night_here("night-eval", "capture", "check", "frames.npz", *how, "--set", "phase_sign = -1")
    assert wrong.returncode == 2
    assert "the phase falls with distance: conjugate?" in wrong.stderr
    found = read_measurement("corner.npz")
    wall = ExpectedWall.of_plane([-0.5, 0.1, 0.6], 40, 30, found.frequencies_hz, 60.0)
    # Shot noise of 4 steps (Lange and Seitz 2001), 10 frames and 16 sensor pixels
    electrons = 20000 * np.abs(wall.direct) / np.abs(wall.direct).max()
    ratios = (np.angle(found.phasors[0] / wall.direct) / np.sqrt(2 / 4 / (electrons * 10 * 16))) ** 2
    # 5 standard deviations of chi-squared; 5 %, as the brightest sensor pixel is brighter than its bin
    assert abs(ratios.mean() - 1) < 5 * np.sqrt(2 / ratios.size) + 0.05


def test_the_page_has_every_key_of_the_sidecar():
    keys = {field.name for each in (Sidecar, Lens) for field in fields(each)}
    table = PAGE[PAGE.index("## Sidecar") : PAGE.index("## Known formats")]
    assert keys - set(re.findall(r"`(\w+)`", table)) == set()
