"""Locks between processes that render one dataset. The system releases a lock when its process ends.

- ``renders/.claims/<id>`` is locked by the process that renders the scene. The file counts how often each run
  has begun the scene.
- ``renders/.run`` is locked during a run, shared by commands that render with the same settings.
- ``renders/.note`` is locked while ``rendering.json`` is read and written.

On a file system without locks, two processes may render the same scene. This only wastes time: files are
written whole, and every machine of one kind renders the same pixels.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from disk import NightError, inside
from disk.locks import is_same_file, lock, open_lock_file
from disk.plain_file import read_plain

_CLAIMS, _RUN, _RECORD_LOCK = ".claims", ".run", ".note"
_MOST_RUNS, _MOST_BYTES = 16, 4096  # of a claim file: runs whose attempts it counts, and its size


class OtherRunError(NightError):
    """Another command renders the same dataset with other settings."""


@dataclass
class Claim:
    """The lock on a scene that this process works on."""

    descriptor: int
    path: Path

    def begin(self, run_id: str) -> int:
        """Add one to the attempts of this run at the scene, and return their number."""
        counts = _counts(os.pread(self.descriptor, _MOST_BYTES, 0))
        counts[run_id] = counts.get(run_id, 0) + 1
        latest = dict(list(counts.items())[-_MOST_RUNS:])
        # Cut only afterwards: ext4 writes an emptied file to disk when it is closed, also if it is deleted.
        os.ftruncate(self.descriptor, os.pwrite(self.descriptor, json.dumps(latest).encode(), 0))
        return counts[run_id]

    def forget(self) -> None:
        """Delete the counts, because the scene is done."""
        self.path.unlink(missing_ok=True)


@contextmanager
def claimed(renders: Path, scene_id: str) -> Iterator[Claim | None]:
    """Claim a scene while the block runs; yields None if another process has claimed it."""
    path = inside(renders, _CLAIMS) / scene_id
    path.parent.mkdir(exist_ok=True)  # no parents: a deleted dataset must not come back
    while True:
        descriptor = open_lock_file(path)
        try:
            if not lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB):
                yield None
                return
            if not is_same_file(descriptor, path):
                continue  # its last owner deleted it after we opened it and before we locked it
            yield Claim(descriptor, path)
            return
        finally:
            os.close(descriptor)


def attempts_of(renders: Path, scene_id: str, run_id: str) -> int:
    """How often a run has begun a scene that is not done yet."""
    try:
        return _counts(read_plain(renders / _CLAIMS / scene_id, _MOST_BYTES)).get(run_id, 0)
    except OSError:
        return 0


def running(renders: Path) -> list[str]:
    """Ids of the scenes that are being rendered now, by any process."""
    found = []
    for path in sorted(inside(renders, _CLAIMS).glob("*")):
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        except FileNotFoundError:
            continue
        try:
            if not lock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB):
                found.append(path.name)
        finally:
            os.close(descriptor)
    return found


@contextmanager
def joined_run(renders: Path, settings: str) -> Iterator[None]:
    """Hold the run lock of a dataset; commands with the same `settings` may hold it together.

    Raises
    ------
    OtherRunError : a running command renders the dataset with other settings.
    LockFileError, OutsideError : something else is in the place of a lock.
    """
    renders.mkdir(parents=True, exist_ok=True)
    inside(renders, _CLAIMS)  # before any work
    descriptor = open_lock_file(renders / _RUN)
    try:
        for _ in range(2):  # at the first time, a plan may have held the lock for a moment
            if lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB):  # we are the only run: record our settings
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, settings.encode(), 0)
            lock(descriptor, fcntl.LOCK_SH)
            others = _recorded(descriptor)
            if others == settings:
                break
        else:
            raise _other_run(renders, others)
        yield
    finally:
        os.close(descriptor)


def refuse_other_run(renders: Path, settings: str) -> None:
    """`OtherRunError` if a running command renders with other `settings`; nothing is written."""
    if not os.path.lexists(renders / _RUN):
        return
    descriptor = open_lock_file(renders / _RUN)
    try:
        if lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB):
            return  # nobody renders
        lock(descriptor, fcntl.LOCK_SH)
        if (others := _recorded(descriptor)) != settings:
            raise _other_run(renders, others)
    finally:
        os.close(descriptor)


def _recorded(descriptor: int) -> str:
    return os.pread(descriptor, 2**20, 0).decode()


def _other_run(renders: Path, others: str) -> OtherRunError:
    return OtherRunError(
        f"another night-render is rendering {renders.parent} with other settings ({others}): wait "
        "until it ends, or start this command with the same settings"
    )


@contextmanager
def rendering_record_locked(renders: Path) -> Iterator[None]:
    """Wait for the lock on ``rendering.json`` and hold it while the block runs."""
    renders.mkdir(exist_ok=True)  # no parents: a deleted dataset must not come back
    descriptor = open_lock_file(renders / _RECORD_LOCK)
    try:
        lock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _counts(text: bytes) -> dict[str, int]:
    """Attempts by run; empty if the text is damaged."""
    try:
        content = json.loads(text)
        return {str(run): int(count) for run, count in content.items()}
    except (ValueError, AttributeError, TypeError, OverflowError, RecursionError):
        return {}
