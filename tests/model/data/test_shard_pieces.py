"""Pieces of shards are used again; those whose renders changed, and only those, are built again."""

import json
import logging
import os
import shutil

import numpy as np
import pytest
from synthetic_dataset import edit_image, write_synthetic_dataset

from disk import sha256_of
from itof import ImageFileError
from model.data import shard_building
from model.data.renders import ShardError
from model.data.rows import RowLayout
from model.data.shards import open_shards
from scenegen import open_dataset

WIDTH, HEIGHT = 11, 7


@pytest.fixture
def dataset(tmp_path):
    return write_synthetic_dataset(tmp_path / "data", count=6, width=WIDTH, height=HEIGHT)


@pytest.fixture
def pairs(dataset, monkeypatch):
    """The same dataset, with shards in pieces of two scenes."""
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    return dataset


def inodes(dataset) -> dict[str, tuple[int, int]]:
    """Inode and time of each file of the shards; a file that is written again gets others."""
    found = {file: file.stat() for file in sorted(dataset.shard_folder.glob("*/*"))}
    # The inode alone may be that of a file that was deleted before.
    return {
        str(file.relative_to(dataset.shard_folder)): (stat.st_ino, stat.st_mtime_ns)
        for file, stat in found.items()
    }


def rewritten(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]]) -> set[str]:
    """Pieces that were written again; a piece is written whole or not at all."""
    changed = {name for name, file in after.items() if before.get(name) != file}
    pieces = {name.split("/")[0] for name in changed}
    assert changed == {name for name in after if name.split("/")[0] in pieces}
    return pieces


def test_arrays_of_a_piece_are_plain_npy_files(pairs):
    shards = open_shards(pairs)
    phasors = np.load(pairs.shard_folder / "000002" / "phasors.npy", mmap_mode="r")
    assert phasors.shape == (2, HEIGHT, WIDTH, 3)
    assert np.array_equal(phasors, shards.read([2, 3]).phasors)
    assert np.array_equal(np.load(pairs.shard_folder / "reference.npy"), shards.reference)


def test_fresh_shards_are_used_again_and_a_changed_render_rebuilds_its_piece_alone(pairs, caplog):
    caplog.set_level(logging.INFO)
    open_shards(pairs)
    assert "building 3 of 3 pieces" in caplog.text
    caplog.clear()
    shards, files = open_shards(pairs), inodes(pairs)
    before = shards.read(range(6))
    assert caplog.text == ""
    edit_image(pairs.render_folder("000002") / "mirrored.exr", depth_R=lambda depth: depth * np.float32(1.5))
    changed = open_shards(pairs)
    after = changed.read(range(6))
    assert "1 render changed, first renders/000002/mirrored.exr" in caplog.text
    assert rewritten(files, inodes(pairs)) == {"000002"}
    np.testing.assert_allclose(after.radial_depth_m[2], before.radial_depth_m[2] * 1.5, rtol=1e-6)
    others = [0, 1, 3, 4, 5]
    assert np.array_equal(after.radial_depth_m[others], before.radial_depth_m[others])
    assert changed.manifest.data_sha256 != shards.manifest.data_sha256


def test_more_scenes_rebuild_the_last_piece_and_add_new_ones(tmp_path, monkeypatch):
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    small = write_synthetic_dataset(tmp_path / "data", count=5, width=WIDTH, height=HEIGHT)
    before, files = open_shards(small).read(range(5)), inodes(small)
    large = write_synthetic_dataset(tmp_path / "data", count=8, width=WIDTH, height=HEIGHT)
    shards = open_shards(large)
    assert rewritten(files, inodes(large)) == {"000004", "000006"}
    assert np.array_equal(shards.read(range(5)).phasors, before.phasors)
    assert shards.ids(range(8)) == large.ids()


