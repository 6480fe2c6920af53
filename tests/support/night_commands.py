"""The four commands, in this process or as processes of their own, and the smallest preset of all splits."""

import contextlib
import logging
import os
import re
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

from click.testing import CliRunner

import cli

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

# Two epochs, a schedule that may go on for longer, and no images of the corner: they take seconds to prepare.
TRAINING = ["--width", 4, "--max-epochs", 2, "--batch-size", 4, "--learning-rate", 1e-3]
TRAINING += ["--set", "optimiser.schedule=constant", "--set", "input.channels.bounce_images=false"]
_CHARTS = (
    "accuracy_histogram",
    "accuracy_paper",
    "roundness",
    "mae_histogram",
    "miou_histogram",
    "calibration_miou",
    "calibration_mae",
)
_CURVES = ("training_loss", "training_mae", "training_miou")
# Figures of a report, each as PNG and PDF.
FIGURES = {"best", "median", "worst", "scenes", "point_clouds", *_CHARTS, *_CURVES}
UNCERTAINTY = {"reliability", "expected_mae"}  # also, of a network that predicts probabilities

DEFECT = 70  # exit code of an exception that no input should cause


class Pipeline(NamedTuple):
    """A folder with ``data``, ``run`` and ``report``, and what the commands that made them said."""

    folder: Path
    gen: subprocess.CompletedProcess
    render: subprocess.CompletedProcess
    train: subprocess.CompletedProcess
    eval: subprocess.CompletedProcess


def words(command, *arguments):
    """A command line whose program is this environment's."""
    return [str(word) for word in (Path(sys.executable).with_name(command), *arguments)]


def night(command, *arguments, cwd=None, **environment):
    """Run a command to its end, as a process of its own.

    Costs seconds of imports: for claims about the process itself (signals, exit by kill, limits, what C
    libraries print, side effects of imports) and for commands that start worker processes beside Blender.
    """
    return subprocess.run(
        words(command, *arguments),
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**os.environ, **environment},
    )


def night_here(command, *arguments, cwd=None, defect=False, **environment):
    """Run a command to its end in this process; the result has the attributes of `night`'s.

    Signal handlers, log handlers, warning filters, working directory and environment are afterwards those of
    before. Only what Python itself prints is captured. A warning is an error, as everywhere in the tests.

    Raises
    ------
    AssertionError : an exception that no input should cause (its traceback is the message), unless `defect`.
    """
    arguments = [str(word) for word in arguments]
    with _isolated(cwd):
        done = CliRunner(env=environment).invoke(_program(command), arguments, prog_name=command)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception  # not even the command line's own handler caught it
    assert defect or done.exit_code != DEFECT, done.stderr
    return subprocess.CompletedProcess([command, *arguments], done.exit_code, done.stdout, done.stderr)


def refusal(command, *arguments, **options):
    """The one sentence on stderr of a command that must end with exit code 2."""
    done = night_here(command, *arguments, **options)
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    _, *sentences = re.split("^Error: ", done.stderr, flags=re.MULTILINE)  # before it: usage, or the log
    assert len(sentences) == 1, done.stderr
    return " ".join(sentences[0].split())


def _program(command):
    return getattr(cli, command.replace("-", "_"))


@contextlib.contextmanager
def _isolated(cwd):
    """Give back what a command changes in its process."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    root = logging.getLogger()
    loggers, level, disabled = root.handlers[:], root.level, root.manager.disable
    root.handlers = []  # pytest's own: with them, the command would not install its handler
    root.setLevel(logging.WARNING)
    try:
        with contextlib.chdir(cwd or "."), warnings.catch_warnings():
            yield
    finally:
        root.handlers = loggers
        root.setLevel(level)
        logging.disable(disabled)
        for number, handler in handlers.items():
            signal.signal(number, handler)
