"""Commands that write a result, and what must be there after they were disturbed."""

import time
from dataclasses import dataclass
from multiprocessing.connection import wait

from arena import Arena, allowed, contents
from forked import ended, kill_group
from judgement import judge_end
from kill_switch import KillBefore, changes, count_changes


@dataclass(frozen=True)
class Job:
    """A command that makes, replaces or continues a result.

    Attributes
    ----------
    command : the command that is disturbed.
    writes : patterns of paths that it may write.
    results : patterns of paths of its result, which are in the end those of an undisturbed run.
    again : the command with which its user goes on, once `resumes` exists.
    resumes : a file.
    whole : whether the result appears in one step: the old one or the new one is there at any time.
    """

    name: str
    command: str
    writes: tuple[str, ...]
    results: tuple[str, ...]
    again: str = ""
    resumes: str = "nothing"
    whole: bool = True


SHARDS = ("closed/shards", "closed/.hashes.json")
_TRAIN = "night-train closed --out new --preset training.toml --max-epochs 3 --device cpu"
_CONVERT = "night-render convert data --only 000000 --out new --to "
GEN = Job(
    *("night-gen", "night-gen scenes made_ply --preset ply.toml --count 4", ("made_ply",), ("made_ply",)),
    whole=False,
)
TRAIN = Job(
    *("night-train", _TRAIN, ("new", *SHARDS), ("new/best.safetensors", "new/history.csv")),
    again=f"{_TRAIN} --resume",
    resumes="new/run.json",
    whole=False,
)
JUDGE = Job(
    *("night-eval", "night-eval run closed --out report --mask-threshold 0.2 --device cpu"),
    *(("report", *SHARDS), ("report",)),
)
PREDICT = Job(
    *("night-eval predict", "night-eval predict run other.exr --out pred --device cpu", ("pred",), ("pred",))
)
TO_ITOF = Job("night-render convert --to itof", f"{_CONVERT}itof", ("new",), ("new",))
TO_TAL = Job("night-render convert --to tal", f"{_CONVERT}tal", ("new",), ("new",))
RENDER = Job(
    *("night-render", "night-render data --again failed --accept small-disk --cluster {scheduler}"),
    *(("data/renders",), ("data/renders/000001", "data/renders/rendering.json")),
    whole=False,
)
DROP = Job(
    *("night-render drop-transients", "night-render drop-transients data --only 000000 --yes"),
    *(("data/renders",), ("data/renders/000000", "data/renders/rendering.json")),
    whole=False,
)
EXPORT = Job(
    *("night-render export", "night-render export closed --out new.h5"),
    *(("new.h5", "closed/.hashes.json"), ("new.h5",)),
)
FIVE = (GEN, TRAIN, JUDGE, PREDICT, EXPORT)


class Stage:
    """An arena in which one job is disturbed again and again.

    Attributes
    ----------
    old, new : contents of the result before the job and after an undisturbed run.
    seconds : time of this run.
    change_count : changes of the disk in this run (`kill_switch`).
    """

    def __init__(self, forks, folder, template, job, private=None):
        self.forks, self.job = forks, job
        self.arena = Arena(folder, template, private)
        self.old = self.result()
        started = time.monotonic()
        done = self._run(job.command, before=count_changes, after=changes)
        self.seconds = time.monotonic() - started
        assert done.code == 0, done
        self.change_count = done.after
        self.new = self.result()
        self._restore()

    def result(self):
        """Bytes of the files of the result, by name."""
        return contents(self.arena.work, self.job.results)

    def killed_before(self, number):
        """Kill the job before one of its changes of the disk; what is wrong then, or None."""
        return self._after(self._run(self.job.command, before=KillBefore(number)))

    def killed_after(self, seconds):
        """Kill the job and all that it started after some time; what is wrong then, or None."""
        child = self.forks.start(self.job.command.split(), self.arena.work)
        wait([child.sentinel], seconds)
        kill_group(child.pid)
        return self._after(ended(child, self.arena.work))

    def run_in(self, before=None, relieve=lambda: None):
        """Run the job in a bad environment; (what is wrong then, or None; its exit code).

        Parameters
        ----------
        before : as of `forked.Forks.start`.
        relieve : called after the command; makes good again what others share.
        """
        end = self._run(self.job.command, before=before)
        relieve()
        wrong = judge_end(end)
        if wrong:
            self._restore()
            return wrong, end.code
        return self._after(end), end.code

    def _after(self, end):
        """What is wrong after a disturbance and after the command that goes on; brings the arena back."""
        try:
            return self._state(end) or (None if end.code == 0 else self._recovery()) or self._left()
        finally:
            self._restore()

    def _state(self, end):
        if end.signal not in ("SIGKILL", None):
            return f"it was not killed by us: {end}"
        result = self.result()
        if end.code == 0 and result != self.new:
            return f"exit code 0, and another result: {_difference(result, self.new)}"
        if end.code != 0 and self.job.whole and result not in (self.old, self.new):
            return f"neither the old nor the new result is there, but {sorted(result)}; {end}"
        return None

    def _recovery(self):
        goes_on = self.job.again and (self.arena.work / self.job.resumes).exists()
        was_whole = self.job.whole and self.result() == self.new
        again = self._run(self.job.again if goes_on else self.job.command)
        # Killed between its last change and its end: a command that keeps existing files says so then.
        kept = was_whole and "exists already" in (again.err or "")
        if again.code != 0 and not kept:
            return f"the next command failed: {again.err or again}"
        result = self.result()
        if result != self.new:
            return f"the result is another one in the end: {_difference(result, self.new)}"
        return None

    def _left(self):
        changed = self.arena.changed()
        wrong = {path for path in changed if not allowed(path, self.job.writes) or ".partial" in path}
        return f"left or changed: {sorted(wrong)}" if wrong else None

    def _restore(self):
        self.arena.restore(self.arena.changed(), set())

    def _run(self, command, **options):
        return self.forks.run(command.split(), self.arena.work, **options)


def _difference(found, expected):
    return sorted(name for name in {*found, *expected} if found.get(name) != expected.get(name))
