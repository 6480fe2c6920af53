"""What a command may do with a damaged file: refuse it in one sentence, or give the right result."""

import csv
import json
import re
from dataclasses import dataclass
from pathlib import Path

MEMORY_BYTES = 2 * 2**30  # a command on these small samples needs a quarter of this
LONGEST = 3000  # characters of all that a refusal prints
DEFECTS = ("crashed", "hung", "traceback", "hungry", "unclear", "unnamed", "touched", "left", "believed")


@dataclass(frozen=True)
class Verdict:
    """`outcome` is ``refused``, ``bad`` (exit code 1), ``same``, ``other`` (another result), or a defect."""

    outcome: str
    detail: str = ""

    @property
    def is_defect(self) -> bool:
        return self.outcome in DEFECTS


def judge(kind, ended, changed, result, expected):
    """Judge one command.

    Parameters
    ----------
    kind : the kind of file (`kinds.Kind`).
    ended : how the command ended.
    changed : paths outside of what the command may write that it made, changed or removed; and paths that it
        may write but has left in a state that only a running command may leave.
    result, expected : what it printed and wrote, and what it does with the undamaged file.
    """
    said = f"exit code {ended.code}: {(ended.err or ended.out)[-600:]}"
    wrong = judge_end(ended)
    if wrong:
        return Verdict(wrong[0], f"{wrong[1]}; {said}")
    partial = sorted(path for path in changed if ".partial" in path)
    outside = sorted(changed - {*partial})
    if outside:
        return Verdict("touched", f"{', '.join(outside)}; {said}")
    if partial:
        return Verdict("left", f"{', '.join(partial)}; {said}")
    if ended.code in (1, 2):
        if not any(name in ended.err + ended.out for name in kind.names):
            return Verdict("unnamed", said)
        return Verdict("refused" if ended.code == 2 else "bad", said)
    if result == expected:
        return Verdict("same")
    if ended.after:
        return Verdict("believed", f"not finite: {', '.join(ended.after)}; {said}")
    different = sorted(name for name in {*result, *expected} if result.get(name) != expected.get(name))
    return Verdict("believed" if kind.vouched else "other", f"{', '.join(different)}; {said}")


def judge_end(ended):
    """(defect, detail) of how a command ended, whatever it was to do; None if there is none."""
    if ended.signal:
        return ("hung" if ended.signal == "hang" else "crashed"), ended.signal
    if ended.code not in (0, 1, 2) or "Traceback (most" in ended.err:
        return "traceback", ended.err[-1500:]
    if ended.peak_bytes > MEMORY_BYTES:
        return "hungry", f"{ended.peak_bytes / 2**20:.0f} MiB"
    unclear = _unclear(ended)
    return ("unclear", unclear) if unclear else None


def _unclear(ended):
    """Why the text of a command is not what a reader can use; None if it is."""
    text = ended.out + ended.err
    if not text.replace("\n", "").replace("\t", "").replace("\r", "").isprintable():
        return "control characters"
    if re.search(r"^\S*Warning: |: \w*Warning: |^HDF5-DIAG|^Exception ignored|^\*\*\* ", ended.err, re.M):
        return "a warning or the output of a library"
    sentences = re.split("^Error: ", ended.err, flags=re.M)[1:]
    if ended.code == 2 and len(sentences) != 1:
        return f"{len(sentences)} sentences"
    if ended.code == 2 and (len(ended.err) > LONGEST or len(sentences[0].strip().splitlines()) > 1):
        return f"a text of {len(ended.err)} characters"
    return None


def not_finite(patterns):
    """Files of the working directory that hold NaN or infinity; for `after` of `forked.Forks.start`."""
    files = [file for pattern in patterns for file in sorted(Path().glob(pattern))]
    files += [inner for folder in files if folder.is_dir() for inner in sorted(folder.rglob("*"))]
    return [str(file) for file in files if file.is_file() and not _is_finite(file)]


def _is_finite(file):
    import numpy as np
    import trimesh

    from itof import read_image

    if file.suffix == ".exr":
        return all(np.isfinite(values).all() for values in read_image(file).channels.values())
    if file.suffix == ".json":
        numbers = []
        json.loads(file.read_text(), parse_constant=numbers.append)
        return not numbers
    if file.suffix == ".csv":
        return not any(cell in ("nan", "inf", "-inf") for line in csv.reader(file.open()) for cell in line)
    if file.suffix == ".ply":
        return np.isfinite(trimesh.load(file).vertices).all()
    return True
