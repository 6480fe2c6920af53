"""A changed bit anywhere in a run folder, or files of two runs in one, are refused in one sentence."""

import hashlib
import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from night_commands import refusal
from training_runs import (
    blind,
    config_of,
    edit_config,
    edit_settings,
    edit_weights,
    settings,
    train_on_one_thread,
)

from disk.checksums import labelled, with_checksum
from model.prediction.predictor import load
from model.run_folder.history import read_history
from model.run_folder.run_config import RunError, read_config, run_id_of
from model.training.checkpoint import load_checkpoint
from model.training.loop import train

pytestmark = pytest.mark.usefixtures("one_thread")
MOST = 10**6  # bytes of the weights of these small networks


def read_checkpoint(run):
    return load_checkpoint(run, read_config(run), MOST)


READERS = {
    "run.json": read_config,
    "best.safetensors": lambda run: load(run, "cpu"),
    "history.csv": read_history,
    "checkpoint.pt": read_checkpoint,
}


def flipped(content, position, bit):
    changed = bytearray(content)
    changed[position] ^= 1 << bit
    return bytes(changed)


def damaged(content, rng, count):
    """Flipped bits, cuts, additions, and blocks of zeros or of other bytes, at random places."""
    for position in rng.integers(len(content), size=count).tolist():
        yield flipped(content, position, int(rng.integers(8)))
        yield content[:position]
        yield content + bytes([position % 256])
        yield content[:position] + bytes(16) + content[position + 16 :]
        yield content[:position] + rng.bytes(16) + content[position + 16 :]
        yield content[:position] + content[position + 1 :]


def is_cut_between_lines(file, content, spoilt):
    """Whether only whole lines are missing at the end: what an earlier epoch wrote."""
    return file == "history.csv" and content.startswith(spoilt) and spoilt.endswith(b"\r\n")


@pytest.mark.parametrize("file", READERS)
def test_damage_of_any_file_of_a_run_is_refused(finished_copy, file):
    path, read = finished_copy / file, READERS[file]
    content = path.read_bytes()
    rng = np.random.default_rng(11)
    for spoilt in damaged(content, rng, 6):
        if spoilt == content or is_cut_between_lines(file, content, spoilt):
            continue
        path.write_bytes(spoilt)
        with pytest.raises(RunError, match=re.escape(str(path))):
            read(finished_copy)
    path.write_bytes(content)
    read(finished_copy)


