"""Workers that a broken pool leaves behind."""

import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, resource_tracker, util

import pytest
from render_runs import wait_for

from processes.worker_processes import ended_when_broken, submit, worker_pool

SPAWN = get_context("spawn")


def breaking(start):
    with ended_when_broken():
        start()
        raise BrokenProcessPool("a worker was killed")


def test_a_pool_that_breaks_takes_the_workers_with_it_that_it_has_started_and_no_others():
    earlier, worker = (SPAWN.Process(target=time.sleep, args=(600,)) for _ in range(2))
    earlier.start()
    try:
        with pytest.raises(BrokenProcessPool):
            breaking(worker.start)
        worker.join(600)
        assert worker.exitcode is not None
        assert earlier.is_alive()
    finally:
        earlier.kill()
        worker.kill()


def test_a_worker_that_dies_while_the_next_one_starts_breaks_the_pool(monkeypatch):
    def kill_the_first(start=ProcessPoolExecutor._spawn_process):
        (worker,) = pool._processes.values()
        worker.kill()
        wait_for(lambda: pool._call_queue._closed)  # by the thread that watches the workers
        start(pool)

    with worker_pool(2, id) as pool:
        submit(pool, time.sleep, 600)
        monkeypatch.setattr(pool, "_spawn_process", kill_the_first)
        with pytest.raises(BrokenProcessPool):
            submit(pool, time.sleep, 600)


def start_a_worker():
    with worker_pool(1, id) as pool:
        submit(pool, sum, (1, 2))


def test_a_signal_while_a_worker_starts_leaves_the_worker_what_it_starts_with(monkeypatch, capfd):
    def signalled(*arguments, spawn=util.spawnv_passfds):
        pid = spawn(*arguments)
        signal.raise_signal(signal.SIGTERM)  # the new process is there, and has not been told what to do
        return pid

    resource_tracker.ensure_running()  # another process, which is started in the same way
    monkeypatch.setattr(util, "spawnv_passfds", signalled)
    before = signal.signal(signal.SIGTERM, lambda code, _: sys.exit(128 + code))
    try:
        with pytest.raises(SystemExit):
            start_a_worker()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capfd.readouterr().err == ""
