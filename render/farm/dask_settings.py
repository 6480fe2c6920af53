"""How a run uses Dask: settings, log lines, and connections and files that other users cannot use.

Whoever can connect to a scheduler or a worker of Dask can run programs there, and Dask imports modules from
its folders for temporary files.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from disk import NightError
from disk.private_folder import private_folder

if TYPE_CHECKING:
    from distributed import Security

_SETTINGS = {
    # Dask must report the death of a worker at once: we count the attempts at a scene (render.farm.claims).
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    # Dask cannot spill the memory of our jobs, and a paused worker would stop the queue.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
# The web pages of schedulers and workers: they ask nobody who he is.
_NO_PAGES: dict[str, Any] = {"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []}
# Dask always opens a port for them. Its default port may be in use.
NO_DASHBOARD = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
# The nanny of a local worker starts it again when it dies. By default, Dask closes the nanny when this takes
# longer than 15 s, as it can on a busy machine, and the worker would be lost.
_LOCAL_SETTINGS = {"distributed.deploy.lost-worker-timeout": "1 day"}
# A job whose worker is gone for this time is cancelled. A worker that is started again needs a part of it.
_REMOTE_SETTINGS = {"distributed.deploy.lost-worker-timeout": "60s"}


class ClusterError(NightError):
    """There are no workers: the scheduler does not answer, or the cluster file cannot be used."""


@contextmanager
def dask_settings(*, is_local: bool, shows_pages: bool) -> Iterator[None]:
    """Dask with our settings and a private folder for temporary files while the block runs.

    Parameters
    ----------
    is_local : whether the workers are processes of this machine.
    shows_pages : whether the scheduler may show its web pages.
    """
    import dask

    _quieten()
    folder = str(private_folder())
    # The configuration of the user is for clusters of his own, and could stop ours.
    settings = dask.config.merge(*dask.config.defaults) if is_local else {}
    settings |= _SETTINGS | {"temporary-directory": folder}
    settings |= (_LOCAL_SETTINGS if is_local else _REMOTE_SETTINGS) | ({} if shows_pages else _NO_PAGES)
    before = tempfile.tempdir
    tempfile.tempdir = folder  # of job scripts and certificates
    try:
        with dask.config.set(settings):
            yield
    finally:
        tempfile.tempdir = before


def own_certificates() -> Security:
    """TLS certificates of one run. Without them, nobody can connect to its scheduler and workers.

    They stay in memory and reach worker processes through a pipe.
    """
    from distributed import Security

    made: Security = Security.temporary()
    return made


def _quieten() -> None:
    """Silence Dask's log lines about its processes. Our lines say what happened to the scenes."""
    import distributed

    named = [name for name in logging.root.manager.loggerDict if name.startswith(f"{distributed.__name__}.")]
    for name in ("distributed", "dask_jobqueue", "tornado", "tornado.application", "asyncio", *named):
        logging.getLogger(name).setLevel(logging.CRITICAL)
