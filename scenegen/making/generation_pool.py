"""Making a dataset's scenes in several processes: the same bytes, sooner."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import TypeVar

from scenegen.dataset import Dataset
from scenegen.making.generation import NO_MESHES, Maker, finish, prepare, reported, write_scene
from scenegen.night_error import NightError
from scenegen.preset import Preset
from scenegen.scene import Scene

_Result = TypeVar("_Result")
_CHUNK = 16  # scenes a worker makes at a time: tens of milliseconds, so that progress shows


class WorkerError(NightError):
    """A worker process that ended before its work did."""


def generate_in_processes(
    root: Path,
    preset: Preset,
    make_maker: Callable[[], Maker],
    on_scene: Callable[[], None],
    *,
    workers: int,
    meshes: Mapping[str, str] = NO_MESHES,
) -> Dataset:
    """Like `generate`, in that many processes; the bytes are the same.

    Every worker calls `make_maker`, which must be picklable. This process must not have loaded Blender
    itself: new processes take over its `sys.path`, in which Blender's scripts hide the package `bpy`.

    Raises
    ------
    WorkerError : a worker was killed.
    DatasetError, SamplingError : as `generate`.
    """
    prepare(root, preset, meshes)
    count = preset.dataset.count
    chunks = [range(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]
    workers = min(workers, len(chunks))
    with _pool(workers, root, preset, make_maker) as pool:
        version = _submit(pool, _version_in_worker)
        scenes = reported(_results(pool, chunks, 2 * workers), on_scene)
        return finish(root, preset, meshes, scenes, version.result())


@dataclass(frozen=True)
class _Worker:
    """What a worker process keeps from chunk to chunk."""

    root: Path
    preset: Preset
    make_maker: Callable[[], Maker]
    stop: Event
    makers: list[Maker]  # made with the first chunk: an error there reaches the parent, one at the start not

    def maker(self) -> Maker:
        if not self.makers:
            self.makers.append(self.make_maker())
        return self.makers[0]


_workers: list[_Worker] = []  # of this process, if it is one: tasks of a pool share nothing else


@contextmanager
def _pool(
    workers: int, root: Path, preset: Preset, make_maker: Callable[[], Maker]
) -> Iterator[ProcessPoolExecutor]:
    """A pool whose workers end when the block ends, however it ends."""
    context = get_context("spawn")  # a fork would share Blender's and numpy's threads
    stop = context.Event()
    pool = ProcessPoolExecutor(workers, context, _start_worker, (root, preset, make_maker, stop))
    try:
        yield pool
    except BrokenProcessPool:
        raise WorkerError(
            "a worker process was killed, perhaps because memory ran out: the same command goes on where it "
            "was, with a smaller --workers if it happens again"
        ) from None
    finally:
        stop.set()
        pool.shutdown()


def _submit(pool: ProcessPoolExecutor, task: Callable[..., _Result], *arguments: object) -> Future[_Result]:
    """Hand out a task; a worker started for it leaves Ctrl-C, which reaches them all, to this process."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # a new process inherits that
    try:
        return pool.submit(task, *arguments)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _results(pool: ProcessPoolExecutor, chunks: Iterable[range], ahead: int) -> Iterator[Scene]:
    """The scenes in order, with so many chunks handed out ahead of the one that is waited for.

    None is ever cancelled: a pool that breaks at that moment hangs (Python 3.11).
    """
    pending: deque[Future[list[Scene]]] = deque()
    for chunk in chunks:
        pending.append(_submit(pool, _write_in_worker, chunk))
        if len(pending) > ahead:
            yield from pending.popleft().result()
    while pending:
        yield from pending.popleft().result()


def _start_worker(root: Path, preset: Preset, make_maker: Callable[[], Maker], stop: Event) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _workers.append(_Worker(root, preset, make_maker, stop, []))


def _end_with_parent() -> None:
    """End this process when its parent was killed: the pool would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _version_in_worker() -> str:
    return _workers[0].maker().version


def _write_in_worker(indices: range) -> list[Scene]:
    worker = _workers[0]
    made: list[Scene] = []
    for index in indices:
        if worker.stop.is_set():
            break  # nobody waits for the rest
        made.append(write_scene(worker.root, worker.preset, index, worker.maker()))
    return made