def test_pieces_that_another_process_has_built_in_the_meantime_are_taken(pairs, monkeypatch):
    write, built = shard_building.write_piece, {}

    def write_after_another_process(*arguments):
        if not built:
            monkeypatch.setattr(shard_building, "write_piece", write)
            open_shards(pairs)
            built.update(inodes(pairs))
        write(*arguments)

    monkeypatch.setattr(shard_building, "write_piece", write_after_another_process)
    shards = open_shards(pairs)
    assert rewritten(built, inodes(pairs)) == {"000000"}  # the piece that this process had begun
    assert shards.ids(range(6)) == pairs.ids()


def test_an_interrupted_build_goes_on_with_the_piece_it_was_at(pairs):
    path = pairs.render_folder("000005") / "itof.exr"
    kept = path.read_bytes()
    path.write_bytes(kept[:100])
    with pytest.raises(ImageFileError):
        open_shards(pairs)
    files = inodes(pairs)
    assert {name.split("/")[0] for name in files} == {"000000", "000002"}
    path.write_bytes(kept)
    shards = open_shards(pairs)
    assert rewritten(files, inodes(pairs)) == {"000004"}
    assert shards.read([5]).mask.sum() > 0


@pytest.mark.parametrize("name", ["phasors.npy", "mask.npy", "piece.json"])
@pytest.mark.parametrize("damage", ["truncated", "foreign", "missing"])
def test_damaged_pieces_are_noticed_and_alone_rebuilt(pairs, caplog, name, damage):
    expected, files = open_shards(pairs).read(range(6)), inodes(pairs)
    file = pairs.shard_folder / "000002" / name
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:-8] if damage == "truncated" else b"PK\x03\x04 not an array")
    caplog.set_level(logging.INFO)
    assert np.array_equal(open_shards(pairs).read(range(6)).phasors, expected.phasors)
    assert f"building 1 of 3 pieces of {pairs.shard_folder}: 000002/{name}" in caplog.text
    assert rewritten(files, inodes(pairs)) == {"000002"}


@pytest.mark.parametrize("damage", ["missing", "foreign"])
def test_a_damaged_reference_is_made_again(dataset, damage):
    expected, files = open_shards(dataset).reference, inodes(dataset)
    file = dataset.shard_folder / "reference.npy"
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(b"PK\x03\x04 not an array")
    assert np.array_equal(open_shards(dataset).reference, expected)
    assert inodes(dataset) == files


def test_images_of_one_row_or_column_have_a_reference(tmp_path):
    for width, height in ((11, 1), (1, 7)):
        dataset = write_synthetic_dataset(tmp_path / f"{width}", count=6, width=width, height=height)
        assert open_shards(dataset).reference.shape == (height, width, 3)


def test_another_split_or_camera_and_a_broken_manifest_leave_the_pieces(dataset):
    first, files = open_shards(dataset), inodes(dataset)
    index = json.loads((dataset.root / "dataset.json").read_text())
    index["scenes"][0]["split"] = "validation" if index["scenes"][0]["split"] != "validation" else "test"
    (dataset.root / "dataset.json").write_text(json.dumps(index))
    second = open_shards(open_dataset(dataset.root))
    assert 0 in second.rows(index["scenes"][0]["split"])
    index["preset"]["itof"]["frequencies_hz"] = [20e6, 50e6, 70e6]
    (dataset.root / "dataset.json").write_text(json.dumps(index))
    with pytest.raises(ShardError, match="rendered at 20, 50, 60 MHz, the dataset asks for 20, 50, 70 MHz"):
        open_shards(open_dataset(dataset.root))
    index["preset"]["itof"]["frequencies_hz"] = [20e6, 50e6, 60e6]
    index["preset"]["camera"]["horizontal_fov_deg"] = 50.0
    (dataset.root / "dataset.json").write_text(json.dumps(index))
    scene = json.loads((dataset.scene_folder("000000") / "scene.json").read_text())
    scene["camera"]["horizontal_fov_deg"] = scene["emitter"]["horizontal_fov_deg"] = 50.0
    (dataset.scene_folder("000000") / "scene.json").write_text(json.dumps(scene))
    third = open_shards(open_dataset(dataset.root))
    (dataset.shard_folder / "manifest.json").write_text("{")
    fourth = open_shards(open_dataset(dataset.root))
    assert inodes(dataset) == files
    assert not np.allclose(third.reference, first.reference, rtol=1e-3)
    assert fourth.manifest == third.manifest
    hashes = {shards.manifest.data_sha256 for shards in (first, second, third)}
    assert len(hashes) == 3


