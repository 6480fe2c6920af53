"""The workers of a run: processes of this machine, a running Dask cluster, or jobs of a batch system."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from disk import PathLike
from disk.extras import need
from render.backend import Device
from render.farm.batch_system import batch_cluster, check_cluster_file
from render.farm.dask_settings import ClusterError, dask_settings
from render.farm.local_workers import local_cluster
from render.farm.scheduler_address import CONNECT_S, check_address, check_answer
from render.farm.submissions import Submissions

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def connected(
    *,
    workers: int | None,
    scheduler: str | None,
    cluster_file: PathLike | None,
    device: Device,
    keys_folder: PathLike = ".",
    submissions: Submissions | None = None,
) -> Iterator[Client]:
    """A Dask client with workers. Everything that was started for it ends with the block.

    Nobody else can connect to a scheduler and workers that are started here. A scheduler that is running
    already is as safe as its owner made it.

    Parameters
    ----------
    workers : processes of this machine, or jobs of the batch system; None means one per device, or one job.
    scheduler : address of a running scheduler, like ``tcp://host:8786``.
    cluster_file : configuration of dask-jobqueue (YAML with ``jobqueue: slurm: ...``).
    keys_folder : folder that all jobs see, for the certificates of their connections.
    submissions : notes which jobs the batch system takes.

    Raises
    ------
    ClusterError : a scheduler and a file are both given, the scheduler does not answer, the file cannot be
        used, or local workers do not start.
    BackendError : this machine cannot render on `device` (local workers only).
    """
    shows_pages = check_cluster(scheduler, cluster_file, workers)
    is_local = scheduler is None and cluster_file is None
    with dask_settings(is_local=is_local, shows_pages=shows_pages), ExitStack() as stack:
        _leave_ctrl_c_to_us(stack)
        if scheduler is not None:
            client = _joined(scheduler)
        else:
            client = _started(stack, workers, cluster_file, device, keys_folder, submissions)
        stack.enter_context(client)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        try:
            yield client
        finally:
            if cluster_file is not None:  # a second Ctrl-C would leave jobs in the batch system
                signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def check_cluster(scheduler: str | None, cluster_file: PathLike | None, workers: int | None = None) -> bool:
    """Check the choice of workers; connects to nothing and starts nothing.

    Returns
    -------
    Whether the scheduler may show its web pages, because the file asks for them.

    Raises
    ------
    ClusterError : both are given, a number of workers is given for a running cluster, or the file cannot be
        used, or one of Dask's configuration.
    MissingPackageError : the extra ``cluster`` is not installed.
    """
    need("cluster", ("cryptography", "dask_jobqueue", "distributed"), "night-render DATASET")
    try:
        import dask  # noqa: F401
    except ValueError as error:  # Dask reads all files of its configuration when it is imported
        raise ClusterError(f"{' '.join(str(error).split())}: correct this file") from None
    if scheduler is not None and cluster_file is not None:
        raise ClusterError("give either the address of a running cluster or a file that starts one")
    if scheduler is not None and workers is not None:
        raise ClusterError(
            "--workers is for this machine or for --cluster: a running cluster has its own workers"
        )
    if scheduler is not None:
        check_address(scheduler)
    return cluster_file is not None and check_cluster_file(cluster_file)


def _joined(scheduler: str) -> Client:
    from distributed import Client

    check_answer(scheduler)
    try:
        return Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except Exception as error:  # of any kind: from Dask
        what = " ".join(str(error).split()) or type(error).__name__
        raise ClusterError(f"the Dask scheduler at {scheduler} takes no clients ({what})") from None


def _started(
    stack: ExitStack,
    workers: int | None,
    cluster_file: PathLike | None,
    device: Device,
    keys_folder: PathLike,
    submissions: Submissions | None,
) -> Client:
    from distributed import Client

    if cluster_file is not None:
        cluster = stack.enter_context(batch_cluster(cluster_file, keys_folder, submissions))
        # adapt, unlike scale, submits a new job when the time of a job is up
        cluster.adapt(minimum_jobs=workers or 1, maximum_jobs=workers or 1)
    else:
        cluster = stack.enter_context(local_cluster(workers, device))
    return Client(cluster, set_as_default=False)


def _leave_ctrl_c_to_us(stack: ExitStack) -> None:
    """Block SIGINT until the workers are started. They inherit this, so Ctrl-C reaches only this thread."""
    resource_tracker.ensure_running()  # started later, it would unblock SIGINT in this thread
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    stack.callback(signal.pthread_sigmask, signal.SIG_SETMASK, before)
