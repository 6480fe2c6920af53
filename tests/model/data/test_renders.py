"""Renders that cannot be trained on are refused by scene and file; failed scenes are left out."""

import json
import shutil

import numpy as np
import pytest
from render_records import record_anew
from synthetic_dataset import edit_image, write_synthetic_dataset, write_synthetic_render

from itof import ImageFileError, read_image, write_image
from model.data.renders import ShardError, read_render
from model.data.shards import _without_failures, open_shards
from scenegen import DatasetError, FailureRecord, RenderFileError, write_failure

WIDTH, HEIGHT = 11, 7


@pytest.fixture
def dataset(tmp_path):
    return write_synthetic_dataset(tmp_path / "data", count=6, width=WIDTH, height=HEIGHT)


def with_nan(values):
    values[2, 3] = np.nan
    return values


def test_a_render_that_is_not_the_recorded_one_is_refused_and_one_without_record_is_not(dataset):
    for scene in ("000001", "000002"):
        record_anew(dataset.render_folder(scene))
    open_shards(dataset)
    for scene in ("000000", "000001"):
        path = dataset.render_folder(scene) / "mirrored.exr"
        edit_image(path, depth_R=lambda depth: depth * np.float32(1.5))
    refused = r"scene 000001: .*mirrored.exr is not the file that night-render wrote.*run night-render"
    with pytest.raises(RenderFileError, match=refused):
        open_shards(dataset)
    path.write_bytes(b"no image")
    with pytest.raises(RenderFileError, match=refused):
        open_shards(dataset)
    with pytest.raises(RenderFileError, match=refused):
        read_render(dataset, "000001")  # also where no shards are built
    record_anew(path.parent)  # then the message is about the damage
    with pytest.raises(ImageFileError, match=r"damaged or no EXR.*: delete it and render it again"):
        open_shards(dataset)


def test_scenes_that_could_not_be_rendered_are_left_out_until_they_can(dataset, caplog):
    whole, rows = open_shards(dataset), [0, 1, 3, 4, 5]
    expected = whole.read(rows).phasors
    failure = FailureRecord(recipe="", attempts=2, reason="its mesh is broken")
    kept = dataset.root / "kept"
    shutil.move(dataset.render_folder("000002"), kept)
    write_failure(dataset.render_folder("000002"), failure, "log")
    fewer = open_shards(dataset)
    assert "scenes that could not be rendered are left out: 1, first 000002" in caplog.text
    assert fewer.ids(range(5)) == whole.ids(rows)
    assert np.array_equal(fewer.read(range(5)).phasors, expected)
    shutil.rmtree(dataset.render_folder("000002"))
    shutil.move(kept, dataset.render_folder("000002"))
    assert open_shards(dataset).manifest.data_sha256 == whole.manifest.data_sha256


def test_a_scene_with_a_render_is_no_failure(dataset):
    folder = dataset.render_folder("000002")
    record_anew(folder)
    write_failure(folder, FailureRecord(recipe="", attempts=2, reason="its mesh is broken"), "log")
    assert len(open_shards(dataset).manifest.scenes) == 6
    # It has no transients, and they could not be rendered.
    assert _without_failures(dataset, "simulated").ids() == [*dataset.ids()[:2], *dataset.ids()[3:]]


def test_scenes_of_other_bounces_are_not_mixed(dataset):
    for scene in dataset.ids()[:5]:  # the last one is of another program
        record_anew(dataset.render_folder(scene), json.dumps({"max_bounces": 3}))
    open_shards(dataset)
    record_anew(dataset.render_folder("000003"), json.dumps({"max_bounces": 1}))
    with pytest.raises(
        ShardError, match=r"scene 000000 of .* with at most 3 bounces and scene 000003 with 1"
    ):
        open_shards(dataset)


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


@pytest.mark.parametrize("change", [lambda depth: depth + np.float32(1), lambda depth: 0 * depth])
def test_a_depth_beside_the_mask_is_no_ground_truth(dataset, change):
    edit_image(dataset.render_folder("000002") / "mirrored.exr", depth_R=change)
    with pytest.raises(
        ShardError, match=r"000002: .* needs a depth where its mask shows the object, and 0 else"
    ):
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