def test_damage_says_in_the_commands_what_to_do(finished_copy, exr, closed_form_scenes, tmp_path):
    predict = ("night-eval", "predict", finished_copy, exr, "--out", tmp_path / "out")
    resume = ("night-train", closed_form_scenes.root, "--out", finished_copy, "--resume", "--max-epochs", 3)
    for file, command, words in (
        ("best.safetensors", predict, "write it again from the checkpoint with night-train --resume"),
        ("checkpoint.pt", resume, "the run cannot be resumed; use its best weights"),
        ("run.json", resume, "take the file from a copy of the run, or train again"),
    ):
        content = (finished_copy / file).read_bytes()
        (finished_copy / file).write_bytes(flipped(content, len(content) // 2, 3))
        message = refusal(*command)
        assert f"{finished_copy / file} is damaged" in message
        assert words in message
        (finished_copy / file).write_bytes(content)


def test_resuming_repairs_weights_and_history_from_the_checkpoint(
    closed_form_scenes, finished_run, finished_copy
):
    for file in ("best.safetensors", "history.csv"):
        content = (finished_copy / file).read_bytes()
        (finished_copy / file).write_bytes(flipped(content, len(content) // 2, 3))
    train(closed_form_scenes, finished_copy, settings(), resume=True)  # finished already
    for file in ("best.safetensors", "history.csv"):
        assert (finished_copy / file).read_bytes() == (finished_run / file).read_bytes()


@pytest.fixture(scope="module")
def other_run(closed_form_scenes, tmp_path_factory):
    """A run that differs in the seed alone."""
    return train_on_one_thread(closed_form_scenes, tmp_path_factory.mktemp("runs") / "other", seed=1)


def test_files_of_two_runs_in_one_folder_are_refused(
    closed_form_scenes, finished_run, finished_copy, other_run
):
    shutil.copy(other_run / "best.safetensors", finished_copy)
    with pytest.raises(RunError, match=r"best.safetensors belongs to another run than run.json"):
        load(finished_copy)
    shutil.copy(finished_run / "best.safetensors", finished_copy)
    shutil.copy(other_run / "checkpoint.pt", finished_copy)
    with pytest.raises(RunError, match=r"checkpoint.pt belongs to another run than run.json"):
        train(closed_form_scenes, finished_copy, settings(max_epochs=3), resume=True)
    shutil.copy(finished_run / "checkpoint.pt", finished_copy)
    shutil.copy(other_run / "run.json", finished_copy)
    with pytest.raises(RunError, match="belongs to another run"):
        load(finished_copy)


def test_the_id_of_a_run_depends_on_what_decides_its_weights(finished_run):
    config = read_config(finished_run)
    assert config.run_id == run_id_of(config)
    for change, same in (
        ({"max_epochs": 3, "checkpoint_minutes": 0.5, "device": "auto"}, True),
        ({"max_epochs": 3, "schedule": "cosine"}, False),
        ({"width": 3}, False),
        ({"levels": 4}, False),
        ({"seed": 1}, False),
    ):
        changed = replace(config, settings=settings(**change))
        assert (run_id_of(changed) == config.run_id) == same, change
    assert run_id_of(replace(config, night_version="9")) == config.run_id
    assert run_id_of(replace(config, data_sha256="0" * 64)) != config.run_id


def test_what_a_hostile_run_json_claims_is_refused(finished_copy):
    good = config_of(finished_copy)
    for change, words in (
        ({"run_id": "x"}, "run_id"),
        ({"run_id": None}, "run_id"),
        ({"image_width": 10**12}, "image_width"),
        ({"schema_version": 3}, "schema version"),
        ({"schema_version": [3]}, "schema version"),
        ({"settings": None}, "settings"),
    ):
        edit_config(finished_copy, **good | change)
        with pytest.raises(RunError, match=words):
            read_config(finished_copy)


def relabelled(run, content):
    """Write foreign bytes as weights, with a right label in the place of the old one."""
    (run / "best.safetensors").write_bytes(labelled(content))


@pytest.mark.parametrize("count", [60, pytest.param(3000, marks=pytest.mark.thorough)])
def test_foreign_bytes_under_a_right_checksum_are_finite_weights_or_refused(finished_copy, count):
    content = (finished_copy / "best.safetensors").read_bytes()
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(count):
        end = int(rng.choice([8, 600, len(content)]))  # length of the header, header, tensors
        relabelled(finished_copy, flipped(content, int(rng.integers(end)), int(rng.integers(8))))
        try:
            network = load(finished_copy, "cpu").network
        except RunError as error:
            refused += str(finished_copy / "best.safetensors") in str(error)
        else:
            assert all(weight.isfinite().all() for weight in network.parameters())
    assert refused > count / 3


@pytest.mark.parametrize(
    "change",
    [
        lambda name, weight: weight.double(),
        lambda name, weight: weight[..., :1],
        lambda name, weight: weight * math.inf,
        lambda name, weight: weight * math.nan,
    ],
)
def test_weights_that_are_none_of_this_network_are_refused(finished_copy, change):
    edit_weights(finished_copy, change)
    with pytest.raises(RunError, match=r"safetensors holds weights (of another arch|that are NaN or inf)"):
        load(finished_copy, "cpu")


@pytest.mark.parametrize("file", ["best.safetensors", "checkpoint.pt"])
def test_a_file_without_a_label_is_refused(finished_copy, file):
    content = (finished_copy / file).read_bytes()
    (finished_copy / file).write_bytes(content.replace(b"NIGHT run", b"other run"))
    with pytest.raises(RunError, match="no checksum"):
        READERS[file](finished_copy)


def test_a_run_of_an_earlier_schema_is_refused_with_what_to_do(finished_copy):
    edit_config(finished_copy, schema_version=3)
    with pytest.raises(RunError, match=r"schema version 3, .* train again, or use the version of NIGHT that"):
        load(finished_copy, "cpu")


def test_weights_that_are_blind_but_vouched_for_are_used(finished_copy):
    blind(finished_copy)
    load(finished_copy, "cpu")
    edit_settings(finished_copy, mask_threshold=0.25)
    assert load(finished_copy, "cpu").config.readout.mask_threshold == 0.25


def test_a_checksum_is_the_sha_256_of_the_file_with_zeros_in_its_place():
    zeros = b"sum: " + 64 * b"0" + b" end"
    digest = hashlib.sha256(zeros).hexdigest()
    assert with_checksum(zeros, "sum: ") == zeros.replace(64 * b"0", digest.encode())
