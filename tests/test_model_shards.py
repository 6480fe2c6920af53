"""Shards: what they hold, and that nothing stale, missing or broken gets into them."""

import json
import logging
import os
import shutil

import numpy as np
import pytest
from synthetic_dataset import write_synthetic_dataset, write_synthetic_render

from itof import ImageFileError, direct_phasors, join_components, read_image, residual_channels, write_image
from model.data.channel_scaling import fit_input_spec
from model.data.pieces import scenes_per_piece
from model.data.renders import ShardError
from model.data.rows import RowLayout
from model.data.shards import open_shards
from scenegen import (
    DatasetError,
    FailureRecord,
    FileRecord,
    RenderRecord,
    camera_axes,
    open_dataset,
    sha256_of,
    wall_normal,
    write_failure,
    write_record,
)

WIDTH, HEIGHT = 11, 7


@pytest.fixture
def dataset(tmp_path):
    return write_synthetic_dataset(tmp_path / "data", count=6, width=WIDTH, height=HEIGHT)


def edit_image(path, **changes) -> None:
    """Rewrite some channels of an EXR image; names with dots are given with underscores."""
    image = read_image(path)
    channels = dict(image.channels)
    for name, change in changes.items():
        channels[name.replace("_", ".")] = change(channels[name.replace("_", ".")].copy())
    write_image(path, channels, {})


def with_nan(values):
    values[2, 3] = np.nan
    return values


@pytest.fixture
def pairs(dataset, monkeypatch):
    """The same dataset, with shards in pieces of two scenes."""
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    return dataset


def inodes(dataset) -> dict[str, int]:
    """Which file each file of the shards is; one that was written again is another."""
    files = sorted(dataset.shard_folder.glob("*/*"))
    return {str(file.relative_to(dataset.shard_folder)): file.stat().st_ino for file in files}


def rewritten(before: dict[str, int], after: dict[str, int]) -> set[str]:
    """Pieces whose files are other files now; a piece is rewritten whole or not at all."""
    changed = {name for name, inode in after.items() if before.get(name) != inode}
    pieces = {name.split("/")[0] for name in changed}
    assert changed == {name for name in after if name.split("/")[0] in pieces}
    return pieces


@pytest.mark.parametrize("piece_rows", [1, 2, 3, 4, 6])
def test_shards_hold_every_scene_as_it_was_rendered(dataset, monkeypatch, piece_rows):
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", piece_rows * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    shards = open_shards(dataset)
    assert [piece.contents.name for piece in shards.manifest.pieces] == dataset.ids()[::piece_rows]
    block = shards.read([5, 0, 4, 2, 1, 3])
    assert all(array.dtype == np.float32 for array in (block.phasors, block.target, block.radial_depth_m))
    for place, row in enumerate(block.rows):
        folder = dataset.render_folder(dataset.ids()[row])
        measured, frequencies_hz = read_image(folder / "itof.exr").phasors()
        truth = read_image(folder / "mirrored.exr")
        assert np.array_equal(block.complex_phasors()[place], measured)
        assert np.array_equal(join_components(np.moveaxis(block.target[place], 0, -1)), truth.phasors()[0])
        assert np.array_equal(block.radial_depth_m[place], truth.channel("depth.R"))
        assert np.array_equal(block.mask[place], truth.channel("mask.M"))
        assert shards.manifest.frequencies_hz == frequencies_hz
        # A row alone is sought in its piece, all of them are read with it.
        assert np.array_equal(shards.read([row]).phasors[0], block.phasors[place])
    splits = [shards.rows(split) for split in ("train", "validation", "test")]
    assert sorted(row for rows in splits for row in rows) == list(range(6))
    assert shards.ids(shards.rows("test")) == dataset.ids("test")


def test_arrays_of_a_piece_are_plain_npy_files(pairs):
    shards = open_shards(pairs)
    phasors = np.load(pairs.shard_folder / "000002" / "phasors.npy", mmap_mode="r")
    assert phasors.shape == (2, 6, HEIGHT, WIDTH)
    assert np.array_equal(phasors, shards.read([2, 3]).phasors)
    reference = np.load(pairs.shard_folder / "reference.npy")  # (2F, H, W)
    assert np.array_equal(join_components(np.moveaxis(reference, 0, -1)), shards.reference)


def test_a_piece_takes_at_most_128_mib_and_a_round_number_of_scenes():
    # 320 x 240 pixels of 37 bytes: 47.2 scenes fit; 40 x 30: 3022.9.
    assert [scenes_per_piece(RowLayout(*size, 3)) for size in ((320, 240), (40, 30))] == [40, 3000]
    assert scenes_per_piece(RowLayout(4000, 3000, 3)) == 1  # a scene of 444 MB is a piece


