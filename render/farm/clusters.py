"""The workers of a run: processes of this machine, a running Dask cluster, or jobs of a batch system."""

from __future__ import annotations

import inspect
import logging
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from render.backend import Device, gpu_ids, select_variant
from scenegen import NightError

if TYPE_CHECKING:
    from dask_jobqueue.core import JobQueueCluster
    from distributed import Client

# Classes of dask-jobqueue by the name of the section in its configuration file.
_SYSTEMS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "moab": "MoabCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
}
_CONFIG = {
    # Dask must report the death of a worker at once: we count the attempts at a scene (render.farm.claims).
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    # Dask cannot spill the memory of our jobs, and a paused worker would stop the queue.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
# The nanny of a local worker starts it again when it dies. By default, Dask closes the nanny when this takes
# longer than 15 s, as it can on a busy machine, and the worker would be lost.
_LOCAL_CONFIG = {"distributed.deploy.lost-worker-timeout": "1 day"}
_CONNECT_S = 10
_ANY_LOCAL_PORT = "127.0.0.1:0"  # of the diagnostics page: its default port may be in use


class ClusterError(NightError):
    """There are no workers: the scheduler does not answer, or the cluster file cannot be used."""


@contextmanager
def connected(
    *, workers: int | None, scheduler: str | None, cluster_file: Path | None, device: Device
) -> Iterator[Client]:
    """A Dask client with workers. Everything that was started for it ends with the block.

    Parameters
    ----------
    workers : processes of this machine, or jobs of the batch system; None means one per device, or one job.
    scheduler : address of a running scheduler, like ``tcp://host:8786``.
    cluster_file : configuration of dask-jobqueue (YAML with ``jobqueue: slurm: ...``).

    Raises
    ------
    ClusterError : a scheduler and a file are both given, the scheduler does not answer, or the file cannot be
        used.
    BackendError : this machine cannot render on `device` (local workers only).
    """
    check_cluster(scheduler, cluster_file)
    import dask
    from distributed import Client

    _quieten()
    is_local = not (scheduler or cluster_file)
    with dask.config.set(_CONFIG | (_LOCAL_CONFIG if is_local else {})), ExitStack() as stack:
        _leave_ctrl_c_to_us(stack)
        if scheduler:
            try:
                client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
            except (OSError, ValueError, ImportError) as error:
                raise ClusterError(
                    f"no Dask scheduler answers at {scheduler} ({' '.join(str(error).split())}): start one "
                    "with dask scheduler, and workers with dask worker"
                ) from None
        else:
            if cluster_file:
                cluster = stack.enter_context(batch_cluster(cluster_file))
                # adapt, unlike scale, submits a new job when the time of a job is up
                cluster.adapt(minimum_jobs=workers or 1, maximum_jobs=workers or 1)
            else:
                cluster = stack.enter_context(_local_cluster(workers, device))
            client = Client(cluster, set_as_default=False)
        stack.enter_context(client)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        yield client


def batch_cluster(file: Path) -> JobQueueCluster:
    """The cluster that a configuration file of dask-jobqueue describes; no job is submitted yet.

    Raises
    ------
    ClusterError : the file is missing or not YAML, does not have exactly one system, or has unknown keys.
    """
    cls, options = _checked_cluster_file(file)
    try:
        made: JobQueueCluster = cls(**{"scheduler_options": {"dashboard_address": ":0"}, **options})
    except (ValueError, TypeError, RuntimeError, OSError) as error:
        raise ClusterError(f"{file}: {' '.join(str(error).split())}") from None
    return made


def check_cluster(scheduler: str | None, cluster_file: Path | None) -> None:
    """Check the choice of workers; connects to nothing and starts nothing.

    Raises
    ------
    ClusterError : both are given, or the file cannot be used.
    """
    if scheduler and cluster_file:
        raise ClusterError(
            "give either --scheduler or --cluster: the first joins a running cluster, the second starts one"
        )
    if cluster_file:
        _checked_cluster_file(cluster_file)


def _checked_cluster_file(file: Path) -> tuple[type, dict[str, Any]]:
    """Cluster class and options from a configuration file of dask-jobqueue."""
    system, options = _read_cluster_file(file)
    cls: type = getattr(import_module("dask_jobqueue"), _SYSTEMS[system])
    known = _known_options(cls)
    unknown = sorted(set(options) - known)
    if unknown:
        raise ClusterError(
            f"{file}: unknown key {unknown[0]} of jobqueue.{system}; known keys are "
            + ", ".join(sorted(known))
        )
    return cls, options


def _read_cluster_file(file: Path) -> tuple[str, dict[str, Any]]:
    import yaml

    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ClusterError(f"{file} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ClusterError(f"{file} is not YAML: {' '.join(str(error).split())}") from None
    sections = content.get("jobqueue") if isinstance(content, dict) else None
    if not isinstance(sections, dict) or len(sections) != 1 or not set(sections) <= set(_SYSTEMS):
        raise ClusterError(
            f"{file} must have one section jobqueue.<system>, with <system> one of {', '.join(_SYSTEMS)}"
        )
    ((system, options),) = sections.items()
    if not isinstance(options, dict):
        raise ClusterError(f"{file}: jobqueue.{system} must hold keys like cores, memory and walltime")
    missing = [key for key in ("cores", "memory") if options.get(key) is None]
    if missing:
        raise ClusterError(f"{file}: jobqueue.{system} needs {' and '.join(missing)} (of one job)")
    named = {str(key).replace("-", "_"): value for key, value in options.items()}
    if "name" in named:  # the classes of dask-jobqueue call this key job_name
        named["job_name"] = named.pop("name")
    return system, named


def _known_options(cls: type) -> set[str]:
    """Names of the parameters of a cluster class, of its job class, and of the base classes of both."""
    classes = [*cls.__mro__, *cls.job_cls.__mro__]  # type: ignore[attr-defined]
    return {
        name
        for each in classes
        if each is not object and "__init__" in vars(each)
        for name, parameter in inspect.signature(each.__init__).parameters.items()
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY) and name != "self"
    }


def _local_cluster(workers: int | None, device: Device) -> Any:
    """Worker processes of this machine: one for each GPU, or several that share the threads of the CPU."""
    from distributed import LocalCluster, Nanny
    from distributed.deploy.spec import SpecCluster
    from distributed.scheduler import Scheduler

    variant = select_variant(device)
    gpus = gpu_ids() if variant.startswith("cuda") else []
    count = workers or len(gpus) or 1
    if not gpus:
        threads = max(1, len(os.sched_getaffinity(0)) // count)
        return LocalCluster(
            n_workers=count,
            threads_per_worker=threads,
            dashboard_address=_ANY_LOCAL_PORT,
            silence_logs=logging.CRITICAL,
        )
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // count
    options = {
        "nthreads": 1,
        "memory_limit": memory,
        "host": "127.0.0.1",
        "silence_logs": logging.CRITICAL,
        "dashboard": False,
    }
    specs = {
        i: {"cls": Nanny, "options": {**options, "env": {"CUDA_VISIBLE_DEVICES": gpus[i % len(gpus)]}}}
        for i in range(count)
    }
    scheduler = {"cls": Scheduler, "options": {"host": "127.0.0.1", "dashboard_address": _ANY_LOCAL_PORT}}
    return SpecCluster(workers=specs, scheduler=scheduler, silence_logs=logging.CRITICAL)


def _leave_ctrl_c_to_us(stack: ExitStack) -> None:
    """Block SIGINT until the workers are started. They inherit this, so Ctrl-C reaches only this thread."""
    resource_tracker.ensure_running()  # started later, it would unblock SIGINT in this thread
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    stack.callback(signal.pthread_sigmask, signal.SIG_SETMASK, before)


def _quieten() -> None:
    """Silence Dask's log lines about its processes. Our lines say what happened to the scenes."""
    import distributed

    named = [name for name in logging.root.manager.loggerDict if name.startswith(f"{distributed.__name__}.")]
    for name in ("distributed", "dask_jobqueue", "tornado", "asyncio", *named):
        logging.getLogger(name).setLevel(logging.CRITICAL)
