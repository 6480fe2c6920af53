"""Workers that a broken pool leaves behind."""

import time
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

import pytest

from scenegen.worker_processes import ended_when_broken

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
        worker.join(60)
        assert worker.exitcode is not None
        assert earlier.is_alive()
    finally:
        earlier.kill()
        worker.kill()
