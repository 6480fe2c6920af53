"""Workers that are processes of this machine."""

from __future__ import annotations

import logging
import socket
from resource import RLIM_INFINITY, RLIMIT_NOFILE, getrlimit, setrlimit
from typing import Any

from processes.cores import usable_cores
from processes.worker_processes import ended_when_broken
from render.backend import Device, gpu_ids, select_variant
from render.farm.dask_settings import NO_DASHBOARD, ClusterError, own_certificates

_FILES, _FILES_OF_WORKER = 40, 12  # that the command has open, alone and for each worker
_HOST = "127.0.0.1"
_START_S, _START_OF_WORKER_S = 58, 2  # for the first start of the workers, and for each of them
_RESTART_S = 600  # for a worker that is started again, beside others that render
_CONNECT_S = 5

log = logging.getLogger(__name__)


def local_cluster(workers: int | None, device: Device) -> Any:
    """Worker processes of this machine: one for each GPU, or several that share the threads of the CPU.

    A worker may be killed while it starts, for example because memory is short. The start is then tried once
    more, unless time has run out.

    Raises
    ------
    BackendError : this machine cannot render on `device`.
    ClusterError : the workers do not start or cannot be reached, or may not open enough files.
    """
    variant = select_variant(device)
    gpus = gpu_ids() if variant.startswith("cuda") else []
    count = workers or len(gpus) or 1
    _allow_open_files(count)
    _check_loopback()
    try:
        return _start(count, gpus)
    except Exception as error:  # of any kind: from Dask, from the system
        causes = _causes(error)
        if any(isinstance(cause, TimeoutError) for cause in causes):
            raise _not_started(f"within {_start_s(count)} s") from error
        log.info("the worker processes did not start (%s): once more", _words(causes[-1]))
    try:
        return _start(count, gpus)
    except Exception as error:  # of any kind: from Dask, from the system
        raise _not_started(f"at two attempts ({_words(_causes(error)[-1])})") from error


def _start(count: int, gpus: list[str]) -> Any:
    from distributed import Nanny
    from distributed.deploy.spec import SpecCluster
    from distributed.scheduler import Scheduler
    from distributed.system import MEMORY_LIMIT

    security = own_certificates()
    threads = 1 if gpus else max(1, usable_cores() // count)
    both = {"host": _HOST, "protocol": "tls://", "security": security}
    options = both | {
        "nthreads": threads,
        "memory_limit": MEMORY_LIMIT // count,
        "silence_logs": logging.CRITICAL,
        "dashboard": False,
        "death_timeout": _start_s(count),
    }
    environments = [{"CUDA_VISIBLE_DEVICES": gpus[i % len(gpus)]} if gpus else {} for i in range(count)]
    with ended_when_broken(Exception):
        cluster = SpecCluster(
            workers={
                i: {"cls": Nanny, "options": options | {"env": env}} for i, env in enumerate(environments)
            },
            scheduler={"cls": Scheduler, "options": both | NO_DASHBOARD},
            security=security,
            silence_logs=logging.CRITICAL,
        )
    for nanny in cluster.workers.values():
        nanny.death_timeout = _RESTART_S
    return cluster


def _start_s(workers: int) -> int:
    """Seconds after which workers that have not started have failed."""
    return _START_S + workers * _START_OF_WORKER_S


def _check_loopback() -> None:
    """Raise `ClusterError` if processes cannot connect to each other; Dask would try for minutes."""
    try:
        with socket.create_server((_HOST, 0)) as server:
            socket.create_connection(server.getsockname(), _CONNECT_S).close()
    except OSError as error:
        raise ClusterError(
            f"the processes of this machine cannot connect to each other at {_HOST} ({_words(error)}): turn "
            "its loopback device on (ip link set lo up)"
        ) from None


def _allow_open_files(workers: int) -> None:
    """Raise this process's limit of open files as far as needed; with too few, Dask may wait for ever.

    Raises
    ------
    ClusterError : the system does not allow as many.
    """
    needed = _FILES + workers * _FILES_OF_WORKER
    soft, hard = getrlimit(RLIMIT_NOFILE)
    if RLIM_INFINITY in (soft, hard):
        hard = max(needed, soft)
    if hard < needed:
        fitting = (hard - _FILES) // _FILES_OF_WORKER
        advice = f"give --workers {fitting}, or raise the limit" if fitting > 0 else "raise the limit"
        raise ClusterError(
            f"{workers} workers need {needed} open files, and the limit is {hard} (ulimit -n): {advice}"
        )
    if soft != RLIM_INFINITY and soft < needed:
        setrlimit(RLIMIT_NOFILE, (needed, getrlimit(RLIMIT_NOFILE)[1]))


def _not_started(when: str) -> ClusterError:
    return ClusterError(
        f"the worker processes did not start, {when}: try fewer --workers, and see whether memory is free"
    )


def _causes(error: BaseException) -> list[BaseException]:
    """An exception and those that led to it, the first of all last."""
    earlier = error.__cause__ or error.__context__
    return [error, *([] if earlier is None else _causes(earlier))]


def _words(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
