"""Worker processes of a pool that breaks."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children


@contextmanager
def ended_when_broken() -> Iterator[None]:
    """Kill the processes that were started in the block if the block ends because their pool broke.

    A pool of Python 3.11 that breaks while it starts a worker does not end this worker, and then waits for
    it without limit.
    """
    before = set(active_children())
    try:
        yield
    except BrokenProcessPool:
        for process in set(active_children()) - before:
            process.kill()
        raise
