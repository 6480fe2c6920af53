"""Reading plain files of strangers: no pipe is waited for, and no device is read for ever."""

from __future__ import annotations

import os
import stat
from errno import EINVAL
from pathlib import Path


def read_plain(file: Path, most_bytes: int) -> bytes:
    """The bytes of a file.

    Raises
    ------
    OSError : it cannot be read, is no plain file, or has more than `most_bytes`.
    """
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(EINVAL, "it is no plain file", str(file))
        if found.st_size > most_bytes:
            raise OSError(EINVAL, f"it has {found.st_size} bytes, more than {most_bytes}", str(file))
        return stream.read(most_bytes)
