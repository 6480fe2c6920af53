"""Training in several processes, and training that is asked to stop: real processes, real signals."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from synthetic_dataset import write_synthetic_dataset

from model.settings import TrainSettings
from model.training.loop import train
from model.training.processes import Processes

TRAIN = """
import sys
from pathlib import Path
from model import TrainSettings, train
from scenegen import open_dataset
dataset, out, resume, changes = sys.argv[1:]
settings = TrainSettings(**eval(changes))
train(open_dataset(Path(dataset)), Path(out), settings, resume=resume == "resume")
"""
CPU = torch.device("cpu")
ROOT = Path(__file__).parent.parent
QUICK = {"width": 4, "batch_size": 4, "learning_rate": 1e-3, "progress": False, "device": "cpu"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=16)


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    file = tmp_path_factory.mktemp("script") / "train.py"
    file.write_text(TRAIN)
    return file


def start(script, dataset, out, *, processes=1, resume=False, **changes) -> subprocess.Popen:
    """A training of its own, by torchrun where it has several processes."""
    words = [script, dataset.root, out, "resume" if resume else "new", repr(QUICK | changes)]
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    command = [sys.executable, *(launcher if processes > 1 else []), *map(str, words)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    with errors_of(out).open("w") as errors:
        return subprocess.Popen(command, env=environment, stderr=errors)


def errors_of(out) -> Path:
    """What the processes of a run said on stderr."""
    return out.with_suffix(".stderr")


def run_to_the_end(script, dataset, out, **changes) -> None:
    assert start(script, dataset, out, **changes).wait() == 0, errors_of(out).read_text()


def checkpoint(run) -> dict:
    return torch.load(run / "checkpoint.pt", weights_only=True)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("batch", [1, 2, 3, 7, 8])
def test_shares_of_a_batch_are_all_of_it_once_and_the_lent_row_counts_nothing(count, batch):
    rows = list(range(10, 10 + batch))
    processes = [Processes(CPU, rank, count) for rank in range(count)]
    own = [p.share(rows)[: p.own(batch)] for p in processes]
    assert sorted(row for share in own for row in share) == rows
    assert all(p.share(rows) for p in processes)


@pytest.mark.parametrize("scenes_a_batch", [4, 5])  # nine scenes: batches of 4, 4, 1 and of 5, 4
def test_two_processes_train_the_network_of_one(script, dataset, tmp_path, scenes_a_batch):
    changes = {"batch_size": scenes_a_batch, "max_epochs": 2, "noise_sigma": 1e-3, "clip_norm": 1.0}
    changes["checkpoint_minutes"] = 0  # a checkpoint after every batch must not count anything twice
    for count in (1, 2):
        run_to_the_end(script, dataset, tmp_path / f"{count}", processes=count, **changes)
    one, two = (checkpoint(tmp_path / f"{count}") for count in (1, 2))
    begin = TrainSettings(**QUICK | changes)
    start_weights = first_weights(dataset, begin, tmp_path / "first")
    for name, weight in one["network"].items():
        way = float((weight - start_weights[name]).norm())
        # Sums in another order: rounding, grown by Adam's division by tiny gradients; not another step.
        assert float((two["network"][name] - weight).norm()) < 1e-2 * way, name
    for a, b in zip(one["history"], two["history"], strict=True):
        assert b == pytest.approx(a, rel=1e-3)


def first_weights(dataset, settings, out) -> dict[str, torch.Tensor]:
    """Weights before the first step, to float32: those after steps of 1e-30."""
    still = {name: getattr(settings, name) for name in settings.__dataclass_fields__}
    train(dataset, out, TrainSettings(**(still | {"learning_rate": 1e-30, "max_epochs": 1})))
    return checkpoint(out)["network"]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGINT, -signal.SIGINT)]
)
def test_a_stopped_training_goes_on_in_the_middle_of_its_epoch_to_the_same_weights(
    script, dataset, tmp_path, number, code
):
    changes = {"max_epochs": 60, "batch_size": 1, "ema_decay": 0.9, "schedule": "cosine"}
    run = tmp_path / "run"
    process = start(script, dataset, run, **changes)
    while not (run / "history.csv").exists() and process.poll() is None:
        time.sleep(0.01)
    time.sleep(0.05)
    process.send_signal(number)
    assert process.wait() == code, errors_of(run).read_text()
    stopped = checkpoint(run)
    assert 0 < len(stopped["history"]) < 60
    run_to_the_end(script, dataset, run, resume=True, **changes)
    run_to_the_end(script, dataset, tmp_path / "whole", **changes)
    a, b = checkpoint(run), checkpoint(tmp_path / "whole")
    assert a["history"] == b["history"]
    for name, weight in a["network"].items():
        assert torch.equal(weight, b["network"][name]), name
    best = "best.safetensors"
    assert (run / best).read_bytes() == (tmp_path / "whole" / best).read_bytes()


def test_two_processes_stop_together_and_go_on(script, dataset, tmp_path):
    run, changes = tmp_path / "run", {"max_epochs": 400, "batch_size": 2}
    process = start(script, dataset, run, processes=2, **changes)
    while not (run / "history.csv").exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    process.wait()
    done = len(checkpoint(run)["history"])
    assert 0 < done < 400, errors_of(run).read_text()
    run_to_the_end(script, dataset, run, processes=2, resume=True, **changes | {"max_epochs": done + 1})
    assert len(checkpoint(run)["history"]) == done + 1


@pytest.mark.skipif(shutil.which("g++") is None, reason="torch.compile needs a C++ compiler (Debian: g++)")
def test_a_compiled_network_trains_as_the_plain_one(script, dataset, tmp_path):
    for compiled in (False, True):
        run_to_the_end(script, dataset, tmp_path / str(compiled), max_epochs=1, compile=compiled)
    plain, fast = (checkpoint(tmp_path / str(compiled))["network"] for compiled in (False, True))
    for name, weight in plain.items():
        torch.testing.assert_close(fast[name], weight, rtol=1e-3, atol=1e-5, msg=name)
