"""What shards hold: every scene as it was rendered, and the direct return of the wall."""

import numpy as np
import pytest
from synthetic_dataset import write_synthetic_dataset

from itof import direct_phasors, read_image, residual_channels
from model.data.pieces import scenes_per_piece
from model.data.rows import RowLayout
from model.data.shards import open_shards
from scenegen import camera_axes, wall_normal

WIDTH, HEIGHT = 11, 7


@pytest.fixture
def dataset(tmp_path):
    return write_synthetic_dataset(tmp_path / "data", count=6, width=WIDTH, height=HEIGHT)


@pytest.mark.parametrize("piece_rows", [1, 2, 3, 4, 6])
def test_shards_hold_every_scene_as_it_was_rendered(dataset, monkeypatch, piece_rows):
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", piece_rows * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
    shards = open_shards(dataset)
    assert [piece.contents.name for piece in shards.manifest.pieces] == dataset.ids()[::piece_rows]
    block = shards.read([5, 0, 4, 2, 1, 3])
    assert block.phasors.dtype == block.target.dtype == np.complex64
    assert block.radial_depth_m.dtype == np.float32
    for place, row in enumerate(block.rows):
        folder = dataset.render_folder(dataset.ids()[row])
        measured, frequencies_hz = read_image(folder / "itof.exr").phasors()
        truth = read_image(folder / "mirrored.exr")
        assert np.array_equal(block.phasors[place], measured)
        assert np.array_equal(block.target[place][..., None], truth.phasors()[0])
        assert np.array_equal(block.radial_depth_m[place], truth.channel("depth.R"))
        assert np.array_equal(block.mask[place], truth.channel("mask.M"))
        assert shards.manifest.frequencies_hz == frequencies_hz
        # The same scene, read alone.
        assert np.array_equal(shards.read([row]).phasors[0], block.phasors[place])
    splits = [shards.rows(split) for split in ("train", "validation", "test")]
    assert sorted(row for rows in splits for row in rows) == list(range(6))
    assert shards.ids(shards.rows("test")) == dataset.ids("test")


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
    hidden = residual_channels(shards.read([0]).phasors[0], shards.reference)[:3]
    assert np.abs(hidden).max() > 1e-4
