"""Exchange of two names of one file system in a single step (Linux, ``renameat2``)."""

from __future__ import annotations

import ctypes
import os
from errno import EINVAL, ENOSYS, EOPNOTSUPP, EPERM
from pathlib import Path

_RENAME_EXCHANGE = 2  # linux/fs.h
_AT_FDCWD = -100  # fcntl.h: relative paths start at the working directory
# Without the call in kernel or file system; EPERM also from the call filters of containers.
_UNSUPPORTED = frozenset({ENOSYS, EINVAL, EOPNOTSUPP, EPERM})


def exchange(one: Path, other: Path) -> bool:
    """Exchange the files or folders at two paths; at every moment each path names one of the two.

    Returns
    -------
    False if the kernel or the file system cannot do this; then nothing has changed.

    Raises
    ------
    FileNotFoundError : there is nothing at one of the paths.
    OSError : the paths are on different file systems, or a folder cannot be changed.
    """
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:  # a C library without it
        return False
    if renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(one), None, str(other))
