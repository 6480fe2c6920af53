"""Suppresses what C libraries print; Python's own redirections do not affect them."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

_lock: Final = threading.Lock()
_inside: Final[Counter[int]] = Counter()  # blocks that are running, by descriptor
_kept: Final[dict[int, int]] = {}  # copies of the descriptors that are redirected


@contextmanager
def silenced(descriptor: int) -> Iterator[None]:
    """Discard everything that is written to a file descriptor: 1 (stdout) or 2 (stderr).

    Python's output before and after is kept. Output of other threads in the meantime is discarded, too. The
    first block that begins redirects the descriptor, and the last one that ends gives it back. Nothing
    happens to a descriptor that is closed.
    """
    with _lock:
        if not _inside[descriptor]:
            _redirect(descriptor)
        _inside[descriptor] += 1
    try:
        yield
    finally:
        with _lock:
            _inside[descriptor] -= 1
            if not _inside[descriptor] and descriptor in _kept:
                _flush()
                os.dup2(_kept[descriptor], descriptor)
                os.close(_kept.pop(descriptor))


def _redirect(descriptor: int) -> None:
    """Redirect a descriptor to nowhere, unless it is closed."""
    _flush()
    try:
        _kept[descriptor] = os.dup(descriptor)
    except OSError:
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _flush() -> None:
    """Write what Python and C hold back."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # as in a program that was started with 2>&-
            with suppress(
                OSError, ValueError
            ):  # it was closed, or a full disk: whoever prints there next learns of it
                stream.flush()
    ctypes.CDLL(None).fflush(None)
