"""Shards whose files were made to do harm, with hashes that fit: they are built again, never believed."""

import io
import json
import os

import numpy as np
import pytest
from synthetic_dataset import write_synthetic_dataset

from disk import sha256_of
from model.data.renders import ShardError
from model.data.shards import open_shards

HUGE = (10**6, 1000, 3000)  # 10.9 TiB of float32


@pytest.fixture
def dataset(tmp_path):
    return write_synthetic_dataset(tmp_path / "data", count=3, width=11, height=7)


def npy(values, **header):
    """The bytes of an array, with a header that says something else."""
    stream = io.BytesIO()
    complete = {"descr": values.dtype.str, "fortran_order": False, "shape": values.shape} | header
    np.lib.format.write_array_header_1_0(stream, complete)
    return stream.getvalue() + values.tobytes()


def pickled(values):
    stream = io.BytesIO()
    np.save(stream, np.array([values, None], dtype=object))
    return stream.getvalue()


FORGED = {
    "claims more than it has": lambda values: npy(values, shape=HUGE),
    "claims fewer": lambda values: npy(values, shape=(1, *values.shape[1:])),
    "another type": lambda values: npy(values.astype(np.complex128)),
    "another type of this size": lambda values: npy(
        values, descr=values.dtype.str.replace("f", "i")[:2] + "1"
    ),
    "another order": lambda values: npy(values, fortran_order=True),
    "pickled": pickled,
    "empty": lambda values: b"",
}


@pytest.mark.parametrize("forgery", FORGED)
@pytest.mark.parametrize("name", ["phasors", "mask"])
def test_a_forged_array_is_built_again_although_its_hash_fits(dataset, forgery, name):
    expected = open_shards(dataset).read(range(3))
    file, record = (dataset.shard_folder / "000000" / part for part in (f"{name}.npy", "piece.json"))
    file.write_bytes(FORGED[forgery](np.load(file)))
    vouched = json.loads(record.read_text())
    vouched["files"][file.name] = sha256_of(file)
    record.write_text(json.dumps(vouched))
    found = open_shards(dataset).read(range(3))
    np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("phasors", np.nan),
        ("target", np.inf),
        ("radial_depth_m", -1),
        ("radial_depth_m", np.nan),
        ("mask", 2),
    ],
)
def test_values_that_no_render_has_are_refused_although_their_hash_fits(dataset, name, value):
    open_shards(dataset)
    file, record = (dataset.shard_folder / "000000" / part for part in (f"{name}.npy", "piece.json"))
    values = np.load(file)
    values.reshape(3, -1)[1, 5] = value
    file.write_bytes(npy(values))
    vouched = json.loads(record.read_text())
    vouched["files"][file.name] = sha256_of(file)
    record.write_text(json.dumps(vouched))
    shards = open_shards(dataset)
    shards.read([0, 2])
    for rows in ([1], [0, 1, 2]):
        with pytest.raises(
            ShardError, match=f"{name}.npy holds NaN, infinite or impossible values.* delete the"
        ):
            shards.read(rows)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 10**9},
        {"width": 10**30, "height": 10**30},
        {"scenes": ["../../../victim", "000001", "000002"]},
        {"scenes": ["000000"]},
        {"frequencies_hz": [20e6]},
        {"sources": {"renders/../../victim": "0" * 64}},
    ],
)
def test_a_forged_record_of_a_piece_is_built_again(dataset, change):
    expected = open_shards(dataset)
    record = dataset.shard_folder / "000000" / "piece.json"
    forged = json.loads(record.read_text())
    change = dict(change)
    forged["contents"]["sources"] |= change.pop("sources", {})
    forged["contents"] |= change
    record.write_text(json.dumps(forged))
    found = open_shards(dataset)
    assert found.manifest == expected.manifest
    np.testing.assert_array_equal(found.read(range(3)).phasors, expected.read(range(3)).phasors)


@pytest.mark.parametrize("forgery", FORGED)
def test_a_forged_reference_is_made_again_although_its_hash_fits(dataset, forgery):
    expected = open_shards(dataset).reference
    file, manifest = (dataset.shard_folder / name for name in ("reference.npy", "manifest.json"))
    file.write_bytes(FORGED[forgery](np.load(file)))
    vouched = json.loads(manifest.read_text())
    vouched["reference_sha256"] = sha256_of(file)
    manifest.write_text(json.dumps(vouched))
    np.testing.assert_array_equal(open_shards(dataset).reference, expected)


def test_an_array_that_is_exchanged_while_it_is_in_use_is_not_read(dataset):
    shards = open_shards(dataset)
    file = dataset.shard_folder / "000000" / "target.npy"
    file.write_bytes(npy(np.load(file), shape=HUGE))
    for rows in ([0], [0, 1, 2]):
        with pytest.raises(ShardError, match="changed while it was in use"):
            shards.read(rows)


def test_a_reference_that_is_not_finite_is_refused_although_its_hash_fits(dataset):
    open_shards(dataset)
    file, manifest = (dataset.shard_folder / name for name in ("reference.npy", "manifest.json"))
    values = np.load(file)
    values[0, 1, 2] = np.nan
    file.write_bytes(npy(values))
    vouched = json.loads(manifest.read_text())
    vouched["reference_sha256"] = sha256_of(file)
    manifest.write_text(json.dumps(vouched))
    with pytest.raises(ShardError, match=r"reference\.npy holds NaN or infinite values.*: delete it"):
        open_shards(dataset)


@pytest.mark.parametrize("make", [os.mkfifo, lambda file: file.symlink_to("/dev/zero")], ids=["pipe", "zero"])
def test_a_pipe_or_an_endless_file_is_not_read(dataset, make):
    expected = open_shards(dataset)
    for name in ("manifest.json", "reference.npy"):
        (dataset.shard_folder / name).unlink()
        make(dataset.shard_folder / name)
        np.testing.assert_array_equal(open_shards(dataset).reference, expected.reference)
    for name in ("piece.json", "mask.npy"):
        file = dataset.shard_folder / "000000" / name
        kept = file.read_bytes()
        file.unlink()
        make(file)
        with pytest.raises(ShardError, match=f"{name} .*is none of the shards' files"):
            open_shards(dataset)
        file.unlink()
        file.write_bytes(kept)
