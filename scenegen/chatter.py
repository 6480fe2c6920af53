"""Suppresses what C libraries print; Python's own redirections do not affect them."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def silenced(descriptor: int) -> Iterator[None]:
    """Discard everything that is written to a file descriptor: 1 (stdout) or 2 (stderr).

    Python's output before and after is kept. Output of other threads in the meantime is discarded, too.
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
