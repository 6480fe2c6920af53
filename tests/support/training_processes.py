"""``night-train`` as processes of their own, one or several of a training."""

import os
import subprocess
import sys
import time

from night_commands import words
from training_runs import FLIP, preset_text, settings

TORCHRUN = (sys.executable, *("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"))
COURSE = FLIP | {"width": 4, "batch_size": 4}


def start(dataset, out, *options, launcher=(), environment=(), **changes) -> subprocess.Popen:
    """A process of ``night-train`` by `settings` with the same changes."""
    preset = out.with_suffix(".toml")
    preset.write_text(preset_text(settings(**COURSE | changes)))
    command = words("night-train", dataset.root, "--out", out, "--preset", preset, *options)
    with errors_of(out).open("a") as errors:
        return subprocess.Popen(
            [*launcher, *command],
            env=os.environ | {"OMP_NUM_THREADS": "1"} | dict(environment),
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )


def errors_of(out):
    """File with the stderr of all processes of a run."""
    return out.with_suffix(".stderr")


def wait_for_the_first_epoch(run, *processes) -> None:
    while not (run / "best.safetensors").exists() and all(process.poll() is None for process in processes):
        time.sleep(0.01)
