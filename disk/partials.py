"""Temporary folders in which files are written before they get their final name, and their remains.

What will be at ``PARENT/NAME`` is written as ``PARENT/.NAME.<host>-<process id>.<number>.partial/NAME``. The
process holds a lock (`flock`) on this folder while it writes. The system releases the lock when the process
ends, in whatever way. An unlocked folder is therefore a leftover of a killed process.

Where two names cannot be exchanged in one step, the folder that is replaced is for a moment at ``NAME.old``
in the temporary folder. If a process is killed at that moment, `remove_leftovers` renames it back.
"""

from __future__ import annotations

import fcntl
import itertools
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EACCES, EAGAIN, ENAMETOOLONG
from pathlib import Path

from disk.locks import is_same_file
from disk.path_like import PathLike

HOST = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname())
_PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>\w+)-(?P<pid>\d+)\.\d+\.partial", re.DOTALL)
_WEEK_S = 7 * 86400.0
_MOST_ATTEMPTS = 1000  # at a new folder: /proc says that a folder which it has is not there
_numbers = itertools.count(1)  # threads may write the same path


@contextmanager
def partial_folder(path: Path) -> Iterator[Path]:
    """Make and lock the temporary folder for `path`; it is removed at the end of the block."""
    folder, lock = _locked_folder(path)
    try:
        yield folder
    finally:
        try:
            _discard(folder, path)
        finally:
            os.close(lock)


def older(folder: Path, path: Path) -> Path:
    """Where the older folder at `path` is while it is being replaced in two steps."""
    return folder / f"{path.name}.old"


def is_partial(name: str) -> bool:
    """Whether `name` is a temporary name of `whole_file` or `whole_folder`."""
    return _PARTIAL.fullmatch(name) is not None


def remove_leftovers(folder: PathLike, name: str | None = None) -> None:
    """Remove what killed processes left in `folder`, for the final name `name` or for all.

    A folder that was just being replaced gets its name back. Leftovers that this process may not change are
    kept. So are those of other machines, whose locks may not be visible here, for a week.
    """
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.endswith(".partial")]
    for partial in names:
        match = _PARTIAL.fullmatch(partial)
        if match is not None and name in (None, match["name"]):
            with suppress(OSError):
                place = Path(folder, match["name"])
                _remove_leftover(Path(folder, partial), place, match["host"], int(match["pid"]))


def _locked_folder(path: Path) -> tuple[Path, int]:
    """A new temporary folder for `path`, and the descriptor that holds its lock."""
    attempt = 0
    while True:
        attempt += 1
        folder = path.with_name(f".{path.name}.{HOST}-{os.getpid()}.{next(_numbers)}.partial")
        try:
            folder.mkdir()
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except (FileExistsError, FileNotFoundError):
            if path.parent.is_dir() and attempt < _MOST_ATTEMPTS:
                continue  # left by a process with our id; or just removed, before we could lock it
            raise
        except OSError as error:
            where = path if error.errno == ENAMETOOLONG else path.parent
            raise OSError(error.errno, error.strerror, str(where)) from None
        if _lock(lock) is not False and is_same_file(lock, folder):
            return folder, lock
        os.close(lock)


def _remove_leftover(partial: Path, path: Path, host: str, pid: int) -> None:
    """Remove a temporary folder unless it is in use."""
    lock = os.open(partial, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        locked = _lock(lock)
        if locked is False or not is_same_file(lock, partial):
            return
        if host == HOST:
            dead = locked or not _is_alive(pid)
        else:
            _restore(partial, path)
            dead = locked is True and time.time() - _last_change(partial) > _WEEK_S
        if dead:
            _discard(partial, path)
    finally:
        os.close(lock)


def _discard(partial: Path, path: Path) -> None:
    _restore(partial, path)
    shutil.rmtree(partial, ignore_errors=True)


def _restore(partial: Path, path: Path) -> None:
    """Give the older folder its name back if nothing has that name."""
    old = older(partial, path)
    if not os.path.lexists(old) or os.path.lexists(path):
        return
    try:
        old.rename(path)
    except OSError:
        if not os.path.lexists(path):  # otherwise another process has just written a newer one
            raise


def _lock(descriptor: int) -> bool | None:
    """Try to lock; False if another process has the lock, None on a file system without locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in (EAGAIN, EACCES) else None
    return True


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)  # signal 0 does nothing but check whether the process exists
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _last_change(folder: Path) -> float:
    """Time of the last change of anything in a folder, seconds since 1970."""
    return max(entry.lstat().st_mtime for entry in (folder, *folder.rglob("*")))
