"""The training set that is enlarged once, as in the paper's released code."""

from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from synthetic_dataset import write_synthetic_dataset
from training_runs import assert_same_end, before_each_network, checkpoint, config_of, settings

from model.data.feed import Feed
from model.data.rows import RowLayout
from model.data.shards import open_shards
from model.paper.augmentation import KINDS, UNCHANGED, PaperAugmentation
from model.paper.enlarged_set import EnlargedSet
from model.training.loop import train
from model.training.step import augmentation_of

pytestmark = pytest.mark.usefixtures("one_thread")
PAPER = PaperAugmentation(
    flip_rows=True, flip_columns=True, rotation_deg=180, translation=0.2, channel_noise_sigma=1.0
)
ROWS = tuple(range(100, 860 + 100))
COPIES = {"copies_per_change": 5, "max_epochs": 2}
ROW_BYTES = RowLayout(24, 14, 3).row_bytes


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_the_papers_numbers_of_scenes_and_copies_give_2875_samples_with_one_change_each():
    enlarged = EnlargedSet.of(ROWS, PAPER, 403, generator())
    assert len(enlarged.rows) == 860 + 5 * 403
    assert enlarged.rows[:860] == ROWS
    assert Counter(enlarged.draws.kind.tolist()) == {UNCHANGED: 860} | dict.fromkeys(range(5), 403)
    for kind in range(len(KINDS)):
        copied = [enlarged.rows[place] for place in np.flatnonzero(enlarged.draws.kind == kind)]
        assert len(set(copied)) == 403  # no scene twice, as there are more scenes than copies
    warp, channels = PAPER.warp(enlarged.draws), torch.zeros(2875, 1, 1, 2)
    noisy = (PAPER.seen(channels, enlarged.draws) != 0).any(dim=(1, 2, 3))
    changed = [warp.flip_rows, warp.flip_columns, warp.angle_rad != 0, (warp.shift != 0).any(dim=1), noisy]
    for kind, samples in enumerate(changed):
        assert torch.equal(samples, enlarged.draws.kind == kind)


def test_only_changes_that_are_switched_on_have_copies_and_scenes_repeat_when_all_have_come():
    enlarged = EnlargedSet.of(ROWS[:4], replace(PAPER, rotation_deg=0.0, flip_columns=False), 6, generator())
    assert len(enlarged.rows) == 4 + 3 * 6
    assert set(enlarged.draws.kind.tolist()) == {0, 3, 4, UNCHANGED}
    shifted = Counter(enlarged.rows[place] for place in np.flatnonzero(enlarged.draws.kind == 3))
    assert sorted(shifted.values()) == [1, 1, 2, 2]


def test_every_epoch_has_every_sample_once_with_its_own_draws():
    enlarged = EnlargedSet.of(ROWS[:7], PAPER, 5, generator())
    number = {int(seed): sample for sample, seed in enumerate(enlarged.draws.noise_seed)}
    orders = []
    for epoch in (1, 2):
        order = torch.tensor(enlarged.rows)[torch.randperm(32, generator=generator(epoch))].tolist()
        draws = enlarged.draws_in_order(order, generator(epoch))
        samples = [number[int(seed)] for seed in draws.noise_seed]
        assert sorted(samples) == list(range(32))
        assert [enlarged.rows[sample] for sample in samples] == order
        for field in fields(draws):
            assert torch.equal(getattr(draws, field.name), getattr(enlarged.draws, field.name)[samples])
        orders.append([sample for sample in samples if enlarged.rows[sample] == ROWS[0]])
    assert sorted(orders[0]) == sorted(orders[1])
    assert orders[0] != orders[1]  # samples of one scene come in random order, too


@pytest.fixture
def in_pieces(tmp_path, monkeypatch):
    """Twelve scenes in pieces of two."""
    monkeypatch.setattr("model.data.pieces.PIECE_BYTES", 2 * ROW_BYTES)
    return write_synthetic_dataset(tmp_path / "data", count=12)


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("window_rows", [1000, 4, 2])  # all in memory; streamed
def test_a_feed_delivers_a_row_as_often_as_it_is_asked_for_and_holds_it_once(in_pieces, window_rows, ahead):
    shards = open_shards(in_pieces)
    distinct = list(shards.rows("train"))
    rows, read = [*distinct, *distinct[:3], distinct[0]], []

    def prepare(block):
        read.append(block.rows)
        return block

    feed = Feed(shards, rows, window_rows, prepare, prepares_ahead=ahead)
    windows = feed.shuffled_windows(generator())
    assert (len(windows) > 1) == (window_rows < 1000)
    for window in windows:
        assert len(set(window)) <= window_rows
    order = [row for window in windows for row in window]
    assert Counter(order) == Counter(rows)
    blocks = list(feed.in_windows(windows, 4))
    assert all(len(block) == 4 for block in blocks[:-1])
    assert [row for block in blocks for row in block.rows] == order
    assert sorted(row for block in read for row in block) == distinct
    for block in blocks:
        np.testing.assert_array_equal(block.phasors, shards.read(block.rows).phasors)
    assert [row for block in feed.in_order(4) for row in block.rows] == distinct
    later = list(feed.in_windows(windows, 4, skip=1))
    assert [block.rows for block in later] == [block.rows for block in blocks[1:]]


def test_a_training_that_was_stopped_in_an_epoch_ends_as_an_uninterrupted_one(in_pieces, tmp_path):
    course = settings(**COPIES, checkpoint_minutes=0.0)
    whole, run, batches = tmp_path / "whole", tmp_path / "run", []
    end = train(in_pieces, whole, course, memory_bytes=8 * ROW_BYTES)
    samples = len(in_pieces.ids("train")) + 5 * len(augmentation_of(course.augmentation).kinds)
    batches_an_epoch = -(-samples // course.optimiser.batch_size)

    def stop(network):
        batches.append(network.training)
        if sum(batches) == batches_an_epoch + 3 and network.training:  # the third batch of epoch 2
            raise KeyboardInterrupt

    with before_each_network(stop), pytest.raises(KeyboardInterrupt):
        train(in_pieces, run, course, memory_bytes=8 * ROW_BYTES)
    state = checkpoint(run)
    assert (len(state["history"]), state["position"]["batches"]) == (1, 2)
    assert train(in_pieces, run, course, resume=True, memory_bytes=8 * ROW_BYTES) == end
    assert_same_end(run, whole)
    assert config_of(run)["settings"]["augmentation"]["paper"]["copies_per_change"] == 5
    anew = tmp_path / "anew"
    train(in_pieces, anew, settings(max_epochs=2), memory_bytes=8 * ROW_BYTES)
    assert (anew / "history.csv").read_bytes() != (whole / "history.csv").read_bytes()
