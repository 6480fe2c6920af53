"""Captures, phasors and films from the command line."""

import pytest
from night_commands import night_here, refusal

from itof import read_image


@pytest.mark.long
def test_transients_are_exported_and_filmed_from_the_command_line(seven_renders, tmp_path):
    out = tmp_path / "out"
    only = ("--only", "000002", "--out", out)
    for command in (
        ("convert", seven_renders, "--to", "tal", *only),
        ("convert", seven_renders, "--to", "itof", "--frequencies", "70,30", *only),
        ("movie", seven_renders, "000002", "--out", out / "light.mp4"),
    ):
        done = night_here("night-render", *command)
        assert done.returncode == 0, done.stderr
    assert {file.name for file in out.iterdir()} == {"000002.hdf5", "000002_itof.exr", "light.mp4"}
    assert read_image(out / "000002_itof.exr").phasors()[1] == (30e6, 70e6)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("convert", "--to", "tal"), "Missing option '--out'"),
        (("convert", "--to", "itof", "--out", "x", "--frequencies", "7,x"), "is no list of frequencies"),
        (("convert", "--to", "tal", "--out", "x", "--frequencies", "7"), "--frequencies goes with --to itof"),
        (("movie", "000009"), "no scene 000009"),
    ],
)
def test_exports_that_cannot_be_made_are_refused(seven_renders, tmp_path, command, words):
    name, *arguments = command
    sentence = refusal("night-render", name, seven_renders, *arguments, cwd=tmp_path)
    assert words in sentence
    assert list(tmp_path.iterdir()) == []
