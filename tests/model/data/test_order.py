"""The order of an epoch, and batches from memory and from the disk."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from synthetic_dataset import write_synthetic_dataset

from disk.machine_memory import machine_bytes
from model.data.feed import Feed, rows_by_piece, shuffled_windows, window_rows, windows_in_order
from model.data.rows import RowLayout
from model.data.shards import open_shards

# 100 rows of 150, in pieces of 10: two of three, as a training split has them.
ROWS = [row for row in range(150) if row % 3]
PIECE = 10
WIDTH, HEIGHT = 11, 7


def generator(seed=0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def flat(windows) -> list[int]:
    return [row for window in windows for row in window]


@pytest.mark.parametrize("window", [0, 1, 7, 20, 33, 99, 100, 1000])
def test_every_row_comes_once_an_epoch_and_pieces_in_one_run(window):
    windows = shuffled_windows(ROWS, PIECE, window, generator())
    assert sorted(flat(windows)) == ROWS
    seen = [{row // PIECE for row in rows} for rows in windows]
    assert sum(len(pieces) for pieces in seen) == len(set.union(*seen))  # each piece in one window only
    for rows in windows:
        assert len(rows) <= window or len({row // PIECE for row in rows}) == 1


def test_the_order_is_that_of_the_generator_and_of_nothing_else():
    first, second = generator(3), generator(3)
    epochs = [shuffled_windows(ROWS, PIECE, 30, first) for _ in range(3)]
    assert [shuffled_windows(ROWS, PIECE, 30, second) for _ in range(3)] == epochs
    assert epochs[0] != epochs[1]
    assert shuffled_windows(ROWS, PIECE, 30, generator(4)) != epochs[0]


def test_one_window_for_all_is_one_permutation_of_all_rows():
    order = torch.randperm(len(ROWS), generator=generator(5)).tolist()
    assert shuffled_windows(ROWS, PIECE, len(ROWS), generator(5)) == [[ROWS[i] for i in order]]


def test_rows_are_mixed_within_a_window_and_pieces_between_windows():
    epochs = [shuffled_windows(ROWS, PIECE, 30, generator(seed)) for seed in range(200)]
    # Where a row falls in a window is uniform: the mean place of one row over 200 epochs, as a part of the
    # window, is 1/2 within 4 standard errors of a uniform variable (sigma = 1/sqrt(12)).
    places = [
        window.index(ROWS[0]) / (len(window) - 1) for windows in epochs for window in windows if 1 in window
    ]
    assert len(places) == 200
    assert abs(np.mean(places) - 0.5) < 4 / np.sqrt(12 * 200)
    # In a random order of n rows, sum_p n_p (n_p - 1) / n of the n - 1 pairs of neighbours share a piece
    # (n_p rows of piece p): a quarter here; without mixing it would be 9 of 10.
    windows = [window for windows in epochs for window in windows]
    shared = sum(a // PIECE == b // PIECE for window in windows for a, b in pairwise(window))
    counts = [[len(piece) for piece in rows_by_piece(window, PIECE)] for window in windows]
    expected = sum(n_p * (n_p - 1) / sum(count) for count in counts for n_p in count)
    # The variance of a count of pairs is below its mean: 5 standard deviations.
    assert abs(shared - expected) < 5 * np.sqrt(expected)
    # Each pair of pieces shares a window in some epoch.
    together = {frozenset((a // PIECE, b // PIECE)) for ws in epochs for w in ws for a in w for b in w}
    assert len(together) == 15 * 14 / 2 + 15  # unordered pairs of 15 pieces, and each with itself


def test_in_order_means_ascending_in_windows_of_whole_pieces():
    windows = windows_in_order(reversed(ROWS), PIECE, 20)
    assert flat(windows) == ROWS
    assert [len(window) for window in windows[:2]] == [20, 20]  # 6, 7 and 7 rows of three pieces


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("model.data.pieces.PIECE_BYTES", 3 * RowLayout(WIDTH, HEIGHT, 3).row_bytes)
        folder = tmp_path_factory.mktemp("feed")
        yield open_shards(write_synthetic_dataset(folder / "data", count=20, width=WIDTH, height=HEIGHT))


@pytest.mark.parametrize("window", [0, 4, 1000])
@pytest.mark.parametrize("batch_size", [1, 4, 50])
def test_batches_hold_the_rows_in_the_order_wanted_across_windows(shards, window, batch_size):
    rows = shards.rows("train")
    feed = Feed(shards, rows, window)
    assert feed.is_resident == (window == 1000)
    shuffled = flat(shuffled_windows(rows, 3, window, generator()))
    for _ in range(2):  # rows that stay in memory are used again in the next epoch
        for expected, batches in (
            (rows, list(feed.in_order(batch_size))),
            (shuffled, list(feed.in_windows(feed.shuffled_windows(generator()), batch_size))),
        ):
            assert [row for batch in batches for row in batch.rows] == expected
            assert all(len(batch) == batch_size for batch in batches[:-1])
            for batch in batches:
                assert np.array_equal(batch.phasors, shards.read(batch.rows).phasors)
                assert np.array_equal(batch.target, shards.read(batch.rows).target)
                assert np.array_equal(batch.mask, shards.read(batch.rows).mask)


def test_a_window_of_which_some_rows_are_used_is_prepared_as_a_whole(shards):
    prepared = []

    def prepare(block):
        prepared.append(block.rows)
        return block

    feed = Feed(shards, shards.rows("train"), 4, prepare)
    windows = feed.shuffled_windows(generator())
    whole = list(feed.in_windows(windows, 2))
    before, prepared[:] = list(prepared), []
    skip = len(windows[0]) // 2 + 1  # into the second window
    assert (2 * skip - len(windows[0])) % len(windows[1]) != 0
    left = list(feed.in_windows(windows, 2, skip=skip))
    assert [batch.rows for batch in left] == [batch.rows for batch in whole[skip:]]
    assert prepared == before[1:]


def test_an_epoch_that_is_left_halfway_ends_its_thread(shards):
    batches = Feed(shards, shards.rows("train"), 0).in_order(2)
    assert next(batches).rows == tuple(shards.rows("train")[:2])
    batches.close()
    assert len(list(Feed(shards, shards.rows("train"), 0).in_order(2))) == -(-len(shards.rows("train")) // 2)


def test_rows_are_held_when_they_fit_and_else_in_two_halves_of_the_memory(shards):
    row_bytes = RowLayout(WIDTH, HEIGHT, 3).row_bytes
    assert row_bytes == WIDTH * HEIGHT * 37  # 6 + 2 + 1 floats and a byte a pixel
    assert window_rows(shards, 10, 10 * row_bytes) == 10
    assert window_rows(shards, 10, 10 * row_bytes - 1) == 4
    assert window_rows(shards, 10) == 10
    assert 2**28 < machine_bytes() < 2**50
