"""Locks between processes, on lock files. The system releases a lock when its process ends or is killed.

On a file system without locks, every process gets every lock.
"""

from __future__ import annotations

import fcntl
import os
import stat
from errno import EACCES, EAGAIN, ELOOP, ENOLCK, ENOSYS, ENOTSUP
from pathlib import Path

from disk.night_error import NightError

_NO_LOCKS = (ENOLCK, ENOSYS, ENOTSUP)  # ENOSYS: Lustre without the option flock


class LockFileError(NightError):
    """Something else than a plain file is in the place of a lock file."""


def open_lock_file(path: Path) -> int:
    """Descriptor of the lock file `path`, which is made if it is missing. Closing it releases the lock.

    Raises
    ------
    LockFileError : `path` is a link or no plain file.
    OSError : the file cannot be opened or made.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK  # follow no link, wait for no pipe
    try:
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno != ELOOP:
            raise
        raise LockFileError(f"{path} is a link in the place of a lock file: remove it") from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise LockFileError(f"{path} is no plain file, in the place of a lock file: remove it")
    return descriptor


def lock(descriptor: int, how: int) -> bool:
    """Take the lock `fcntl.LOCK_EX` or `LOCK_SH`; with `LOCK_NB`, False if another process has it."""
    try:
        fcntl.flock(descriptor, how)
    except OSError as error:
        if error.errno in (EAGAIN, EACCES):
            return False
        if error.errno not in _NO_LOCKS:
            raise
    return True


def is_same_file(descriptor: int, path: Path) -> bool:
    """Whether `path` is still the file that was opened, which its last owner may have deleted meanwhile."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat(follow_symlinks=False))
    except FileNotFoundError:
        return False
