"""Some scenes as a job: what a worker process does, and what it answers.

An error in a scene is returned as an answer and not raised, so an exception from Dask always means that the
worker died or cannot take jobs. An error of the machine (a full disk, no device) stops the whole run.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from errno import EDQUOT, ENOSPC, EROFS
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from disk import NightError
from render.farm.claims import Claim, claimed
from render.farm.inventory import Inventory
from render.rendering import Renderer
from render.settings import RenderSettings
from scenegen import DatasetError, RenderRecord, open_dataset, read_failure

MAX_ATTEMPTS = 2
Kind = Literal["rendered", "present", "elsewhere", "failed", "stop"]
_HOPELESS = (ENOSPC, EDQUOT, EROFS)
_LEAST_FREE_BYTES = 2**20  # with less free space, any error while writing means a full disk
GROWTH_BYTES = 2**30  # a worker whose memory has grown by this much since its first scene is replaced

_one_at_a_time = threading.Lock()  # one scene already uses all threads of the process
_state: dict[str, Any] = {}  # of this worker process: its renderer, and its memory after the first scene


@dataclass(frozen=True)
class Job:
    """Scenes to render, mostly one.

    Attributes
    ----------
    root : folder of the dataset.
    settings : how to render.
    scene_ids : which scenes.
    run_id : which run the job belongs to.
    given_up_counts : whether a failure that another command has recorded is the answer to this job.
    growth_bytes : memory that the worker may grow by before it is replaced.
    night_version : version of the command; a worker must have the same.
    """

    root: str
    settings: RenderSettings
    scene_ids: tuple[str, ...]
    run_id: str
    given_up_counts: bool = False
    growth_bytes: int = GROWTH_BYTES
    night_version: str = field(default_factory=lambda: version("night-nlos"))


@dataclass(frozen=True)
class Outcome:
    """The answer about a scene of a job.

    Attributes
    ----------
    kind : ``rendered``; ``present``: it was rendered before; ``elsewhere``: another process is rendering it;
        ``failed``: this attempt failed; ``stop``: no scene can be rendered, so the run ends.
    reason : one sentence about a failure or a stop.
    log : traceback and warnings.
    seconds : rendering time, that of the job divided by its scenes.
    attributes : provenance of the rendered files.
    worker : host and process.
    final : whether another command has recorded this failure, so that the scene is not tried again.
    died : whether the worker died, so that this is not its own answer.
    grown : Dask address of this worker if it has grown too large and must be replaced, else empty.
    """

    scene_id: str
    kind: Kind
    reason: str = ""
    log: str = ""
    seconds: float = 0.0
    attributes: dict[str, str] = field(default_factory=dict)
    worker: str = field(default_factory=lambda: f"{socket.gethostname()}-{os.getpid()}")
    final: bool = False
    died: bool = False
    grown: str = ""


def render_scenes(job: Job) -> list[Outcome]:
    """Render the scenes of a job that are not rendered yet and that no other process is rendering."""
    if job.night_version != version("night-nlos"):
        return _stopped(
            job,
            f"a worker has NIGHT {version('night-nlos')} and this command has {job.night_version}: "
            "install the same version on both machines",
        )
    with _one_at_a_time:
        try:
            renderer, inventory = _workshop(job)
        except (NightError, OSError) as error:
            return _stopped(job, _on_host(error))
        try:
            outcomes = _render(job, renderer, inventory)
        except Exception as error:  # of any kind: what happens to one job must not end the run
            outcomes = [_failed(job, each, error) for each in job.scene_ids]
        return [replace(outcomes[0], grown=_grown(job.growth_bytes)), *outcomes[1:]]


def _stopped(job: Job, reason: str) -> list[Outcome]:
    return [Outcome(job.scene_ids[0], "stop", reason)]


def _failed(job: Job, scene_id: str, error: Exception) -> Outcome:
    """The answer about a scene that gave an error; a full disk stops the run."""
    text = "".join(traceback.format_exception(error))
    if isinstance(error, OSError):
        reason = f"{error.filename or job.root}: {error.strerror or error}"
        if error.errno in _HOPELESS or _is_full(Path(job.root)):
            reason = f"no space left for scene {scene_id} ({reason}): free some space and start again"
            return Outcome(scene_id, "stop", reason, text)
        return Outcome(scene_id, "failed", reason, text)
    reason = " ".join(str(error).split()).removeprefix(f"scene {scene_id}: ")
    return Outcome(scene_id, "failed", reason or type(error).__name__, text)


def _render(job: Job, renderer: Renderer, inventory: Inventory) -> list[Outcome]:
    with ExitStack() as stack:
        claims: dict[str, Claim] = {}
        outcomes: list[Outcome] = []
        for scene_id in job.scene_ids:
            claim = stack.enter_context(claimed(renderer.dataset.renders, scene_id))
            if claim is None:
                outcomes.append(Outcome(scene_id, "elsewhere"))
            elif known := _known(job, scene_id, claim, renderer, inventory):
                outcomes.append(known)
            else:
                claims[scene_id] = claim
        started = time.perf_counter()
        for scene_id, result, warnings in _rendered(renderer, list(claims)):
            if isinstance(result, Exception):
                outcomes.append(_failed(job, scene_id, result))
                continue
            claims[scene_id].forget()
            outcomes.append(Outcome(scene_id, "rendered", log=warnings, attributes=result.attributes))
        seconds = (time.perf_counter() - started) / max(len(claims), 1)
        return [replace(each, seconds=seconds if each.kind == "rendered" else 0) for each in outcomes]


def _rendered(
    renderer: Renderer, scene_ids: list[str]
) -> Iterator[tuple[str, RenderRecord | Exception, str]]:
    """Each scene with its record or error, and the warnings before that."""
    with _collected_warnings() as warnings:
        for scene_id, result in zip(scene_ids, renderer.render_all(scene_ids), strict=True):
            yield scene_id, result, "\n".join(warnings)
            warnings.clear()


def _known(job: Job, scene_id: str, claim: Claim, renderer: Renderer, inventory: Inventory) -> Outcome | None:
    """The answer about a scene that this job does not render; None if it renders it, and has begun."""
    folder = renderer.dataset.render_folder(scene_id)
    state = inventory.state(scene_id) if folder.is_dir() else "missing"
    if state == "done":
        claim.forget()
        return Outcome(scene_id, "present")
    failure = read_failure(folder)
    if job.given_up_counts and state == "failed" and failure is not None:
        return Outcome(scene_id, "failed", failure.reason, final=True)
    if claim.begin(job.run_id) > MAX_ATTEMPTS:  # the scheduler sent it again after its worker died
        reason = f"the worker died {MAX_ATTEMPTS} times while it rendered this scene"
        return Outcome(scene_id, "failed", reason, died=True)
    return None


def _workshop(job: Job) -> tuple[Renderer, Inventory]:
    """Renderer and inventory of this worker process, made once: its compiled kernels serve all scenes."""
    key = (job.root, job.settings, job.run_id)
    if not (Path(job.root) / "dataset.json").is_file():
        raise DatasetError(
            f"{job.root} is no dataset that this worker sees: workers need the same file system"
        )
    if _state.get("key") != key:
        _use_threads()
        dataset = open_dataset(Path(job.root))
        _state.update(key=key, made=(Renderer(dataset, job.settings), Inventory(dataset, job.settings)))
    made: tuple[Renderer, Inventory] = _state["made"]
    return made


def _use_threads() -> None:
    """Give DrJit as many threads as this worker has in Dask."""
    worker = _dask_worker()
    if worker is not None:
        import drjit as dr

        dr.set_thread_count(worker.state.nthreads)


def _grown(growth_bytes: int) -> str:
    """Address of this worker if it has grown too large and must be replaced, else an empty string."""
    worker = _dask_worker()
    if worker is None or worker.nanny is None:
        return ""
    import psutil

    now = psutil.Process().memory_info().rss
    first: int = _state.setdefault("memory", now)
    return str(worker.address) if now > first + growth_bytes else ""


def _dask_worker() -> Any:
    """The Dask worker that runs this job; None if there is none."""
    from distributed import get_worker

    try:
        return get_worker()
    except ValueError:
        return None


@contextmanager
def _collected_warnings() -> Iterator[list[str]]:
    """Collect the renderer's warnings for the log of the command; a worker's terminal is not seen."""
    found: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("render")
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


def _on_host(error: BaseException) -> str:
    return f"worker on {socket.gethostname()}: {' '.join(str(error).split())}"


def _is_full(folder: Path) -> bool:
    try:
        state = os.statvfs(folder)
    except OSError:  # it was deleted, which the next job reports
        return False
    return state.f_bavail * state.f_frsize < _LEAST_FREE_BYTES
