"""Commands that are killed at any moment lose nothing; the next one leaves what an undisturbed one does."""

import numpy as np
import pytest
from conftest import FIRST_SEED, KILLS
from jobs import FIVE, Stage

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("job", FIVE, ids=lambda job: job.name)
def test_a_killed_command_loses_nothing(forks, samples, tmp_path, job, tell):
    stage = Stage(forks, tmp_path / "arena", samples, job)
    rng = np.random.default_rng(FIRST_SEED)
    wrong = {}
    for number in range(KILLS):
        if number % 2:
            moment = rng.uniform(0, stage.seconds)
            wrong[f"after {moment:.3f} s"] = stage.killed_after(moment)
        else:
            change = int(rng.integers(stage.change_count))
            wrong[f"before change {change} of {stage.change_count}"] = stage.killed_before(change)
    lost = {when: what for when, what in wrong.items() if what}
    tell("killed command", job.name, {"kills": KILLS, "lost": len(lost)})
    assert lost == {}