def test_the_reference_is_the_direct_return_so_the_residual_holds_hidden_light_alone(dataset):
    shards = open_shards(dataset)
    scene = dataset.scene(dataset.ids()[0])
    direct = direct_phasors(
        *(WIDTH, HEIGHT, scene.camera.horizontal_fov_deg, shards.manifest.frequencies_hz),
        *(camera_axes(scene.camera), scene.camera.location_m),
        *(scene.relay_wall.location_m, wall_normal(scene.relay_wall)),
    )
    # float32 rounds each component by 6e-8 of itself
    np.testing.assert_allclose(shards.reference, direct, rtol=1e-7, atol=1e-7 * np.abs(direct).max())
    bare = residual_channels(direct.astype(np.complex64), shards.reference)[:3]  # Im at each frequency
    assert np.abs(bare).max() < 1e-6
    hidden = residual_channels(shards.complex_phasors([0])[0], shards.reference)[:3]
    assert np.abs(hidden).max() > 1e-4


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
    assert "1 renders changed, first renders/000002/mirrored.exr" in caplog.text
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
    scene["camera"]["horizontal_fov_deg"] = 50.0
    (dataset.scene_folder("000000") / "scene.json").write_text(json.dumps(scene))
    third = open_shards(open_dataset(dataset.root))
    (dataset.shard_folder / "manifest.json").write_text("{")
    fourth = open_shards(open_dataset(dataset.root))
    assert inodes(dataset) == files
    assert not np.allclose(third.reference, first.reference, rtol=1e-3)
    assert fourth.manifest == third.manifest
    hashes = {shards.manifest.data_sha256 for shards in (first, second, third)}
    assert len(hashes) == 3


def test_shards_of_schema_version_1_are_replaced(pairs):
    folder = pairs.shard_folder
    folder.mkdir()
    for name in ("phasors", "target", "radial_depth_m", "mask", "reference"):
        np.save(folder / f"{name}.npy", np.zeros((6, HEIGHT, WIDTH)))
    (folder / "manifest.json").write_text('{"schema_version": 1}')
    shards = open_shards(pairs)
    assert np.abs(shards.reference).min() > 0
    assert json.loads((folder / "manifest.json").read_text())["schema_version"] == 2
    names = {entry.name for entry in folder.iterdir()}
    assert names == {"000000", "000002", "000004", "reference.npy", "manifest.json"}


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
        os.utime(file, ns=(long_ago_ns, long_ago_ns))  # files just written would be read again for safety
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
    # Without the memory of their hashes they are read, and both are noticed.
    (pairs.root / ".hashes.json").unlink()
    open_shards(pairs)
    assert "building 2 of 3 pieces" in caplog.text


def test_a_render_that_is_not_the_recorded_one_is_refused_and_one_without_record_is_not(dataset):
    for scene in ("000001", "000002"):
        folder = dataset.render_folder(scene)
        files = {
            file.name: FileRecord(bytes=file.stat().st_size, sha256=sha256_of(file))
            for file in folder.iterdir()
        }
        write_record(folder, RenderRecord(recipe="{}", attributes={}, files=files))
    open_shards(dataset)
    for scene in ("000000", "000001"):
        path = dataset.render_folder(scene) / "mirrored.exr"
        edit_image(path, depth_R=lambda depth: depth * np.float32(1.5))
    refused = r"scene 000001: .*mirrored.exr is not the file that night-render wrote.*run night-render"
    with pytest.raises(ShardError, match=refused):
        open_shards(dataset)
    path.write_bytes(b"no image")  # what is wrong can be said better than that
    with pytest.raises(ImageFileError, match="damaged or no EXR"):
        open_shards(dataset)


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


def test_scenes_that_could_not_be_rendered_are_left_out_until_they_can(dataset, caplog):
    whole, rows = open_shards(dataset), [0, 1, 3, 4, 5]
    expected = whole.complex_phasors(rows)
    failure = FailureRecord(recipe="", attempts=2, reason="its mesh is broken")
    kept = dataset.root / "kept"
    shutil.move(dataset.render_folder("000002"), kept)
    write_failure(dataset.render_folder("000002"), failure, "log")
    fewer = open_shards(dataset)
    assert "1 scenes that could not be rendered are left out, first 000002" in caplog.text
    assert fewer.ids(range(5)) == whole.ids(rows)
    assert np.array_equal(fewer.complex_phasors(range(5)), expected)
    shutil.rmtree(dataset.render_folder("000002"))
    shutil.move(kept, dataset.render_folder("000002"))
    assert open_shards(dataset).manifest.data_sha256 == whole.manifest.data_sha256


def test_a_scene_that_was_not_rendered_is_named(dataset):
    shutil.rmtree(dataset.render_folder("000004"))
    with pytest.raises(ShardError, match=r"scene 000004 has no itof.exr: run night-render"):
        open_shards(dataset)
    (dataset.render_folder("000001") / "mirrored.exr").unlink()
    with pytest.raises(ShardError, match=r"scene 000001 \(and 1 more of 6 scenes\) has no mirrored.exr"):
        open_shards(dataset)


