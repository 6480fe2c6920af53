"""The lock on a run folder: only one night-train works on it at a time."""

from __future__ import annotations

import fcntl
import os
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from disk import NightError
from disk.locks import is_same_file, lock, open_lock_file
from model.run_folder.run_config import RunError
from model.training.processes import ProcessError, Processes

LOCK_FILE: Final = ".training"
_MOST_ATTEMPTS: Final = 1000  # at a folder that others remove, or in which no file can be made
_OWNER: Final = re.compile(r"process [0-9]{1,20} on [A-Za-z0-9_.-]{1,255}")


@contextmanager
def only_training(out: Path, processes: Processes, check: Callable[[], None]) -> Iterator[None]:
    """Hold the lock of the run folder `out` while the block runs; all processes of one training share it.

    Parameters
    ----------
    check : called when the lock is held; refuses a folder that another training has used before.

    Raises
    ------
    RunError, or what `check` raises : another training holds the lock, or has used the folder.
    ProcessError : the first process of this training was refused.
    OSError : the folder or the lock file cannot be made.
    """
    with ExitStack() as held:
        refusal: NightError | OSError | None = None
        if processes.is_first:
            try:
                held.enter_context(_locked(out))
                check()
            except (NightError, OSError) as error:
                refusal = error
        if processes.any(refusal is not None):
            raise refusal or ProcessError("the first process of this training was refused: see its message")
        yield


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Hold the lock. At the end the lock file goes, and the folder if it was made here and is still empty."""
    is_new = not out.exists()
    descriptor = _taken(out)
    try:
        yield
    finally:
        (out / LOCK_FILE).unlink(missing_ok=True)
        os.close(descriptor)
        if is_new:
            with suppress(OSError):  # it holds a run
                out.rmdir()


def _taken(out: Path) -> int:
    """Descriptor of the locked file."""
    path = out / LOCK_FILE
    attempt = 0
    while True:
        out.mkdir(parents=True, exist_ok=True)
        attempt += 1
        try:
            descriptor = open_lock_file(path)
        except FileNotFoundError:
            if attempt == _MOST_ATTEMPTS:
                raise
            continue  # the last owner deleted the empty folder just now
        is_mine = lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if is_mine and is_same_file(descriptor, path):
            with suppress(OSError):  # a full disk; the name is only for the others' message
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
            return descriptor
        owner = _owner(descriptor)
        os.close(descriptor)
        if not is_mine:
            raise RunError(
                f"another night-train ({owner}) is training into {out}: wait until it ends, or choose "
                "another folder"
            )
        # Otherwise the last owner deleted the file after it was opened and before it was locked here.


def _owner(descriptor: int) -> str:
    """The process that holds the lock, as the file says."""
    text = os.pread(descriptor, 512, 0).decode(errors="replace")
    return text if _OWNER.fullmatch(text) else "of an unknown process"
