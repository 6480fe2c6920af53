"""Pools of worker processes that end when they should."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, connection, get_context, parent_process
from multiprocessing.synchronize import Event
from types import ModuleType
from typing import TypeVar

from processes.deferred_signals import deferred_signals

KILLED = (
    "a worker process was killed, perhaps because memory ran out: run the same command again to continue, "
    "with a smaller --workers if it happens again"
)
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def worker_pool(
    workers: int, start: Callable[..., None], *arguments: object
) -> Iterator[ProcessPoolExecutor]:
    """A pool whose workers end when the block ends, with or without an error, or this process is killed.

    Parameters
    ----------
    start : called once in every worker, with `arguments` and an event that is set when the results of tasks
        are no longer needed; picklable, as the arguments are.

    Raises
    ------
    BrokenProcessPool : a worker was killed.
    """
    context = get_context("spawn")  # a fork would not have the threads of Blender, torch and numpy
    stop = context.Event()
    pool = ProcessPoolExecutor(workers, context, _begin, (start, arguments, stop))
    try:
        with ended_when_broken():
            yield pool
    finally:
        stop.set()
        pool.shutdown()


def submit(pool: ProcessPoolExecutor, task: Callable[..., _Result], *arguments: object) -> Future[_Result]:
    """Submit a task. A worker that is started for it ignores Ctrl-C, which this process handles for all.

    Nor does it run the caller's script again, as new processes do for functions that are defined there. A
    signal waits until the worker has all that it starts with; without, it would end with a traceback.

    Raises
    ------
    BrokenProcessPool : a worker was killed.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # new processes inherit the mask
    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        with deferred_signals():
            return pool.submit(task, *arguments)
    except OSError as error:
        if getattr(pool, "_broken", False):  # while this call started a worker (Python 3.11)
            raise BrokenProcessPool(str(error)) from error
        raise
    finally:
        sys.modules["__main__"] = main
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def results_in_order(
    pool: ProcessPoolExecutor, task: Callable[[_Item], _Result], items: Iterable[_Item], ahead: int
) -> Iterator[_Result]:
    """Yield the results of a task in order; `ahead` more are submitted than the one that is waited for.

    No task is ever cancelled: a pool that breaks at that moment hangs (Python 3.11).
    """
    pending: deque[Future[_Result]] = deque()
    for item in items:
        pending.append(submit(pool, task, item))
        if len(pending) > ahead:
            yield pending.popleft().result()
    while pending:
        yield pending.popleft().result()


@contextmanager
def ended_when_broken(error: type[Exception] = BrokenProcessPool) -> Iterator[None]:
    """Kill the processes that were started in the block if it ends with this error, as of a broken pool.

    A pool of Python 3.11 that breaks while it starts a worker does not end this worker, and then waits for
    it without limit.
    """
    before = set(active_children())
    try:
        yield
    except error:
        for process in set(active_children()) - before:
            process.kill()
        raise


def _begin(start: Callable[..., None], arguments: tuple[object, ...], stop: Event) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    start(*arguments, stop)


def _end_with_parent() -> None:
    """End this process when its parent was killed; otherwise it would wait for work forever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
