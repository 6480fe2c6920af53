"""Small training runs on closed-form scenes, and ways to interrupt and to change them.

What is changed here gets a new checksum; a test of damage changes the bytes themselves.
"""

import contextlib
import json
from dataclasses import asdict, is_dataclass

import torch
from safetensors.torch import load_file

from disk.checksums import with_checksum
from model.run_folder.weights import save_weights
from model.settings.keys import all_keys, merged, tables
from model.settings.train_settings import TrainSettings, flat_settings, settings_from_dict
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

# A network like the paper's, with a plain optimiser and in float32: what the changes of a test begin with.
PLAIN = {
    "input": {"channels": {"kind": "paper+residual", "reference": "geometry", "bounce_images": False}},
    "network": {"width": 32, "levels": 5, "negative_slope": 0.0, "block": 1},
    "target": {"kind": "components"},
    "optimiser": {
        "algorithm": "adam",
        "learning_rate": 1e-4,
        "batch_size": 32,
        "schedule": "constant",
        "warm_up_epochs": 0.0,
        "clip_norm": 0.0,
        "ema_decay": 0.0,
    },
    "run": {"max_epochs": 1500, "patience": 150, "average_flip": False, "precision": "float32"},
}
NO_IMAGES = {"reference": "geometry", "bounce_images": False}
OF_KIND = {
    "residual": NO_IMAGES,
    "paper+residual": NO_IMAGES,
    "mask+depth": {"uncertainty": False, "smooth_l1_beta": 1.0},
}
# Names that tests use for keys of settings; the others are the last words of the keys.
NAMES = {
    "channels": "input.channels.kind",
    "target": "target.kind",
    "optimiser": "optimiser.algorithm",
    "sensor": "augmentation.camera.sensor",
    "sensor_capture": "augmentation.camera.empty_corner",
}
KEYS = {key.split(".")[-1]: key for key, _ in all_keys(TrainSettings) if ".sensor." not in key} | NAMES


def as_tables(**changes) -> dict:
    """Settings by their short names as tables, with the quiet choices of a test for each kind."""
    data = tables({KEYS.get(name, name): value for name, value in changes.items()})
    for table in (data.get("input", {}).get("channels", {}), data.get("target", {})):
        table |= OF_KIND.get(table.get("kind"), {}) | table
    return data


def settings(**changes) -> TrainSettings:
    plain = {name: asdict(value) if is_dataclass(value) else value for name, value in changes.items()}
    return settings_from_dict(merged(PLAIN, as_tables(**(QUICK | plain))), "a test")


def preset_text(chosen: TrainSettings) -> str:
    """A preset of these settings; TOML has no value for what is not set."""
    values = {key: value for key, value in flat_settings(chosen).items() if value is not None}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())


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
    edit_config(run, settings=merged(config_of(run)["settings"], as_tables(**changes)))


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
