"""Reading plain files of strangers: no pipe is waited for, and no device is read for ever."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EINVAL
from pathlib import Path
from typing import BinaryIO


def read_plain(file: Path, most_bytes: int) -> bytes:
    """The bytes of a file.

    Raises
    ------
    OSError : it cannot be read, is no plain file, or has more than `most_bytes`.
    """
    with opened_plain(file) as (stream, size):
        if size > most_bytes:
            raise OSError(EINVAL, f"it has {size} bytes, more than {most_bytes}", str(file))
        return stream.read(most_bytes)


@contextmanager
def opened_plain(file: Path) -> Iterator[tuple[BinaryIO, int]]:
    """Open a file to read it; yields the stream and the size of the file, bytes.

    Raises
    ------
    OSError : it cannot be opened, or is no plain file.
    """
    descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(EINVAL, "it is no plain file", str(file))
        yield stream, found.st_size
