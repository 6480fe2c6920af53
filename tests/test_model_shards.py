"""Shards: what they hold, and that nothing stale, missing or broken gets into them."""

import json
import logging
import shutil

import numpy as np
import pytest
from synthetic_dataset import write_synthetic_dataset, write_synthetic_render

from itof import direct_phasors, join_components, read_image, residual_channels, write_image
from model import ShardError, fit_input_spec, open_shards
from scenegen import DatasetError, camera_axes, open_dataset, wall_normal

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


def test_shards_hold_every_scene_as_it_was_rendered(dataset):
    shards = open_shards(dataset)
    assert shards.phasors.shape == (6, 6, HEIGHT, WIDTH)
    assert all(array.dtype == np.float32 for array in (shards.phasors, shards.target, shards.radial_depth_m))
    assert isinstance(shards.phasors, np.memmap)
    for row, scene in enumerate(dataset.ids()):
        measured, frequencies_hz = read_image(dataset.render_folder(scene) / "itof.exr").phasors()
        truth = read_image(dataset.render_folder(scene) / "mirrored.exr")
        assert np.array_equal(shards.complex_phasors([row])[0], measured)
        assert np.array_equal(join_components(np.moveaxis(shards.target[row], 0, -1)), truth.phasors()[0])
        assert np.array_equal(shards.radial_depth_m[row], truth.channel("depth.R"))
        assert np.array_equal(shards.mask[row], truth.channel("mask.M"))
        assert shards.manifest.frequencies_hz == frequencies_hz
    splits = [shards.rows(split) for split in ("train", "validation", "test")]
    assert sorted(row for rows in splits for row in rows) == list(range(6))
    assert shards.ids(shards.rows("test")) == dataset.ids("test")


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


def test_fresh_shards_are_used_again_and_a_changed_render_rebuilds_them(dataset, caplog):
    caplog.set_level(logging.INFO)
    open_shards(dataset)
    assert "there are none yet" in caplog.text
    caplog.clear()
    before = open_shards(dataset)
    assert caplog.text == ""
    path = dataset.render_folder("000002") / "mirrored.exr"
    edit_image(path, depth_R=lambda depth: depth * np.float32(1.5))
    after = open_shards(dataset)
    assert "renders/000002/mirrored.exr" in caplog.text
    np.testing.assert_allclose(after.radial_depth_m[2], before.radial_depth_m[2] * 1.5, rtol=1e-6)
    assert after.manifest.data_sha256 != before.manifest.data_sha256


@pytest.mark.parametrize("damage", ["truncated", "foreign", "missing"])
def test_damaged_arrays_are_noticed_and_rebuilt(dataset, caplog, damage):
    before = open_shards(dataset)
    expected = np.array(before.phasors)
    file = dataset.shard_folder / "phasors.npy"
    if damage == "missing":
        file.unlink()
    else:
        content = file.read_bytes()
        file.unlink()  # the opened memory map keeps the old file
        file.write_bytes(content[:-8] if damage == "truncated" else b"PK\x03\x04 not an array")
    caplog.set_level(logging.INFO)
    assert np.array_equal(open_shards(dataset).phasors, expected)
    assert "phasors.npy is missing or damaged" in caplog.text


def test_another_scene_list_or_preset_and_a_broken_manifest_rebuild(dataset, caplog):
    caplog.set_level(logging.INFO)
    open_shards(dataset)
    index = json.loads((dataset.root / "dataset.json").read_text())
    index["scenes"][0]["split"] = "validation" if index["scenes"][0]["split"] != "validation" else "test"
    (dataset.root / "dataset.json").write_text(json.dumps(index))
    open_shards(open_dataset(dataset.root))
    assert "the list of scenes changed" in caplog.text
    index["preset"]["camera"]["horizontal_fov_deg"] = 50.0
    (dataset.root / "dataset.json").write_text(json.dumps(index))
    open_shards(open_dataset(dataset.root))
    assert "the preset changed" in caplog.text
    (dataset.shard_folder / "manifest.json").write_text("{")
    open_shards(open_dataset(dataset.root))
    assert "manifest cannot be used" in caplog.text


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
def test_nan_in_a_render_names_scene_and_file_and_leaves_no_shards(dataset, file, channel):
    edit_image(dataset.render_folder("000003") / file, **{channel: with_nan})
    with pytest.raises(ShardError, match=f"scene 000003: .*{file} holds 1 values that are NaN"):
        open_shards(dataset)
    assert not dataset.shard_folder.exists()
    assert not list(dataset.root.glob(".shards*"))


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
    with pytest.raises(ShardError, match=r"000000: .*mirrored.exr is no ground truth \(no channel mask.M"):
        open_shards(dataset)
    write_image(path, {"Y": np.zeros((HEIGHT, WIDTH))}, {})
    with pytest.raises(ShardError, match=r"000000: .*mirrored.exr holds no phasors"):
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
    assert spec.channel_count == count == network_input.shape[1] == len(spec.noise_std(1e-4))
    if "paper" in channels:
        assert network_input[:, 0].mean() == pytest.approx(1, rel=1e-5)
        np.testing.assert_allclose(np.hypot(network_input[:, 1], network_input[:, 4]), 1, rtol=1e-6)
    if "residual" in channels:
        np.testing.assert_allclose(network_input[:, -5:].std(axis=(0, 2, 3)), 1, rtol=1e-3)


def test_noise_in_the_channels_is_that_of_noisy_phasors(dataset):
    shards = open_shards(dataset)
    spec = fit_input_spec("paper+residual", shards, shards.rows("train"))
    phasor, sigma = shards.complex_phasors([0])[0], 1e-4
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(400, *phasor.shape, 2)) @ np.array([1, 1j])
    noisy = spec.apply(phasor + sigma * np.abs(phasor[..., :1]) * noise, shards.reference)
    measured = (noisy - spec.apply(phasor, shards.reference)).std(axis=(0, 2, 3))  # (C,)
    # Exact in channels that A_0 does not touch to first order: Im r_f at 50 and 60 MHz.
    # 400 x 77 values: relative error of a deviation 0.4 %, 4.5 of those.
    np.testing.assert_allclose(measured[[8, 9]], spec.noise_std(sigma)[[8, 9]], rtol=0.018)
    # Elsewhere noise of A_0 itself comes along or cancels; it never doubles the power.
    assert np.all(measured < 1.02 * np.sqrt(2) * spec.noise_std(sigma))


def test_input_specs_refuse_what_does_not_fit(dataset):
    shards = open_shards(dataset)
    spec = fit_input_spec("residual", shards, shards.rows("train"))
    with pytest.raises(ValueError, match="direct return as reference"):
        spec.apply(shards.complex_phasors([0]))
    with pytest.raises(ValueError, match="expected phasors at 3 frequencies, got 2"):
        spec.apply(shards.complex_phasors([0])[..., :2], shards.reference)
    with pytest.raises(ValueError, match="there are none"):
        fit_input_spec("paper", shards, [])
