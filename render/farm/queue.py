"""The queue of scenes: gives jobs to the workers, tries failed scenes again, records what failed twice.

The state of a run is in the files, not in the scheduler. The queue gives out only as many jobs as there are
workers, and a worker answers after it has written its files. A new run reads the files to find what is left.
"""

from __future__ import annotations

import logging
import queue as threads_queue
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from disk import NightError
from processes.progress import duration
from render.farm.claims import attempts_of, claimed
from render.farm.inventory import Inventory, known_recipe
from render.farm.jobs import GROWTH_BYTES, MAX_ATTEMPTS, Job, Outcome, render_scenes
from render.farm.submissions import Submissions
from render.settings import RenderSettings
from scenegen import Dataset, FailureRecord, read_record, write_failure

if TYPE_CHECKING:
    from distributed import Client, Future

_WAIT_S = 1.0  # between checks whether another command has finished its scenes
_COUNT_S = 1.0  # between counts of the workers
_NEXT_JOB_S = 180.0  # after the last worker has left, until the next job is submitted, at most
PATIENCE_S = 600.0  # a run without any worker ends with an error after this time
_WORD_S = 60.0  # without any worker, until the run says so; then each time that twice the time has passed
_MOST_KILLERS = 3  # scenes that killed their workers, if no other scene is done before
_RESTART_S = 60  # time limit for the start of a new worker process
_MOST_UNBEGUN_DEATHS = 5  # of workers that were given a scene and died before they began it
_ALL_DIE = (
    "each of the first scenes killed every worker that tried it (out of memory, or a crash of LLVM or the "
    "GPU driver), so no others are tried: use fewer --workers or a smaller --resolution, with --again failed"
)
_LOST = "the connection to the Dask scheduler was lost: start again to go on"

log = logging.getLogger(__name__)


class QueueError(NightError):
    """Rendering cannot go on: a full disk, no device, no worker, no scheduler."""


