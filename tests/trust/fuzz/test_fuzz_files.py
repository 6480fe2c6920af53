"""Damaged and hostile files of every kind: refused in one sentence, or harmless."""

from collections import Counter

import pytest
from conftest import FIRST_SEED, INPUTS
from fuzzing import try_seeds
from table import KINDS

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_refused_or_harmless(slots, name, tell):
    kind = KINDS[name]
    count = max(1, round(INPUTS * kind.share))
    found = try_seeds(slots, kind, range(FIRST_SEED, FIRST_SEED + count))
    outcomes = Counter(verdict.outcome for _, verdict, _ in found)
    defects = [
        f"NIGHT_FUZZ_SEED={seed} ({how}): {verdict.outcome}: {verdict.detail}"
        for seed, verdict, how in found
        if verdict.is_defect
    ]
    expected = {outcome: outcomes[outcome] for outcome in ("refused", "bad", "same", "other")}
    tell("file and command", name, {"inputs": count, **expected, "defects": len(defects)})
    assert not defects, f"{len(defects)} of {count}, {kind.words}:\n" + "\n".join(sorted(defects)[:10])
