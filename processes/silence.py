"""Suppresses what C libraries print; Python's own redirections do not affect them."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def silenced(descriptor: int) -> Iterator[None]:
    """Discard everything that is written to a file descriptor: 1 (stdout) or 2 (stderr).

    Python's output before and after is kept. Output of other threads in the meantime is discarded, too.
    Nothing happens to a descriptor that is closed.
    """
    libc = ctypes.CDLL(None)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # as in a program that was started with 2>&-
            with suppress(OSError):  # a full disk: whoever prints there next learns of it
                stream.flush()
    libc.fflush(None)
    try:
        kept = os.dup(descriptor)
    except OSError:
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    try:
        yield
    finally:
        libc.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)
        os.close(nowhere)
