"""A kill at any moment of writing leaves the old or the new file or folder, whole, and then no leftovers."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from kill_points import KINDS

IN_TWO_STEPS = "folder in two steps"
CAMPAIGN = """
import json, kill_points, pathlib, sys
print(json.dumps(list(kill_points.after_each_kill(sys.argv[1], pathlib.Path(sys.argv[2])))))
"""


@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_before_any_call_leaves_the_old_or_the_new_one(tmp_path, kind):
    path, tests = tmp_path / "folder" / "x", Path(__file__).parents[1] / "support"
    done = subprocess.run(
        [sys.executable, "-c", CAMPAIGN, kind, path], capture_output=True, text=True, check=False, cwd=tests
    )
    assert done.returncode == 0, done.stderr
    left, recovered, beside = zip(*json.loads(done.stdout), strict=True)
    _, old, new = KINDS[kind]
    assert recovered == tuple(sorted(recovered, key=lambda one: one == new))
    assert (recovered[0], recovered[-1]) == (old, new)
    assert all(one in (old, new) for one in recovered)
    assert set(map(tuple, beside)) == {("x",)}
    # Only between two renames is there nothing, and only until the next command starts.
    assert left.count(None) == (kind == IN_TWO_STEPS)
