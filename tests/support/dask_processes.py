"""A Dask scheduler and its workers as processes of their own, as on the machines of a cluster."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

_START_S = 600  # the limit only keeps a broken test from hanging
# Processes that wait for work take a tenth of a core otherwise.
_CALM = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "10s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
}


@contextmanager
def dask_processes(folder, *workers, scheduler=()):
    """Start a scheduler with some options, and a `dask worker` with each of the given lists of options.

    Workers may still be starting when the block begins.

    Yields
    ------
    Address of the scheduler, and its process.
    """
    announced = folder / "scheduler.json"
    # Idle for an hour, it closes with its workers: should the tests be killed, nothing stays.
    options = [*scheduler, "--host", "127.0.0.1", "--port", "0", "--idle-timeout", "1 hour"]
    running = [_dask("scheduler", *options, "--scheduler-file", announced)]
    try:
        address = _address(running[0], announced)
        running += [_dask("worker", address, "--local-directory", folder, *options) for options in workers]
        yield address, running[0]
    finally:
        for process in running:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # a nanny and its workers at once
            process.wait(300)


def _dask(kind, *arguments):
    words = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--no-dashboard", *arguments]
    quiet = {**os.environ, **_CALM, "PYTHONWARNINGS": "ignore"}
    return subprocess.Popen(
        [str(word) for word in words], stderr=subprocess.DEVNULL, env=quiet, start_new_session=True
    )


def _address(scheduler, announced):
    end = time.monotonic() + _START_S
    while time.monotonic() < end and scheduler.poll() is None:
        try:
            return json.loads(announced.read_text())["address"]
        except (FileNotFoundError, ValueError):  # not written yet, or half of it
            time.sleep(0.02)
    raise RuntimeError("the Dask scheduler did not start")