@pytest.mark.parametrize(
    ("file", "channel"),
    [("itof.exr", "itof_50MHz_Im"), ("mirrored.exr", "depth_R"), ("mirrored.exr", "mask_M")],
)
def test_nan_in_a_render_names_scene_and_file_and_leaves_no_piece(dataset, file, channel):
    edit_image(dataset.render_folder("000003") / file, **{channel: with_nan})
    with pytest.raises(ShardError, match=f"scene 000003: .*{file} holds 1 values that are NaN"):
        open_shards(dataset)
    assert not list(dataset.root.glob("shards/*"))


def test_renders_of_several_sizes_are_refused_with_both_sizes(dataset):
    write_synthetic_render(dataset, dataset.scene("000005"), 12, 9)
    with pytest.raises(ShardError, match=r"wrong resolution.*000005 was rendered at 12x9.*000000 at 11x7"):
        open_shards(dataset)


def test_measurement_and_truth_of_different_sizes_are_refused(dataset):
    kept = (dataset.render_folder("000001") / "itof.exr").read_bytes()
    write_synthetic_render(dataset, dataset.scene("000001"), 12, 9)
    (dataset.render_folder("000001") / "itof.exr").write_bytes(kept)
    with pytest.raises(ShardError, match=r"wrong resolution.*000001 .* 11x7 .* 12x9"):
        open_shards(dataset)


def test_foreign_images_are_refused_by_name(dataset):
    path = dataset.render_folder("000000") / "mirrored.exr"
    truth = read_image(path)
    write_image(path, {n: v for n, v in truth.channels.items() if n != "mask.M"}, {})
    with pytest.raises(ShardError, match=r"000000: .*mirrored.exr is no depth map \(no channel mask.M"):
        open_shards(dataset)
    write_image(path, {"Y": np.zeros((HEIGHT, WIDTH))}, {})
    with pytest.raises(ShardError, match=r"000000: .*mirrored.exr is no depth map \(no channel depth.R"):
        open_shards(dataset)
    write_image(path, truth.channels | {"mask.M": np.full((HEIGHT, WIDTH), 0.5)}, {})
    with pytest.raises(ShardError, match=r"needs mask.M of 0 and 1"):
        open_shards(dataset)


def test_renders_at_other_frequencies_are_refused(dataset):
    path = dataset.render_folder("000000") / "itof.exr"
    image = read_image(path)
    write_image(path, {n: v for n, v in image.channels.items() if "50MHz" not in n}, {})
    with pytest.raises(ShardError, match="rendered at 20, 60 MHz, the dataset asks for 20, 50, 60 MHz"):
        open_shards(dataset)


def test_a_dataset_without_scene_descriptions_says_so(dataset):
    shutil.rmtree(dataset.root / "scenes")
    with pytest.raises(DatasetError, match=r"scene.json is missing"):
        open_shards(dataset)


@pytest.mark.parametrize(("channels", "count"), [("paper", 7), ("residual", 5), ("paper+residual", 12)])
def test_input_channels_are_scaled_by_the_training_scenes(dataset, channels, count):
    shards = open_shards(dataset)
    rows = shards.rows("train")
    spec = fit_input_spec(channels, shards, rows)
    network_input = spec.apply(shards.complex_phasors(rows), shards.reference)  # (N, C, H, W)
    assert spec.channel_count == count == network_input.shape[1]
    if "paper" in channels:
        assert network_input[:, 0].mean() == pytest.approx(1, rel=1e-5)
        np.testing.assert_allclose(np.hypot(network_input[:, 1], network_input[:, 4]), 1, rtol=1e-6)
    if "residual" in channels:
        np.testing.assert_allclose(network_input[:, -5:].std(axis=(0, 2, 3)), 1, rtol=1e-3)


def test_channels_of_some_of_the_frequencies_are_scaled_by_them_alone(dataset):
    shards = open_shards(dataset)
    rows = shards.rows("train")
    spec = fit_input_spec("paper+residual", shards, rows, [50e6, 60e6])
    places = spec.places(shards.manifest.frequencies_hz)
    assert places == [1, 2]
    network_input = spec.apply(shards.complex_phasors(rows)[..., places], shards.reference[..., places])
    assert spec.channel_count == 5 + 3 == network_input.shape[1]
    assert network_input[:, 0].mean() == pytest.approx(1, rel=1e-5)  # the amplitude at 50 MHz
    np.testing.assert_allclose(network_input[:, -3:].std(axis=(0, 2, 3)), 1, rtol=1e-3)
    with pytest.raises(ValueError, match="10 MHz is not among 20, 50, 60 MHz"):
        fit_input_spec("paper", shards, rows, [10e6])
