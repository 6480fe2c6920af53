"""A checkpoint with a right checksum holds a possible state of this training, or one sentence refuses it."""

import copy
import io
import math
import shutil
import zipfile

import numpy as np
import pytest
import torch
from night_commands import refusal
from training_runs import checkpoint, config_of, train_on_one_thread

from disk.checksums import label_text, labelled
from model.prediction.predictor import load
from model.run_folder.run_config import RunError, read_config
from model.training.checkpoint import load_checkpoint, save_checkpoint
from model.training.checkpoint_contents import checked_position
from model.training.loop import train
from model.training.processes import Processes
from model.training.state import TrainingState

pytestmark = pytest.mark.usefixtures("one_thread")
COURSE = {
    "ema_decay": 0.5,
    "precision": "float16",
    "width": 1,
    "max_epochs": 1,
    "optimiser": "muon",
}  # every part
MOST = 10**6
MISSING = object()
LOSSES = ("train_loss", "validation_loss", "validation_uncertainty", "loss_total")


@pytest.fixture(scope="module")
def full_run(closed_form_scenes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("full") / "run"
    return train_on_one_thread(closed_form_scenes, folder, **COURSE)


@pytest.fixture(scope="module")
def restore(full_run, shards):
    """Load the contents of a checkpoint into the state of this training."""
    state = TrainingState(read_config(full_run), shards, Processes(torch.device("cpu")), None)
    return lambda contents: state.restore(contents, full_run / "checkpoint.pt")


def run_id(run):
    return config_of(run)["run_id"]


def places(value, path=()):
    """(path, value) of a nested structure, of its parts and of their parts."""
    yield path, value
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield from places(part, (*path, key))


def replaced(contents, path, value):
    """A copy with another value at `path`; without the entry if the value is MISSING."""
    key, *rest = path
    changed = copy.copy(contents)
    if rest:
        changed[key] = replaced(contents[key], rest, value)
    elif value is MISSING:
        del changed[key]
    else:
        changed[key] = value
    return changed


def wrong_tensors(tensor):
    yield tensor.double() if tensor.dtype != torch.float64 else tensor.float()
    yield torch.zeros(5, dtype=tensor.dtype)
    yield torch.zeros((*tensor.shape, 1), dtype=tensor.dtype)
    yield torch.empty(tensor.shape, dtype=tensor.dtype, device="meta")
    yield torch.zeros(tensor.shape, dtype=tensor.dtype).to_sparse()
    if tensor.is_floating_point():
        yield torch.full_like(tensor, math.nan)


def wrong(value):
    """Values that cannot stand where `value` stands."""
    yield from ("1", b"1", [1, 2], {"a": 1}, (1,), math.nan, math.inf, -1.5, 10**30, -1, torch.zeros(3))
    if not isinstance(value, bool):
        yield True
    if isinstance(value, torch.Tensor):
        yield from wrong_tensors(value)
    if isinstance(value, int | float):
        yield str(value)
        yield torch.tensor(value)
    if isinstance(value, dict):
        yield value | {"more": 1}
        yield {}
    if isinstance(value, list):
        yield [*value, 1]
        yield []
    yield MISSING
    if value is not None:
        yield None


def mutations(contents):
    """(path, value) of every single change; of tensors or list items side by side only the first."""
    done = set()
    for path, value in places(contents):
        is_one_of_many = isinstance(value, torch.Tensor) or (path and isinstance(path[-1], int))
        kind = (path[:-1], type(path[-1])) if is_one_of_many else path
        if path and kind not in done:
            done.add(kind)
            # With depths that expect their errors, a loss may be below 0.
            left_out = (-1.5, -1) if path[-1] in LOSSES else ()
            yield from ((path, other) for other in wrong(value) if repr(other) not in map(repr, left_out))


def message_of(read, *arguments):
    """What a refusal says; None if there is none."""
    try:
        read(*arguments)
    except RunError as error:
        return str(error)
    return None


def accepted(contents, changes, restore):
    """The changes that no one refused in one sentence."""
    for path, value in changes:
        said = message_of(restore, replaced(contents, path, value))
        if said is None or "run/checkpoint.pt" not in said or "\n" in said:
            yield path, value, said


@pytest.fixture(scope="module")
def contents(full_run):
    return load_checkpoint(full_run, read_config(full_run), MOST)


def test_a_changed_part_of_a_checkpoint_is_refused(contents, restore):
    restore(contents)
    changes = list(mutations(contents))
    chosen = np.random.default_rng(3).choice(len(changes), size=80, replace=False)
    assert list(accepted(contents, [changes[index] for index in chosen], restore)) == []
    restore(contents)


@pytest.mark.thorough
def test_every_single_change_of_a_checkpoint_is_refused(contents, restore):
    changes = list(mutations(contents))
    assert len(changes) > 800
    assert list(accepted(contents, changes, restore)) == []


def test_a_training_whose_losses_are_below_0_goes_on(contents, restore):
    negative = replaced(contents, ("history", 0, "validation_loss"), -0.25)
    negative = replaced(negative, ("history", 0, "train_loss"), -0.5)
    assert message_of(restore, negative) is None
    assert checked_position({"batches": 1, "loss_total": -0.75}, 3, 8) == (1, -0.75)
    assert "impossible record" in message_of(
        restore, replaced(contents, ("history", 0, "validation_mae_cm"), -0.25)
    )
    restore(contents)


@pytest.mark.parametrize("missing", ["network", "optimisation", "best", "position", "history", "window_rows"])
def test_a_checkpoint_without_one_of_its_parts_is_refused(full_run, tmp_path, missing):
    run = shutil.copytree(full_run, tmp_path / "run")
    state = checkpoint(run)
    del state[missing]
    save_checkpoint(run, state, config_of(run)["run_id"])
    with pytest.raises(RunError, match=rf"checkpoint.pt lacks {missing}"):
        load_checkpoint(run, read_config(run), MOST)


def test_a_checkpoint_of_other_contents_is_refused_by_the_command(closed_form_scenes, finished_copy):
    position = {"batches": -1, "loss_total": 0.0}
    save_checkpoint(finished_copy, checkpoint(finished_copy) | {"position": position}, run_id(finished_copy))
    more = ("--out", finished_copy, "--resume", "--max-epochs", 3)
    message = refusal("night-train", closed_form_scenes.root, *more)
    assert "does not hold the state of this training (position.batches must be a whole number" in message


def foreign(archive, rng):
    """Other bytes under a right checksum: flipped bits, or another archive."""
    changed = bytearray(archive)
    for position in rng.integers(len(changed), size=int(rng.integers(1, 5))).tolist():
        changed[position] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def read_foreign(run, content):
    """Read a checkpoint of such bytes: it is refused, or the archive is still one."""
    label = label_text(run_id(run)).encode()
    (run / "checkpoint.pt").write_bytes(labelled(content[: -len(label)] + label))
    return message_of(load_checkpoint, run, read_config(run), MOST)


@pytest.mark.parametrize("count", [20, pytest.param(3000, marks=pytest.mark.thorough)])
def test_foreign_bytes_under_a_right_checksum_are_refused(full_run, tmp_path, count):
    run = shutil.copytree(full_run, tmp_path / "run")
    archive = (run / "checkpoint.pt").read_bytes()
    head = archive.index(b"data/0")  # the pickle comes first
    rng = np.random.default_rng(5)
    said = [read_foreign(run, foreign(archive[:head], rng) + archive[head:]) for _ in range(count)]
    assert sum(message is not None for message in said) > count / 2
    assert all(
        "damaged or no checkpoint" in message or "schema" in message or "lacks" in message
        for message in said
        if message
    )


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_an_archive_that_grows_when_it_is_unpacked_is_refused(full_run, tmp_path, compression):
    run = shutil.copytree(full_run, tmp_path / "run")
    label = label_text(run_id(run)).encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        with zipfile.ZipFile(run / "checkpoint.pt") as old:
            for file in old.infolist():
                archive.writestr(file.filename, old.read(file))
        archive.comment = label
    (run / "checkpoint.pt").write_bytes(labelled(stream.getvalue()))
    if compression == zipfile.ZIP_STORED:
        assert load_checkpoint(run, read_config(run), MOST)
    else:
        with pytest.raises(RunError, match="damaged or no checkpoint"):
            load_checkpoint(run, read_config(run), MOST)


def test_a_checkpoint_that_is_larger_than_any_of_this_network_is_not_read(full_run, tmp_path):
    run = shutil.copytree(full_run, tmp_path / "run")
    for file, read in (
        ("checkpoint.pt", lambda: load_checkpoint(run, read_config(run), MOST)),
        ("best.safetensors", lambda: load(run, "cpu")),
    ):
        with (run / file).open("r+b") as stream:
            stream.truncate(2**40)  # a sparse file
        with pytest.raises(RunError, match=rf"{file}.*{2**40} bytes"):
            read()


def test_a_checkpoint_that_is_too_short_for_its_network_is_refused_before_the_network_is_made(
    full_run, closed_form_scenes, tmp_path, monkeypatch
):
    run = shutil.copytree(full_run, tmp_path / "run")
    with (run / "checkpoint.pt").open("r+b") as stream:
        stream.truncate(1000)
    monkeypatch.setattr("model.training.loop.TrainingState", lambda *_: pytest.fail("the network was made"))
    with pytest.raises(RunError, match=r"it has 1000 bytes, and the network of run\.json takes at least"):
        train(closed_form_scenes, run, read_config(run).settings, resume=True)
