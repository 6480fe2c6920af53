"""Makes the scenes of a dataset in several processes: the same bytes in less time."""

from __future__ import annotations

import os
import signal
import sys
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
from types import ModuleType
from typing import TypeVar

from scenegen.dataset import Dataset, SceneEntry
from scenegen.making.generation import Maker, finish, prepare, reported, write_scene
from scenegen.making.target import NO_MESHES
from scenegen.night_error import NightError
from scenegen.preset import Preset
from scenegen.worker_processes import ended_when_broken

_Result = TypeVar("_Result")
_CHUNK = 16  # scenes of one task: it takes tens of milliseconds, so that progress is visible


class WorkerError(NightError):
    """A worker process that ended before its work was done."""


def generate_in_processes(
    root: Path,
    preset: Preset,
    make_maker: Callable[[], Maker],
    on_scene: Callable[[], None],
    *,
    workers: int,
    meshes: Mapping[str, str] = NO_MESHES,
) -> Dataset:
    """As `generate`, in several processes; the bytes are the same.

    This process must not have loaded Blender: new processes inherit its `sys.path`, in which Blender's
    scripts hide the package `bpy`.

    Parameters
    ----------
    make_maker : called once in every worker; must be picklable.
    on_scene : called in this process for every scene.
    workers : number of processes.
    meshes : SHA-256 of the mesh files that the preset's shapes name, by shape.

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
    """What a worker process keeps between tasks."""

    root: Path
    preset: Preset
    make_maker: Callable[[], Maker]
    stop: Event
    makers: list[Maker]  # made in the first task: the parent gets its errors, but not those of the start

    def maker(self) -> Maker:
        if not self.makers:
            self.makers.append(self.make_maker())
        return self.makers[0]


_workers: list[_Worker] = []  # of this process, if it is a worker: the tasks of a pool share only globals


@contextmanager
def _pool(
    workers: int, root: Path, preset: Preset, make_maker: Callable[[], Maker]
) -> Iterator[ProcessPoolExecutor]:
    """A pool whose workers end when the block ends, with or without an error."""
    context = get_context("spawn")  # a fork would not have the threads of Blender and numpy
    stop = context.Event()
    pool = ProcessPoolExecutor(workers, context, _start_worker, (root, preset, make_maker, stop))
    try:
        with ended_when_broken():
            yield pool
    except BrokenProcessPool:
        raise WorkerError(
            "a worker process was killed, perhaps because memory ran out: run the same command again to "
            "continue, with a smaller --workers if it happens again"
        ) from None
    finally:
        stop.set()
        pool.shutdown()


def _submit(pool: ProcessPoolExecutor, task: Callable[..., _Result], *arguments: object) -> Future[_Result]:
    """Submit a task. A worker that is started for it ignores Ctrl-C, which this process handles for all.

    Nor does it run the caller's script again, as new processes do for functions that are defined there.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # new processes inherit the mask
    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        return pool.submit(task, *arguments)
    finally:
        sys.modules["__main__"] = main
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _results(pool: ProcessPoolExecutor, chunks: Iterable[range], ahead: int) -> Iterator[SceneEntry]:
    """Yield the scenes in order; `ahead` more chunks are submitted than the one that is waited for.

    No task is ever cancelled: a pool that breaks at that moment hangs (Python 3.11).
    """
    pending: deque[Future[list[SceneEntry]]] = deque()
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
    """End this process when its parent was killed; otherwise it would wait for work forever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _version_in_worker() -> str:
    return _workers[0].maker().version


def _write_in_worker(indices: range) -> list[SceneEntry]:
    worker = _workers[0]
    made: list[SceneEntry] = []
    for index in indices:
        if worker.stop.is_set():
            break  # the command is ending and needs no more scenes
        made.append(write_scene(worker.root, worker.preset, index, worker.maker()))
    return made
