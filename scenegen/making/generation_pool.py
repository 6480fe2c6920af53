"""Makes the scenes of a dataset in several processes: the same bytes in less time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from itertools import chain
from multiprocessing.synchronize import Event
from pathlib import Path

from disk.night_error import NightError
from processes.worker_processes import KILLED, results_in_order, submit, worker_pool
from scenegen.dataset import Dataset, SceneEntry
from scenegen.geometry_check import refusal
from scenegen.making.generation import Maker, finish, prepare, reported, write_scene
from scenegen.making.target import NO_MESHES, alone_in
from scenegen.possible_scenes import possible_scenes
from scenegen.preset import Preset
from scenegen.scene import Scene

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
    replacing: bool = False,
) -> Dataset:
    """As `generate`, in several processes; the bytes are the same.

    This process must not have loaded Blender: new processes inherit its `sys.path`, in which Blender's
    scripts hide the package `bpy`.

    Parameters
    ----------
    make_maker : called once in every worker; must be picklable.
    on_scene : called in this process for every scene.
    workers : number of processes.
    meshes, replacing : as in `generate`.

    Raises
    ------
    WorkerError : a worker was killed.
    DatasetError, SamplingError : as `generate`.
    """
    count = preset.dataset.count
    chunks = [range(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]
    workers = min(workers, len(chunks))
    try:
        with alone_in(root):
            prepare(root, preset, meshes, replacing=replacing)
            with worker_pool(workers, _start_worker, root, preset, make_maker) as pool:
                version = submit(pool, _version_in_worker)
                made: Iterator[SceneEntry] = chain.from_iterable(
                    results_in_order(pool, _write_in_worker, chunks, 2 * workers)
                )
                return finish(root, preset, meshes, reported(made, on_scene), version.result())
    except BrokenProcessPool:
        raise WorkerError(KILLED) from None


@dataclass(frozen=True)
class _Worker:
    """What a worker process keeps between tasks."""

    root: Path
    preset: Preset
    make_maker: Callable[[], Maker]
    stop: Event
    # Made in the first task: the parent gets its errors, but not those of the start.
    tools: list[tuple[Maker, Callable[[int], Scene]]]

    def maker_and_scenes(self) -> tuple[Maker, Callable[[int], Scene]]:
        if not self.tools:
            maker = self.make_maker()
            self.tools.append((maker, possible_scenes(self.preset, partial(refusal, meshes=maker.meshes))))
        return self.tools[0]


_workers: list[_Worker] = []  # of this process, if it is a worker: the tasks of a pool share only globals


def _start_worker(root: Path, preset: Preset, make_maker: Callable[[], Maker], stop: Event) -> None:
    _workers.append(_Worker(root, preset, make_maker, stop, []))


def _version_in_worker() -> str:
    return _workers[0].maker_and_scenes()[0].version


def _write_in_worker(indices: range) -> list[SceneEntry]:
    worker = _workers[0]
    maker, scene = worker.maker_and_scenes()
    made: list[SceneEntry] = []
    for index in indices:
        if worker.stop.is_set():
            break  # the command is ending and needs no more scenes
        made.append(write_scene(worker.root, scene(index), maker))
    return made
