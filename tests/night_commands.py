"""The four commands as processes of their own, and the smallest preset that has every split."""

import os
import subprocess
import sys
from pathlib import Path

# Seven scenes: with the paper's classes and fractions 4 train, 2 validation and 1 test.
PRESET = """
[dataset]
count = 7
seed = 3
[camera]
width = 24
height = 18
[transient]
bin_count = 1400
"""

_CHARTS = ("accuracy_histogram", "mae_histogram", "miou_histogram", "calibration_miou", "calibration_mae")
_CURVES = ("training_loss", "training_mae", "training_miou")
FIGURES = {f"{name}.png" for name in ("best", "median", "worst", *_CHARTS, *_CURVES)}  # of a report


def words(command, *arguments):
    """A command line whose program is this environment's."""
    return [str(word) for word in (Path(sys.executable).with_name(command), *arguments)]


def night(command, *arguments, **environment):
    """Run a command to its end."""
    return subprocess.run(
        words(command, *arguments),
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
