"""The refinement of one scene after the other, in this process or in several."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter
from pydantic.dataclasses import dataclass as checked_dataclass

from disk import whole_file, write_text
from disk.contract import STRICT
from disk.plain_file import read_text
from disk.quantities import Vector
from itof import DepthMap
from itof.metrics import ImageMetrics, image_metrics
from itof.wall.expected_wall import ExpectedWall
from itof.wall.wall_view import WallView
from model.data.shards import Shards, open_shards
from model.device import one_thread
from model.judging.judged_split import seeing
from model.judging.judging import Bench
from model.judging.refusals import EvaluationError
from model.prediction.predictor import Predictor, load
from model.refinement.family import Family
from model.refinement.light.corner_light import CornerLight, known_corner
from model.refinement.refined_result import RefinedScene, SceneNumbers
from model.refinement.refining import refined
from model.refinement.settings import Unknown
from model.run_folder.run_config import Sha256
from model.settings.run import DeviceName
from processes.worker_processes import KILLED, results_in_order, worker_pool
from scenegen import Dataset, Split, open_dataset
from scenegen.pose import wall_geometry
from scenegen.scene import Scene

SCENES_FOLDER = "scenes"


@checked_dataclass(frozen=True, config=STRICT)
class Recipe:
    """What results depend on; only results of the same recipe are kept.

    Attributes
    ----------
    weights_sha256 : of ``best.safetensors``, which change while a run goes on; its ``run_id`` does not.
    """

    run_id: str | None
    weights_sha256: Sha256
    data_sha256: str
    split: Split
    sizes_m: dict[str, Vector]
    reflectance: float | None
    apart_m: float | None
    unknown: tuple[Unknown, ...]
    largest_misfit: float
    schema_version: Literal[6] = 6


@dataclass(frozen=True)
class Work:
    """What the scenes of a split have in common."""

    bench: Bench
    light: CornerLight
    family: Family
    recipe: Recipe
    out: Path

    def result(self, row: int, scene: str) -> RefinedScene:
        """Predict, refine and judge one scene, and write its files."""
        with one_thread():
            return self._result(row, scene)

    def _result(self, row: int, scene: str) -> RefinedScene:
        bench = self.bench
        block = bench.shards.read([row])
        used = bench.predictor.config.inputs.places(bench.shards.manifest.frequencies_hz)
        prediction = bench.predict(block)[0]
        phasor = block.phasors[0][..., used]
        entry = bench.dataset.scene(scene)
        corner = known_corner(entry)
        expected_m, wall = bench.predictor.expected_mae_m(prediction), self._wall(corner, used)
        found = refined(
            *(phasor, prediction, expected_m, wall, corner, self.light, self.family), seed=entry.seed
        )
        explanation = None
        if found is not None:
            explanation = found.explained(prediction, expected_m, self.recipe.largest_misfit)
        better = found.depth_map if found and explanation and explanation.accepted else prediction
        truth = block.radial_depth_m[0], block.mask[0]
        result = RefinedScene(
            scene,
            entry.object_class,
            _numbers(image_metrics(prediction.radial_depth_m, prediction.mask, *truth)),
            _numbers(image_metrics(better.radial_depth_m, better.mask, *truth)),
            expected_m,
            explanation,
        )
        self._write(result, better)
        return result

    def _wall(self, corner: Scene, used: list[int]) -> ExpectedWall:
        """Where the relay wall is expected; a dataset of one corner has a reference for its light."""
        bench, view = self.bench, WallView(**wall_geometry(corner.camera, corner.relay_wall))
        frequencies_hz = bench.predictor.config.inputs.frequencies_hz
        if bench.dataset.preset.is_one_corner:
            return view.expected_wall(bench.shards.reference[..., used], frequencies_hz)
        height, width = bench.shards.reference.shape[:2]
        return view.expected_wall(view.direct_phasors(width, height, frequencies_hz), frequencies_hz)

    def shown(self, row: int) -> tuple[str, DepthMap, DepthMap, DepthMap]:
        """Name of a finished scene, and the depth maps of truth, network and refinement."""
        block = self.bench.shards.read([row])
        (scene,) = self.bench.shards.ids([row])
        prediction = self.bench.predict(block)[0]
        truth = DepthMap.of_object(block.radial_depth_m[0], block.mask[0] > 0, prediction.frequency_hz)
        better = DepthMap.read(self.out / SCENES_FOLDER / f"{scene}.exr")
        name = f"{scene} {self.bench.dataset.scene(scene).object_class.replace('_', ' ')}"
        return name, truth, prediction, better

    def _write(self, result: RefinedScene, better: DepthMap) -> None:
        folder = self.out / SCENES_FOLDER
        with whole_file(folder / f"{result.scene}.exr") as partial:  # a link is replaced
            better.write(partial, {"scene_id": result.scene})
        write_text(folder / f"{result.scene}.json", json.dumps(asdict(result), indent=1) + "\n")


@dataclass(frozen=True)
class Job:
    """What a process needs to know to refine scenes.

    Attributes
    ----------
    run, dataset, out : folders.
    """

    run: Path
    dataset: Path
    device: DeviceName
    family: Family
    recipe: Recipe
    out: Path

    def begun(self, predictor: Predictor, dataset: Dataset, shards: Shards) -> Work:
        """The job with its network and its dataset, which are open.

        Raises
        ------
        EvaluationError : the weights of the run are others than when the job began.
        """
        if predictor.weights_sha256 != self.recipe.weights_sha256:
            raise EvaluationError(
                f"the weights of {self.run} have changed: refine again when its training ends"
            )
        bench = Bench(
            seeing(predictor, dataset, shards), predictor.config.readout, dataset, shards, progress=False
        )
        light = CornerLight(predictor.config.inputs.frequencies_hz, self.device)
        return Work(bench, light, self.family, self.recipe, self.out)


def worked(job: Job, work: Work, scenes: Sequence[tuple[int, str]], workers: int) -> Iterator[RefinedScene]:
    """Results of scenes, each with its row of the shards, in this order.

    Parameters
    ----------
    work : `job` in this process.
    workers : number of processes; with 1, it is this one.

    Raises
    ------
    EvaluationError : a worker process was killed.
    """
    if min(workers, len(scenes)) <= 1:
        for row, scene in scenes:
            yield work.result(row, scene)
        return
    workers = min(workers, len(scenes))
    try:
        with worker_pool(workers, _start_worker, job) as pool:
            for result in results_in_order(pool, _work_in, scenes, 2 * workers):
                if result is not None:
                    yield result
    except BrokenProcessPool:
        raise EvaluationError(KILLED) from None


@dataclass(frozen=True)
class _Worker:
    """What a worker process keeps between tasks; the work is begun in the first one."""

    job: Job
    stop: Event
    begun: list[Work]


_workers: list[_Worker] = []  # of this process, if it is a worker: the tasks of a pool share only globals


def _start_worker(job: Job, stop: Event) -> None:
    _workers.append(_Worker(job, stop, []))


def _work_in(scene: tuple[int, str]) -> RefinedScene | None:
    """The result of a scene; None if the command is ending."""
    worker = _workers[0]
    if worker.stop.is_set():
        return None
    if not worker.begun:
        job, dataset = worker.job, open_dataset(worker.job.dataset)
        shards = open_shards(dataset, progress=False)
        worker.begun.append(job.begun(load(job.run, job.device), dataset, shards))
    return worker.begun[0].result(*scene)


def read_result(out: Path, scene: str) -> RefinedScene | None:
    """The result of a scene that an earlier command has finished; None if there is none, or it is damaged."""
    folder = out / SCENES_FOLDER
    try:
        content = read_text(folder / f"{scene}.json")
        result = TypeAdapter(RefinedScene).validate_json(content)
        DepthMap.read(folder / f"{scene}.exr")
    except (OSError, ValueError):
        return None
    return result if result.scene == scene else None


def _numbers(metrics: ImageMetrics) -> SceneNumbers:
    return SceneNumbers(**asdict(metrics))