def test_shards_of_schema_version_2_are_replaced(pairs):
    """They had F real parts, then F imaginary parts, before the axes of the image."""
    before, folder = open_shards(pairs), pairs.shard_folder
    expected = before.read(range(6))
    for file in (*folder.glob("*/phasors.npy"), folder / "reference.npy"):
        z = np.load(file)
        np.save(file, np.moveaxis(np.concatenate([z.real, z.imag], axis=-1), -1, -3))
    for record in folder.glob("*/piece.json"):
        text = json.loads(record.read_text())
        text["files"]["phasors.npy"] = sha256_of(record.with_name("phasors.npy"))
        record.write_text(json.dumps(text))
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest |= {"schema_version": 2, "reference_sha256": sha256_of(folder / "reference.npy")}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    after = open_shards(pairs)
    assert after.manifest == before.manifest
    assert np.array_equal(after.reference, before.reference)
    assert np.array_equal(after.read(range(6)).phasors, expected.phasors)


def test_pieces_of_another_size_go(pairs, monkeypatch):
    open_shards(pairs)
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 3 * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    open_shards(pairs)
    assert {name.split("/")[0] for name in inodes(pairs)} == {"000000", "000003"}


def test_files_of_the_same_size_time_and_inode_are_not_read_again(pairs, caplog):
    open_shards(pairs)
    render = pairs.render_folder("000001") / "itof.exr"
    array = pairs.shard_folder / "000002" / "mask.npy"
    long_ago_ns = 1_600_000_000_000_000_000
    for file in (*pairs.root.glob("renders/*/*"), *pairs.shard_folder.rglob("*.npy")):
        os.utime(file, ns=(long_ago_ns, long_ago_ns))  # files younger than 2 s are always read again
    open_shards(pairs)
    for file in (render, array):
        content = bytearray(file.read_bytes())
        content[-1] ^= 1
        with file.open("r+b") as stream:
            stream.write(content)
        os.utime(file, ns=(long_ago_ns, long_ago_ns))
    caplog.set_level(logging.INFO)
    open_shards(pairs)
    assert caplog.text == ""
    # Without the file of hashes both are read, and the changes are noticed.
    (pairs.root / ".hashes.json").unlink()
    open_shards(pairs)
    assert "building 2 of 3 pieces" in caplog.text


def test_shards_that_are_renewed_while_they_are_in_use_are_not_mixed(pairs):
    before = open_shards(pairs)
    edit_image(pairs.render_folder("000003") / "mirrored.exr", depth_R=lambda depth: depth * np.float32(1.5))
    after = open_shards(pairs)
    assert np.array_equal(before.read([0, 5]).phasors, after.read([0, 5]).phasors)
    for rows in ([2], [2, 3]):
        with pytest.raises(ShardError, match="000002 changed while it was in use"):
            before.read(rows)
    shutil.rmtree(pairs.shard_folder / "000000")
    with pytest.raises(ShardError, match="000000 changed while it was in use"):
        after.read([1])


@pytest.mark.parametrize("place", ["000002/notes.txt", "2024/notes.txt", "000002/old/notes.txt"])
def test_files_of_the_user_in_the_folder_of_a_piece_are_refused_before_anything_changes(pairs, place):
    open_shards(pairs)
    edit_image(pairs.render_folder("000000") / "mirrored.exr", depth_R=lambda depth: depth * np.float32(1.5))
    mine = pairs.shard_folder / place
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("years of work")
    files = inodes(pairs)
    named = place.replace("old/notes.txt", "old")
    with pytest.raises(ShardError, match=f"{named}.* is none of the shards' files"):
        open_shards(pairs)
    assert inodes(pairs) == files
    assert mine.read_text() == "years of work"
