"""Commands on a full disk, with few open files, without streams, home or rights: right, or one sentence."""

import functools
from contextlib import contextmanager

import numpy as np
import pytest
from environment_faults import (
    ClosedStreams,
    LargestFile,
    few_open_files,
    home_is_gone,
    no_home,
    permissions_count,
)
from jobs import DROP, EXPORT, FIVE, GEN, JUDGE, PREDICT, TO_ITOF, TO_TAL, TRAIN, Stage

pytestmark = pytest.mark.thorough
PLACES = {GEN: 6, TRAIN: 9, JUDGE: 3, PREDICT: 8, TO_ITOF: 7, TO_TAL: 7, EXPORT: 5}  # 45 in all


@pytest.fixture(scope="module")
def stages(forks, samples, tmp_path_factory):
    """The stage of a job, made once."""

    @functools.cache
    def stage(job):
        return Stage(forks, tmp_path_factory.mktemp("stage") / "arena", samples, job)

    return stage


@pytest.mark.parametrize("job", PLACES, ids=lambda job: job.name)
def test_a_file_that_must_not_grow_ends_a_command_with_one_sentence(stages, job):
    stage = stages(job)
    largest = max(len(data) for data in stage.new.values())
    places = np.geomspace(1000, largest - 1, PLACES[job]).astype(int)
    found = {int(size): stage.run_in(LargestFile(int(size))) for size in places}
    assert {size: what for size, (what, _) in found.items() if what} == {}
    assert 2 in {code for _, code in found.values()}


@pytest.mark.parametrize("job", FIVE, ids=lambda job: job.name)
@pytest.mark.parametrize(
    "before", [few_open_files, no_home, home_is_gone], ids=lambda before: before.__name__
)
def test_a_command_needs_neither_many_files_nor_a_home(stages, job, before):
    assert stages(job).run_in(before) == (None, 0)


@pytest.mark.parametrize("job", FIVE, ids=lambda job: job.name)
@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)], ids=str)
def test_a_command_whose_streams_are_closed_does_its_work(stages, job, closed):
    assert stages(job).run_in(ClosedStreams(closed)) == (None, 0)


@contextmanager
def read_only(folder):
    """No file within a folder may be made, changed or removed; yields what gives the rights back."""
    paths = [path for path in (folder, *folder.rglob("*")) if not path.is_symlink()]
    modes = {path: path.stat().st_mode for path in paths}
    for path in paths:
        path.chmod(modes[path] & ~0o222)

    def give_back():
        for path, mode in modes.items():
            if path.exists():
                path.chmod(mode)

    try:
        yield give_back
    finally:
        give_back()


WRITTEN = [
    (GEN, "made_ply"),
    (DROP, "data"),
    (TRAIN, "."),
    (JUDGE, "."),
    (PREDICT, "."),
    (TO_TAL, "."),
    (EXPORT, "."),
]
READ = [
    (PREDICT, "run"),
    (JUDGE, "run"),
    (JUDGE, "closed"),
    (TRAIN, "closed"),
    (TO_ITOF, "data"),
    (EXPORT, "closed"),
]


@pytest.mark.parametrize(("job", "folder"), WRITTEN, ids=lambda value: getattr(value, "name", value))
def test_a_folder_without_write_permission_is_named(stages, job, folder):
    stage = stages(job)
    with read_only(stage.arena.work / folder) as give_back:
        assert stage.run_in(permissions_count, relieve=give_back) == (None, 2)


@pytest.mark.parametrize(("job", "folder"), READ, ids=lambda value: getattr(value, "name", value))
def test_what_is_only_read_needs_no_write_permission(stages, job, folder):
    stage = stages(job)
    with read_only(stage.arena.work / folder) as give_back:
        assert stage.run_in(permissions_count, relieve=give_back) == (None, 0)
