"""Small training runs on closed-form scenes, and ways to interrupt and to change them.

What is changed here gets a new checksum; a test of damage changes the bytes themselves.
"""

import contextlib
import json

import torch
from safetensors.torch import load_file

from model.run_folder.checksums import with_checksum
from model.run_folder.weights import save_weights
from model.settings import TrainSettings
from model.training.checkpoint import save_checkpoint
from model.training.loop import train

FLIP = {"flip_columns": False, "rotation_deg": 0.0, "translation": 0.0}
QUICK = {
    "width": 2,
    "batch_size": 3,
    "max_epochs": 2,
    "learning_rate": 1e-3,
    "progress": False,
    "device": "cpu",
    "flip_columns": True,
    "rotation_deg": 180.0,
    "translation": 0.2,
}

SEEING = FLIP | {"width": 8, "batch_size": 2, "max_epochs": 10, "learning_rate": 2e-3}


def settings(**changes) -> TrainSettings:
    return TrainSettings(**(QUICK | changes))


def train_on_one_thread(dataset, out, **changes):
    """Folder of a finished run; for fixtures of a session, whose number of threads no module decides."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        train(dataset, out, settings(**changes))
    finally:
        torch.set_num_threads(threads)
    return out


def checkpoint(run) -> dict:
    return torch.load(run / "checkpoint.pt", weights_only=True)


def config_of(run) -> dict:
    return json.loads((run / "run.json").read_text())


def edit_config(run, **changes) -> None:
    zeros = {"sha256": "0" * 64}  # the last key
    text = json.dumps({**config_of(run), **changes, **zeros}, indent=2) + "\n"
    (run / "run.json").write_bytes(with_checksum(text.encode(), '"sha256": "'))


def edit_settings(run, **changes) -> None:
    edit_config(run, settings=config_of(run)["settings"] | changes)


def edit_weights(run, change) -> None:
    """Replace each weight by `change(name, weight)`."""
    weights = load_file(run / "best.safetensors")
    changed = {name: change(name, weight) for name, weight in weights.items()}
    save_weights(run, changed, config_of(run)["run_id"])


def blind(run) -> None:
    """Make the network answer 0 everywhere."""
    last = max(name for name in load_file(run / "best.safetensors") if name.startswith("head."))
    edit_weights(run, lambda name, weight: 0 * weight if name[:6] == last[:6] else weight)


def edit_checkpoint(run, **parts) -> None:
    save_checkpoint(run, checkpoint(run) | parts, config_of(run)["run_id"])


def assert_same_end(run, other) -> None:
    """Weights, best weights and history of two runs are the same to the bit."""
    for file in ("best.safetensors", "history.csv"):
        assert (run / file).read_bytes() == (other / file).read_bytes()
    found, expected = (checkpoint(folder)["network"] for folder in (run, other))
    assert found.keys() == expected.keys()
    for name, weight in expected.items():
        assert torch.equal(found[name], weight), name


@contextlib.contextmanager
def before_each_network(action):
    """Call `action` with every network that is about to compute a batch."""

    def call(module: torch.nn.Module, *_: object) -> None:
        if type(module).__name__ == "UNet":
            action(module)

    handle = torch.nn.modules.module.register_module_forward_pre_hook(call)
    try:
        yield
    finally:
        handle.remove()
