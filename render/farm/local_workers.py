"""Workers that are processes of this machine."""

from __future__ import annotations

import logging
import os
from resource import RLIM_INFINITY, RLIMIT_NOFILE, getrlimit, setrlimit
from typing import Any

from render.backend import Device, gpu_ids, select_variant
from render.farm.dask_settings import NO_DASHBOARD, ClusterError, own_certificates

_FILES, _FILES_OF_WORKER = 40, 12  # that the command has open, alone and for each worker
_START_S = 600  # a worker that has not started after this time has failed

log = logging.getLogger(__name__)


def local_cluster(workers: int | None, device: Device) -> Any:
    """Worker processes of this machine: one for each GPU, or several that share the threads of the CPU.

    A worker may be killed while it starts, for example because memory is short. The start is then tried once
    more.

    Raises
    ------
    BackendError : this machine cannot render on `device`.
    ClusterError : the workers do not start, or may not open enough files.
    """
    variant = select_variant(device)
    gpus = gpu_ids() if variant.startswith("cuda") else []
    count = workers or len(gpus) or 1
    _allow_open_files(count)
    try:
        return _start(count, gpus)
    except Exception as error:  # of any kind: from Dask, from the system
        log.info("the worker processes did not start (%s): once more", _cause(error))
    try:
        return _start(count, gpus)
    except Exception as error:  # of any kind: from Dask, from the system
        raise ClusterError(
            f"the worker processes did not start, at two attempts ({_cause(error)}): try fewer --workers, "
            "and see whether memory is free"
        ) from error


def _start(count: int, gpus: list[str]) -> Any:
    from distributed import Nanny
    from distributed.deploy.spec import SpecCluster
    from distributed.scheduler import Scheduler
    from distributed.system import MEMORY_LIMIT

    security = own_certificates()
    threads = 1 if gpus else max(1, len(os.sched_getaffinity(0)) // count)
    both = {"host": "127.0.0.1", "protocol": "tls://", "security": security}
    options = both | {
        "nthreads": threads,
        "memory_limit": MEMORY_LIMIT // count,
        "silence_logs": logging.CRITICAL,
        "dashboard": False,
        "death_timeout": _START_S,
    }
    environments = [{"CUDA_VISIBLE_DEVICES": gpus[i % len(gpus)]} if gpus else {} for i in range(count)]
    return SpecCluster(
        workers={i: {"cls": Nanny, "options": options | {"env": env}} for i, env in enumerate(environments)},
        scheduler={"cls": Scheduler, "options": both | NO_DASHBOARD},
        security=security,
        silence_logs=logging.CRITICAL,
    )


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


def _cause(error: BaseException) -> str:
    """The first of the exceptions that led to this one, in one line."""
    while (earlier := error.__cause__ or error.__context__) is not None:
        error = earlier
    return " ".join(str(error).split()) or type(error).__name__