@dataclass
class Tally:
    """Results of a run: number of scenes by kind of outcome, and reason of failure by scene."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: dict[str, str] = field(default_factory=dict)


@dataclass
class RenderQueue:
    """Renders scenes on the workers of a Dask client.

    Attributes
    ----------
    client : connected to a scheduler whose workers see the dataset folder under the same path.
    dataset, settings : what to render and how.
    run_id : name of this run; attempts at a scene are counted for each run.
    on_outcome : called with every answer of a worker, and with True if the scene will not be tried again.
    growth_bytes : memory that a worker may grow by before it is replaced.
    patience_s : seconds to wait for a first worker; None waits without limit, because batch jobs may queue.
    submissions : which jobs the batch system takes; if it takes none any more, the run ends.
    say : called with each sentence about missing workers.
    work : function that a worker calls with a job.
    tally : results so far.
    """

    client: Client
    dataset: Dataset
    settings: RenderSettings
    run_id: str
    on_outcome: Callable[[Outcome, bool], None]
    growth_bytes: int = GROWTH_BYTES
    patience_s: float | None = PATIENCE_S
    submissions: Submissions = field(default_factory=Submissions)
    say: Callable[[str], object] = log.warning
    work: Callable[[Job], list[Outcome]] = render_scenes
    tally: Tally = field(default_factory=Tally)
    _word_s: float = _WORD_S  # without any worker, until the next sentence

    def run(self, scenes: Iterable[str]) -> Tally:
        """Render all `scenes`; returns when each is done, recorded as failed, or done by another command.

        Raises
        ------
        QueueError : nothing can be rendered any more; what is rendered stays.
        """
        waiting, elsewhere = deque(scenes), deque[str]()
        answers: threads_queue.SimpleQueue[Future] = threads_queue.SimpleQueue()
        active: dict[Future, tuple[str, ...]] = {}
        failed, returned = _Failures(), set[str]()
        idle_since = counted = time.monotonic()
        slots = self._slots()
        while waiting or active or elsewhere:
            if time.monotonic() - counted > _COUNT_S:  # counting takes longer than giving out a job
                slots, counted = self._slots(), time.monotonic()
            while waiting and len(active) < slots:
                scene_ids = self._next(waiting, slots, returned | failed.known)
                future = self._submit(scene_ids, scene_ids[0] in returned)
                active[future] = scene_ids
                future.add_done_callback(answers.put)
            if not waiting and not active:
                time.sleep(_WAIT_S)
                returned.update(elsewhere)
                waiting, elsewhere = elsewhere, deque[str]()
                continue
            try:
                future = answers.get(timeout=_WAIT_S)
            except threads_queue.Empty:
                idle_since = self._checked_idle(idle_since)
                continue
            scene_ids = active.pop(future)
            idle_since = time.monotonic()
            for outcome in self._answers(future, scene_ids, failed):
                if outcome.grown:
                    self._renew(outcome.grown)
                if outcome.kind == "stop":
                    raise QueueError(outcome.reason)
                if outcome.kind == "elsewhere":
                    elsewhere.append(outcome.scene_id)
                elif outcome.kind == "failed" and not self._is_final(outcome, failed):
                    self.on_outcome(outcome, False)
                    waiting.append(outcome.scene_id)
                    slots, counted = self._slots(), time.monotonic()  # its worker may have died
                else:
                    self._settle(outcome, failed)
                    failed.killers += outcome.died
                    if failed.killers == self.tally.counts.total() >= _MOST_KILLERS:
                        raise QueueError(_ALL_DIE)
        return self.tally

    def _next(self, waiting: deque[str], slots: int, alone: set[str]) -> tuple[str, ...]:
        """The scenes of the next job: as many as are rendered at once, but some for every worker.

        A scene in `alone`, which failed before or was in the hands of another process, is a job of its own.
        """
        count = min(self.settings.scenes_at_once(self.dataset), -(-len(waiting) // slots))
        scene_ids = [waiting.popleft()]
        while len(scene_ids) < count and waiting and not {scene_ids[0], waiting[0]} & alone:
            scene_ids.append(waiting.popleft())
        return tuple(scene_ids)

    def _submit(self, scene_ids: tuple[str, ...], returned: bool) -> Future:
        from distributed.protocol.pickle import dumps

        root = str(self.dataset.root.resolve())
        job = Job(root, self.settings, scene_ids, self.run_id, returned, self.growth_bytes)
        # In a form that needs no NIGHT: a worker without it would end, and not say so.
        return self.client.submit(_portable(), dumps((self.work, job)), pure=False, retries=0)

    def _slots(self) -> int:
        """How many jobs may be active: one per worker process, which does one at a time."""
        return max(1, self._workers())

    def _workers(self) -> int:
        """Number of worker processes; `QueueError` if the scheduler is gone."""
        try:
            return len(self.client.nthreads())
        except OSError:  # the connection broke before the answer
            raise QueueError(_LOST) from None

    def _checked_idle(self, since: float) -> float:
        """Time since when there has been no worker; `QueueError` if that is too long ago."""
        if self.client.status != "running":
            raise QueueError(_LOST)
        if self._workers():
            self._word_s = _WORD_S
            return time.monotonic()
        jobs, waited_s = self.submissions, time.monotonic() - since
        none_left = not jobs.pending and not jobs.unfinished
        if jobs.refusals and none_left and (not jobs.accepted or waited_s > _NEXT_JOB_S):
            raise QueueError(
                f"the batch system takes no job ({jobs.refusals[-1]}): correct the --cluster "
                "file, or the system's settings here"
            )
        if self.patience_s is not None and waited_s > self.patience_s:
            raise QueueError(
                f"no worker has started within {self.patience_s / 60:.0f} minutes: see the workers' logs"
            )
        if waited_s > self._word_s:
            self._word_s *= 2
            self.say(self._about_no_worker(waited_s))
        return since

    def _about_no_worker(self, waited_s: float) -> str:
        if jobs := len(self.submissions.unfinished):
            where = (
                f", with {jobs} jobs submitted: see the queue of the batch system, and the logs of the jobs"
            )
        elif self.patience_s is not None:
            where = (
                ": start one, or see the logs of those that were started; without one, the run ends after "
                f"{duration(self.patience_s)}"
            )
        else:
            where = ", and no job submitted yet"
        return f"no worker for {duration(waited_s)}{where}"

    def _answers(self, future: Future, scene_ids: tuple[str, ...], failed: _Failures) -> list[Outcome]:
        from distributed import KilledWorker

        try:
            outcomes: list[Outcome] = future.result()
        except KilledWorker as error:
            where = getattr(error.last_worker, "address", "")
            return [self._after_death(scene_id, where, str(error), failed) for scene_id in scene_ids]
        except CancelledError:
            return [Outcome(scene_ids[0], "stop", _LOST)]
        except Exception as error:  # of any kind: from a worker without NIGHT, or from Dask itself
            what = " ".join(str(error).split()) or type(error).__name__
            reason = f"the workers cannot take jobs ({what}): install the same NIGHT where they run"
            return [Outcome(scene_ids[0], "stop", reason)]
        finally:
            future.release()
        for outcome in outcomes:
            failed.answers[outcome.scene_id] += outcome.kind == "failed"
        return outcomes

    def _after_death(self, scene_id: str, worker: str, text: str, failed: _Failures) -> Outcome:
        """The answer about a scene of a worker that died."""
        if (done := self._done_before_death(scene_id, worker)) is not None:
            return done
        failed.deaths[scene_id] += 1
        reason = "its worker process died (out of memory, or a crash of LLVM or the GPU driver)"
        return Outcome(scene_id, "failed", reason, f"{text}\n", worker=worker, died=True)

    def _done_before_death(self, scene_id: str, worker: str) -> Outcome | None:
        """The answer for a worker that died after it had written all files of the scene; None if it had not.

        A scene that another command has just rendered is counted as rendered by both commands.
        """
        if Inventory(self.dataset, self.settings).state(scene_id) != "done":
            return None
        with claimed(self.dataset.renders, scene_id) as claim:
            if claim is not None:
                claim.forget()
        record = read_record(self.dataset.render_folder(scene_id))
        return Outcome(scene_id, "rendered", attributes=record.attributes if record else {}, worker=worker)

    def _renew(self, address: str) -> None:
        """Replace a worker by a new process. A job that it has not begun yet is given out again."""
        try:
            self.client.restart_workers([address], timeout=_RESTART_S, raise_for_error=False)
        except (OSError, ValueError, TimeoutError) as error:  # it may have ended already
            log.info("worker %s was not renewed: %s", address, " ".join(str(error).split()))

    def _is_final(self, outcome: Outcome, failed: _Failures) -> bool:
        """Whether a scene has used up its attempts. A worker that died before it began does not count."""
        scene_id = outcome.scene_id
        begun = attempts_of(self.dataset.renders, scene_id, self.run_id)
        return (
            outcome.final
            or max(begun, failed.answers[scene_id]) >= MAX_ATTEMPTS
            or failed.deaths[scene_id] >= _MOST_UNBEGUN_DEATHS
        )

    def _settle(self, outcome: Outcome, failed: _Failures) -> None:
        self.tally.counts[outcome.kind] += 1
        if outcome.kind == "failed":
            scene_id = outcome.scene_id
            self.tally.failures[scene_id] = outcome.reason
            if not outcome.final:
                begun = min(attempts_of(self.dataset.renders, scene_id, self.run_id), MAX_ATTEMPTS)
                failure = FailureRecord(
                    recipe=known_recipe(self.dataset, self.settings, scene_id),
                    attempts=max(begun, failed.answers[scene_id]) or failed.deaths[scene_id],
                    reason=outcome.reason,
                )
                write_failure(self.dataset.render_folder(scene_id), failure, outcome.log)
        self.on_outcome(outcome, True)


@dataclass
class _Failures:
    """How often each scene failed: with an answer, or because its worker died.

    `killers` are the scenes that were given up because of the latter.
    """

    answers: Counter[str] = field(default_factory=Counter)
    deaths: Counter[str] = field(default_factory=Counter)
    killers: int = 0

    @property
    def known(self) -> set[str]:
        """The scenes that failed."""
        return {*self.answers, *self.deaths}


def _portable() -> Callable[[bytes], list[Outcome]]:
    """A function that does a packed job. Dask sends a function that is made in another with all its code."""

    def do(packed: bytes) -> list[Outcome]:
        from distributed.protocol.pickle import loads

        work, job = loads(packed)
        outcomes: list[Outcome] = work(job)
        return outcomes

    return do
