"""Keeping the prints of C libraries off the terminal, where Python's redirections do not reach."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silenced(descriptor: int) -> Iterator[None]:
    """Send what is written to file descriptor 1 (stdout) or 2 (stderr) to nowhere, for a while.

    Python's own output before and after is kept; threads that print meanwhile are silenced as well.
    """
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    sys.stderr.flush()
    libc.fflush(None)
    kept = os.dup(descriptor)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    try:
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)
