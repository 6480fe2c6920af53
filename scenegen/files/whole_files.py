"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOTDIR
from pathlib import Path

# .NAME.HOST-PID.partial is being written by process PID of machine HOST, .NAME.HOST-PID.old.partial is about
# to be deleted by it. Only its own machine can know whether a process is still alive.
HOST = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname())
_PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>\w+)-(?P<pid>\d+)(\.old)?\.partial")


@contextmanager
def whole_file(path: Path, *, sweep: bool = True) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success the file written there becomes `path`.

    The bytes are on disk (fsync) before the rename, so neither a killed process nor a power cut leaves
    half a file under the final name. On an error the temporary file is removed; what a killed process
    left is removed by the next one that writes `path`, unless `sweep` is off: looking for it reads the whole
    parent folder, which is needless for thousands of files inside a `whole_folder`.

    Raises
    ------
    OSError : the folder cannot be made, or the disk is full.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if sweep:
        remove_leftovers(path.parent, path.name)
    partial = _partial_name(path)
    try:
        yield partial
        _sync(partial)
        partial.replace(path)
        _sync(path.parent)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def whole_folder(path: Path, *, sweep: bool = True) -> Iterator[Path]:
    """Like `whole_file` for a folder and all in it; replaces an older folder of that name.

    Looking for what killed processes left reads all of the parent folder; whoever makes thousands of folders
    in one calls `remove_leftovers` once and then this with `sweep` off.

    Raises
    ------
    NotADirectoryError : `path` is a file.
    """
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    if sweep:
        remove_leftovers(path.parent, path.name)
    partial = _partial_name(path)
    old = partial.with_suffix(".old.partial")
    _remove(partial)  # of an earlier process with our id
    _remove(old)
    partial.mkdir()
    try:
        yield partial
        for entry in partial.rglob("*"):
            _sync(entry)
        _sync(partial)
        if path.exists():
            path.replace(old)  # a rename: no moment at which half of the old folder stands there
        partial.replace(path)
        _sync(path.parent)
    finally:
        if old.exists() and not path.exists():
            old.replace(path)
        _remove(partial)
        _remove(old)


def is_partial(name: str) -> bool:
    """Whether `name` is a temporary one of `whole_file` or `whole_folder`."""
    return _PARTIAL.fullmatch(name) is not None


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove what killed processes were writing in `folder`, of one final name or of all."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.endswith(".partial")]
    for partial in names:
        match = _PARTIAL.fullmatch(partial)
        ours = match is not None and name in (None, match["name"]) and match["host"] == HOST
        if match and ours and not _is_alive(int(match["pid"])):
            _remove(folder / partial)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _partial_name(path: Path) -> Path:
    return path.with_name(f".{path.name}.{HOST}-{os.getpid()}.partial")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)  # signal 0 only asks
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
