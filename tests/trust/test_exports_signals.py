"""Signals while HDF5 or zarr writes: no crash, the exit code of the signal, and no file."""

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "support" / "signal_points.py"


def after_each_signal(stride, out, *words):
    """(exit code, files left) for signals that come ever later."""
    command = [sys.executable, PROGRAM, stride, out, *words]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    return [(int(line[1]), int(line[2])) for line in lines if line[0] == "ended"]


@pytest.mark.parametrize(
    ("name", "stride"),
    [("x.h5", 120), *(pytest.param(f"x.{end}", 21, marks=pytest.mark.long) for end in ("h5", "zarr"))],
)
def test_a_signal_while_a_dataset_is_exported(closed_form_scenes, tmp_path, name, stride):
    out = tmp_path / "out"
    *signalled, whole = after_each_signal(stride, out, "export", closed_form_scenes.root, "--out", out / name)
    assert len(signalled) >= 4
    assert set(signalled) == {(143, 0)}
    assert whole == (0, 1)


@pytest.mark.long
def test_a_signal_while_captures_for_tal_are_written(seven_renders, tmp_path):
    out = tmp_path / "out"
    *signalled, whole = after_each_signal(
        7, out, "convert", seven_renders, "--to", "tal", "--only", "000002", "--out", out
    )
    assert len(signalled) >= 4
    assert set(signalled) == {(143, 0)}
    assert whole == (0, 1)
