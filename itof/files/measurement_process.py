"""Reads the arrays of a user's measurement file in a process of its own.

The file can be damaged or made to do harm. The libraries that read it are C and C++ programs: they can crash,
run for ever or take all memory. In a process of its own, which has limits, that is an error of one sentence.
The process gets no plugins of HDF5, and it does not look for modules in the current folder. It sends plain
bytes, no Python objects.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, PIPE, Popen
from typing import IO, Final

import numpy as np

from itof.arrays import Numbers
from itof.binary_fields import BinaryLayout
from itof.files.array_claims import ARRAYS, Claims, RefusedError

_MOST_HEAD_BYTES = 16 * 2**20
_MOST_NAMES = 100
_PROGRAM = (
    "import sys; sys.path.append(sys.argv.pop(1)); from itof.files.measurement_child import main; main()"
)
_ENVIRONMENT: Final = {
    "HDF5_PLUGIN_PRELOAD": "::",  # HDF5's own word for: load no plugin
    "OPENBLAS_NUM_THREADS": "1",  # its threads would cost time and memory for nothing
}


@dataclass(frozen=True)
class FileContents:
    """Arrays of a measurement file by name, and the names of all that it has."""

    arrays: dict[str, Numbers]
    names: list[str]


def read_contents(
    path: Path, wanted: tuple[str, ...] = ARRAYS, layout: BinaryLayout | None = None, *, taken: int = 0
) -> FileContents:
    """The arrays of a measurement file, as they are in the file.

    Parameters
    ----------
    wanted : names of the arrays to read; channels of an ``.exr``. Those that the file lacks are left out.
    layout : of a file of bare numbers; by default the ending says how to read it.
    taken : bytes of arrays of other files that are in memory already.

    Raises
    ------
    RefusedError : the file cannot be read; the message is one sentence that names it.
    """
    root = str(Path(__file__).parents[2])  # where this program is, for the case that it is not installed
    command = [sys.executable, "-P", "-c", _PROGRAM, root, os.fspath(path), json.dumps(layout), *wanted]
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HDF5_PLUGIN")}
    stderr = None if os.environ.get("NIGHT_TRACEBACK") else DEVNULL
    with Popen(command, stdin=DEVNULL, stdout=PIPE, stderr=stderr, env=kept | _ENVIRONMENT) as child:  # noqa: S603
        try:
            contents = _received(Claims(path, taken), child.stdout)  # type: ignore[arg-type]
        except BaseException:
            child.kill()
            raise
    if contents is None or child.returncode != 0:
        raise RefusedError(f"{path} cannot be read: {_why_ended(child.returncode)}")
    return contents


def _received(claims: Claims, stream: IO[bytes]) -> FileContents | None:
    """What the process sends; None if it ended before it had sent everything."""
    line = stream.readline(_MOST_HEAD_BYTES)
    if not line.endswith(b"\n"):
        return None
    head = json.loads(line)
    if "refusal" in head:
        raise RefusedError(_plain(head["refusal"], 5000))
    arrays = {}
    for name, kind, shape in head["arrays"]:
        dtype = np.dtype(kind)
        claims.add(name, dtype, tuple(shape), math.prod(shape) * dtype.itemsize)
        arrays[name] = np.empty(shape, dtype)
        if not _fill(arrays[name].reshape(-1).view(np.uint8).data, stream):
            return None
    return FileContents(arrays, [_plain(name, 100) for name in head["names"][:_MOST_NAMES]])


def _fill(target: memoryview, stream: IO[bytes]) -> bool:
    while len(target):
        count = stream.readinto(target)  # type: ignore[attr-defined]
        if not count:
            return False
        target = target[count:]
    return True


def _why_ended(code: int) -> str:
    """What the end of the process says about the file."""
    again = "write it again with the program that made it"
    if code == -signal.SIGKILL:
        return "the process that read it was killed, perhaps because memory ran out; write smaller files"
    if code == -signal.SIGXCPU:
        return f"it cannot be read in reasonable time, so it is damaged; {again}"
    if code < 0:
        name = signal.Signals(-code).name
        return f"the library that reads such files crashed on it ({name}), so it is damaged; {again}"
    return f"the process that read it ended with exit code {code}; NIGHT_TRACEBACK=1 shows why"


def _plain(text: str, longest: int) -> str:
    """Text from a file, on one line, without characters that cannot be printed, and not longer than this."""
    line = " ".join(str(text).split())
    line = line if len(line) <= longest else line[:longest] + "…"
    return "".join(letter if letter.isprintable() else "?" for letter in line)
