"""Worker processes that draw and render the scenes of a stream, in an order that does not depend on them."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from typing import TYPE_CHECKING, Final

import numpy as np

from disk import NightError
from itof import phasor_of_return
from model.data.rows import RowBlock
from model.settings.fresh import FreshScenes
from model.settings.run import DeviceName
from processes.worker_processes import submit, worker_pool
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

if TYPE_CHECKING:
    from render.batch.light import BatchedLight

_log = logging.getLogger(__name__)
_MOST_DEATHS: Final = 3  # of workers, one after another, without a rendered scene between


class FreshError(NightError):
    """Scenes of a stream cannot be rendered."""


@dataclass(frozen=True)
class Rendering:
    """How a worker renders the scenes of a stream; picklable.

    Attributes
    ----------
    scenes : the stream, with the training's seed.
    meshes : the user's meshes of its preset, by shape.
    width, height : of the images, pixels.
    error : of the hidden light, relative to it.
    device : where to render.
    threads : of a worker, on the CPU.
    """

    scenes: FreshScenes
    meshes: Mapping[Shape, UnitMesh]
    width: int
    height: int
    error: float
    device: DeviceName
    threads: int

    def light(self) -> BatchedLight:
        """The engine, in this process."""
        from render.batch.light import BatchedLight

        return BatchedLight(
            *(self.scenes.preset.itof.frequencies_hz, self.width, self.height),
            error=self.error,
            meshes=self.meshes,
            device=self.device,
            threads=self.threads,
        )

    def rows(self, light: BatchedLight, indices: Sequence[int]) -> RowBlock:
        """Measurement and ground truth of scenes, by their numbers in the stream.

        Raises
        ------
        FreshError : none of the scenes with an object shows hidden light, or a value is not finite.
        """
        scenes = [self.scenes.scene(index, self.meshes) for index in indices]
        images = light.images(scenes)
        phasors = images.direct + images.hidden
        wrong = ~np.isfinite(phasors).all((1, 2, 3))
        if wrong.any():
            scene = indices[int(np.argmax(wrong))]
            raise FreshError(f"scene {scene} of the stream has values that are no numbers")
        if any(scene.hidden_objects for scene in scenes) and not images.hidden.any():
            raise FreshError(
                "the preset's corner lets no light through: the camera must see a part of the relay wall "
                "that the hidden object sees, too"
            )
        depth_m = images.radial_depth_m
        mask = depth_m > 0
        target = np.where(mask, phasor_of_return(depth_m, light.frequencies_hz[0]), 0)
        views_deg = np.array([scene.camera.horizontal_fov_deg for scene in scenes])
        return RowBlock(
            *(tuple(indices), phasors, target.astype(np.complex64), depth_m, mask.astype(np.uint8)),
            fields_of_view_deg=views_deg,
        )


class FreshWorkers:
    """Renders lists of scenes in worker processes, and gives the results in order.

    A worker that dies is replaced, and what it was rendering is rendered again.
    """

    def __init__(self, rendering: Rendering, count: int) -> None:
        self._rendering, self._count = rendering, count
        self._stack = ExitStack()
        self._pool: ProcessPoolExecutor | None = None

    def results(self, work: Iterator[list[int]]) -> Iterator[RowBlock]:
        """The rows of each list of scenes, in order; a few lists are rendered ahead.

        Raises
        ------
        FreshError : workers die again and again.
        NightError : a scene cannot be drawn or rendered.
        """
        waiting: deque[tuple[list[int], Future[RowBlock]]] = deque()
        deaths = 0
        while True:
            try:
                while len(waiting) <= self._count and (item := next(work, None)) is not None:
                    waiting.append((item, self._submit(item)))
                if not waiting:
                    return
                result = waiting[0][1].result()
            except BrokenProcessPool:
                deaths += 1
                if deaths == _MOST_DEATHS:
                    raise FreshError(
                        f"workers that render fresh scenes were killed {deaths} times, perhaps because "
                        "memory ran out: resume the run with more memory, or with a smaller run.workers"
                    ) from None
                _log.warning("a worker that renders fresh scenes was killed: it is replaced")
                self.close()
                waiting = deque((item, self._submit(item)) for item, _ in waiting)
                continue
            deaths = 0
            waiting.popleft()
            yield result

    def close(self) -> None:
        """End the processes."""
        with suppress(BrokenProcessPool):
            self._stack.close()
        self._stack, self._pool = ExitStack(), None

    def _submit(self, item: list[int]) -> Future[RowBlock]:
        if self._pool is None:
            self._pool = self._stack.enter_context(worker_pool(self._count, _start, self._rendering))
        return submit(self._pool, _rendered, item)


@dataclass(frozen=True)
class _Worker:
    """What a worker process keeps between tasks."""

    rendering: Rendering
    stop: Event
    light: list[BatchedLight]  # made in the first task: the parent gets its errors


_workers: list[_Worker] = []  # of this process, if it is a worker: the tasks of a pool share only globals


def _start(rendering: Rendering, stop: Event) -> None:
    _workers.append(_Worker(rendering, stop, []))


def _rendered(indices: list[int]) -> RowBlock:
    worker = _workers[0]
    if worker.stop.is_set():
        indices = indices[:1]  # the training ends and needs no more
    if not worker.light:
        worker.light.append(worker.rendering.light())
    return worker.rendering.rows(worker.light[0], indices)
