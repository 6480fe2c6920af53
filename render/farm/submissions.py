"""The jobs of a run in a batch system: what becomes of them, and that they are submitted again.

Dask does not submit a refused job again, and does not notice the end of a job that has several workers.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field
from typing import Any

_LAST_LINES = 4  # of what a batch system says, where the reason is
_RETRY_S = 60  # after a refusal, until a job is submitted again

log = logging.getLogger(__name__)


@dataclass
class Submissions:
    """What a batch system made of the jobs of a run.

    Attributes
    ----------
    pending : number of jobs whose submission it has not answered yet.
    accepted : number of jobs that it has taken so far; unfinished : those that have not ended yet.
    refusals : why it refused the others.
    """

    pending: int = 0
    accepted: int = 0
    unfinished: set[Any] = field(default_factory=set)
    refusals: list[str] = field(default_factory=list)


def watched_job(job_cls: type, submissions: Submissions) -> type:
    """The job class, which also notes what becomes of its submissions."""
    from distributed import Status

    class WatchedJob(job_cls):
        async def start(self) -> None:
            submissions.pending += 1
            try:
                await super().start()
                submissions.accepted += 1
                submissions.unfinished.add(self)
            except Exception as error:  # of any class: a missing command, an exit code, or what a system adds
                said = str(error).rpartition("stderr:")[2].strip() or str(error)
                lines = [" ".join(line.split()) for line in said.splitlines() if line.strip()]
                submissions.refusals.append("; ".join(lines[-_LAST_LINES:]) or type(error).__name__)
                log.warning("the batch system refused a job: %s", submissions.refusals[-1])
                self.status = Status.failed  # otherwise the cluster cannot be closed
                asyncio.get_running_loop().call_later(_RETRY_S, self._forget)
                raise
            finally:
                submissions.pending -= 1

        async def close(self) -> None:
            submissions.unfinished.discard(self)
            try:
                await super().close()
            except OSError as error:  # the command that cancels jobs cannot be started
                log.warning("job %s could not be cancelled: %s", self.job_id, error)
            finally:  # dask-jobqueue leaves it at running, with which the cluster cannot be closed
                self.status = Status.closed

        def _forget(self) -> None:
            """Make the cluster submit this refused job again, as it does with a job that it lacks."""
            if submissions.pending:  # the cluster enters jobs when all of them are answered
                asyncio.get_running_loop().call_later(_RETRY_S, self._forget)
                return
            cluster = self._cluster()
            if submissions.accepted and cluster is not None and cluster.workers.get(self.name) is self:
                del cluster.workers[self.name]

    return WatchedJob


def watched_cluster(cls: type) -> type:
    """The cluster class, which also submits jobs with several workers again after their end."""
    import dask
    from dask.utils import parse_timedelta

    class WatchedCluster(cls):
        def _update_worker_status(self, op: str, msg: Any) -> None:
            worker = self.scheduler_info["workers"].get(msg) if op == "remove" else None
            super()._update_worker_status(op, msg)
            if worker is None:
                return
            name = _job_of(worker)
            if (job := self.workers.get(name)) is not None:
                delay_s = parse_timedelta(dask.config.get("distributed.deploy.lost-worker-timeout"))
                asyncio.get_running_loop().call_later(delay_s, self._end_without_workers, name, job)

        def _end_without_workers(self, name: str, job: Any) -> None:
            workers = self.scheduler_info["workers"].values()
            if self.workers.get(name) is job and not any(_job_of(worker) == name for worker in workers):
                del self.workers[name]
                self._futures.add(asyncio.ensure_future(job.close()))

    WatchedCluster.__name__ = cls.__name__  # jobs are named after it
    return WatchedCluster


def _job_of(worker: dict[str, Any]) -> str:
    """Name of the job of a worker, if the job has several; it adds ``-0``, ``-1``, ... to its name."""
    return str(worker["name"]).rpartition("-")[0]
