"""Inputs of one kind: damage a file, run the command that reads it, judge, and tidy up."""

import functools
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from arena import Arena, allowed, contents
from judgement import judge, not_finite

SLOTS = 2  # commands at the same time


def damaged(kind, seed, work):
    """The damaged file of a seed, and the name of the damage."""
    rng = np.random.default_rng([zlib.crc32(kind.name.encode()), seed])
    data = (work / kind.file).read_bytes()
    other = (work / (kind.other or kind.file)).read_bytes()
    change = kind.damages[int(rng.integers(len(kind.damages)))]
    return change(rng, data, other), change.__qualname__.removesuffix(".<locals>.change")


class Slot:
    """One arena, in which commands run one after the other."""

    def __init__(self, forks, folder, template):
        self.forks, self.arena = forks, Arena(folder, template)
        self._expected = {}

    def try_seed(self, kind, seed):
        """Verdict on the command with the damaged file of a seed, and the name of the damage."""
        data, how = damaged(kind, seed, self.arena.template / "work")
        put = {kind.file: data} if kind.forge is None else kind.forge(self.arena.work, data)
        return judge(kind, *self._run(kind, put), self.expected(kind)), how

    def expected(self, kind):
        """What the command prints and writes with the undamaged file."""
        if kind.name not in self._expected:
            ended, _, result = self._run(kind, {})
            assert ended.signal is None, f"{kind.name}: {ended}"
            assert ended.code == 0 or "made_ply" in kind.names, f"{kind.name}: {ended}"
            assert not ended.after, f"{kind.name}: {ended}"
            self._expected[kind.name] = result
        return self._expected[kind.name]

    def _run(self, kind, put):
        """How the command ended, the paths that it should not have changed, and its result."""
        for name, data in put.items():
            self.arena.put(name, data)
        after = functools.partial(not_finite, kind.results)
        ended = self.forks.run(kind.words, self.arena.work, after=after)
        changed = self.arena.changed()
        wrong = {path for path in changed if not allowed(path, kind.reader.writes) or ".partial" in path}
        printed = [line for line in ended.out.splitlines() if not line.startswith("disk: ")]
        result = {"what it prints": "\n".join(printed), **contents(self.arena.work, kind.results)}
        self.arena.restore(changed, set(put))
        return ended, wrong, result


def try_seeds(slots, kind, seeds):
    """(seed, verdict, name of the damage) of each seed, in any order."""
    waiting = list(reversed(seeds))

    def work(slot):
        found = []
        while waiting:
            seed = waiting.pop()
            found.append((seed, *slot.try_seed(kind, seed)))
        return found

    with ThreadPoolExecutor(len(slots)) as pool:
        return [each for found in pool.map(work, slots[: len(seeds)]) for each in found]
