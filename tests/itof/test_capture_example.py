"""The page about captures: its example runs, and its table has the keys of the sidecar."""

import re
import shlex
from dataclasses import fields
from pathlib import Path

import numpy as np
from night_commands import night_here

from itof.capture.sidecar import Lens, Sidecar
from itof.files.measurement_files import read_measurement
from itof.wall.expected_wall import ExpectedWall

PAGE = (Path(__file__).parents[2] / "docs/guide/captures.md").read_text()


def blocks(language):
    found = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)
    return [block.replace("\\\n", " ") for block in found]


def test_the_example_runs_and_ends_as_the_page_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(blocks("python")[0], {})  # noqa: S102
    (tmp_path / "camera.toml").write_text(blocks("toml")[0])
    for line in blocks("sh")[0].splitlines():
        done = night_here(*shlex.split(line))
        assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("fine: nothing is wrong")
    wrong = night_here(*shlex.split(blocks("sh")[1]))
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
