"""Who renders what: locks that vanish with the process that holds them, however it dies.

A claim is a `flock` on ``renders/.claims/<id>``, which also counts how often one run has begun the scene;
the run lock is one on ``renders/.run``, shared by commands that render with the same settings;
``renders/.note`` is held while ``rendering.json`` is read and written. Renders are written whole, and the
same on any machine of one kind, so a file system without locks costs work done twice, no more.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EACCES, EAGAIN, ENOLCK, ENOTSUP
from pathlib import Path

from scenegen import NightError

_CLAIMS, _RUN, _NOTE = ".claims", ".run", ".note"
_NO_LOCKS = (ENOLCK, ENOTSUP)
_MOST_RUNS, _MOST_BYTES = 16, 4096  # that a claim file remembers attempts of


class OtherRunError(NightError):
    """Another command renders the same dataset with other settings."""


@dataclass
class Claim:
    """A scene that this process alone works on."""

    descriptor: int
    path: Path

    def begin(self, run_id: str) -> int:
        """Count an attempt of this run at the scene; how many there are now."""
        counts = _counts(os.pread(self.descriptor, _MOST_BYTES, 0))
        counts[run_id] = counts.get(run_id, 0) + 1
        latest = dict(list(counts.items())[-_MOST_RUNS:])
        os.ftruncate(self.descriptor, 0)
        os.pwrite(self.descriptor, json.dumps(latest).encode(), 0)
        return counts[run_id]

    def forget(self) -> None:
        """The scene is done: nothing needs to be counted any more."""
        self.path.unlink(missing_ok=True)


@contextmanager
def claimed(renders: Path, scene_id: str) -> Iterator[Claim | None]:
    """Claim a scene while the block runs; None when another process has it."""
    path = renders / _CLAIMS / scene_id
    path.parent.mkdir(exist_ok=True)  # not its parents: a dataset that was deleted stays so
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            if not _lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB):
                yield None
                return
            if not _is_same_file(descriptor, path):
                continue  # its last owner removed it between our open and our lock
            yield Claim(descriptor, path)
            return
        finally:
            os.close(descriptor)


def attempts_of(renders: Path, scene_id: str, run_id: str) -> int:
    """How often a run has begun a scene without ending it well."""
    try:
        return _counts((renders / _CLAIMS / scene_id).read_bytes()).get(run_id, 0)
    except OSError:
        return 0


def running(renders: Path) -> list[str]:
    """Scenes that some process works on now."""
    found = []
    for path in sorted((renders / _CLAIMS).glob("*")):
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except FileNotFoundError:
            continue
        try:
            if not _lock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB):
                found.append(path.name)
        finally:
            os.close(descriptor)
    return found


@contextmanager
def joined_run(renders: Path, settings: str) -> Iterator[None]:
    """Render this dataset with `settings`, alone or beside commands with the same ones.

    Raises
    ------
    OtherRunError : a living command renders it with others.
    """
    renders.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(renders / _RUN, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        if _lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB):  # nobody else: our settings hold
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, settings.encode(), 0)
        _lock(descriptor, fcntl.LOCK_SH)
        others = os.pread(descriptor, 2**20, 0).decode()
        if others != settings:
            raise OtherRunError(
                f"another night-render is rendering {renders.parent} with other settings ({others}): wait "
                "for it to end, or help it with the same ones"
            )
        yield
    finally:
        os.close(descriptor)


@contextmanager
def noting(renders: Path) -> Iterator[None]:
    """Read and write ``rendering.json`` while no other command does; waits for its turn."""
    renders.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(renders / _NOTE, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        _lock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, how: int) -> bool:
    try:
        fcntl.flock(descriptor, how)
    except OSError as error:
        if error.errno in (EAGAIN, EACCES):
            return False
        if error.errno not in _NO_LOCKS:
            raise
    return True


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _counts(text: bytes) -> dict[str, int]:
    """Attempts by run."""
    try:
        content = json.loads(text)
        return {str(run): int(count) for run, count in content.items()}
    except (ValueError, AttributeError, TypeError):
        return {}
