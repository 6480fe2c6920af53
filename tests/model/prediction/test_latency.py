"""The benchmark of latency measures whole predictions."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "latency.py"


def table(*words):
    done = subprocess.run(
        [sys.executable, BENCHMARK, *map(str, words)], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    rows = [line.strip("|").split("|") for line in done.stdout.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows[1:]]


@pytest.mark.thorough
@pytest.mark.parametrize("preset", ["default", "paper", "ablation-20mhz"])
def test_an_untrained_network_of_any_preset_is_measured_at_every_size(preset):
    rows = table(
        "--preset", preset, "--size", "32x24", "--size", "80x60", "--seconds", "0.1", "--device", "cpu"
    )
    assert [row[1] for row in rows] == ["32 x 24", "80 x 60"]
    for row in rows:
        calls, median, late, rate = map(float, row[3:])
        assert calls >= 20
        assert 0 < median <= late
        # Both are rounded to a tenth: the rate of a median that is off by 0.05 ms, off by 0.05 itself.
        low, high = 1000 / (median + 0.05) - 0.05, 1000 / (median - 0.05) + 0.05
        assert low <= rate <= high


@pytest.mark.long
def test_a_run_is_measured_at_its_own_size(finished_run):
    ((name, size, device, *_),) = table("--run", finished_run, "--seconds", "0.1", "--device", "cpu")
    assert (name, size) == ("run", "24 x 14")
    assert re.match(r"CPU \(\w+\)", device)
