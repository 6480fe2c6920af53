"""A kill at any moment of writing leaves the old or the new file or folder, whole, and then no leftovers."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from kill_points import KINDS, contents, names, strace, system_calls

from disk import whole_file, whole_folder

IN_TWO_STEPS = "folder in two steps"
CAMPAIGN = """
import json, kill_points, pathlib, sys
print(json.dumps(list(kill_points.after_each_kill(sys.argv[1], pathlib.Path(sys.argv[2])))))
"""


def assert_old_until_new(kind, found):
    """`found` is the old one for the first kills and the new one for the last; nothing else."""
    _, old, new = KINDS[kind]
    assert all(one in (old, new) for one in found)
    assert found[0] == old
    assert found[-1] == new
    assert found == sorted(found, key=lambda one: one == new)


@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_before_any_call_leaves_the_old_or_the_new_one(tmp_path, kind):
    path, tests = tmp_path / "folder" / "x", Path(__file__).parents[1] / "support"
    done = subprocess.run(
        [sys.executable, "-c", CAMPAIGN, kind, path], capture_output=True, text=True, check=False, cwd=tests
    )
    assert done.returncode == 0, done.stderr
    left, recovered, beside = zip(*json.loads(done.stdout), strict=True)
    assert_old_until_new(kind, list(recovered))
    assert set(map(tuple, beside)) == {("x",)}
    # Only between two renames is there nothing, and only until the next command starts.
    assert left.count(None) == (kind == IN_TWO_STEPS)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed: apt-get install strace")
def test_a_kill_at_every_system_call_leaves_the_old_or_the_new_one(tmp_path, kind):
    write, old, _ = KINDS[kind]
    path, log = tmp_path / "folder" / "x", tmp_path / "log"
    broken = ["-e", "inject=renameat2:error=ENOSYS"] if kind == IN_TWO_STEPS else []
    write(path, old)
    assert strace(*broken, kind=kind, path=path, log=log) == 0
    calls = [call for call in system_calls(log) if not broken or call[0] != "renameat2"]
    assert len(calls) > 10
    found = []
    for name, number in calls:
        write(path, old)
        kill = ["-e", f"inject={name}:signal=KILL:when={number}"]
        assert strace(*broken, *kill, kind=kind, path=path, log=log) == -9, (name, number)
        left = contents(path)
        with pytest.raises(ZeroDivisionError), {"file": whole_file}.get(kind, whole_folder)(path):
            1 / 0  # noqa: B018 -- the next command, which fails
        found.append(contents(path))
        assert left in (found[-1], None)
        assert names(path.parent) == ["x"]
    assert_old_until_new(kind, found)
