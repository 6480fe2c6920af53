"""Commands that fill the disk: one sentence, nothing lost, and the next one does the work."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from full_disk import small_disk
from jobs import EXPORT, GEN, JUDGE, PREDICT, RENDER, TO_ITOF, TO_TAL, TRAIN, Stage

pytestmark = pytest.mark.thorough
PLACES = {GEN: 6, RENDER: 6, TRAIN: 8, JUDGE: 3, PREDICT: 7, TO_ITOF: 5, TO_TAL: 5, EXPORT: 5}  # 45 in all
ROOM = 500_000_000  # bytes; enough for everything
PAGE = 4096


@pytest.mark.parametrize("job", PLACES, ids=lambda job: job.name)
def test_a_full_disk_ends_a_command_with_one_sentence(forks, samples, tmp_path, render_cluster, job):
    count = PLACES[job]
    job = replace(job, command=job.command.format(scheduler=render_cluster))
    (tmp_path / "private").mkdir()
    with small_disk(tmp_path / "disk") as resize:
        resize(ROOM)
        folder = tmp_path / "disk" / "arena"
        stage = Stage(forks, folder, samples, job, tmp_path / "private")
        needed = sum(len(data) + PAGE for data in stage.new.values())
        places = np.geomspace(PAGE, needed, count).astype(int)
        found = {}
        for free in map(int, places):
            resize(shutil.disk_usage(folder).used + free)
            found[free] = stage.run_in(relieve=lambda: resize(ROOM))
    assert {free: what for free, (what, _) in found.items() if what} == {}
    assert 2 in {code for _, code in found.values()}
