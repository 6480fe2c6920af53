"""Commands in folders that they may not write: right, or one sentence."""

import functools
from contextlib import contextmanager

import pytest
from forked import permissions_count
from jobs import DROP, EXPORT, GEN, JUDGE, PREDICT, TO_ITOF, TO_TAL, TRAIN, Stage

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def stages(forks, samples, tmp_path_factory):
    """The stage of a job, made once."""

    @functools.cache
    def stage(job):
        return Stage(forks, tmp_path_factory.mktemp("stage") / "arena", samples, job)

    return stage


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
