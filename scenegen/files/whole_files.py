"""Files and folders that appear complete or not at all."""

from __future__ import annotations

import os
import re
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from errno import ENOTDIR
from pathlib import Path

# Process PID of machine HOST writes .NAME.HOST-PID.partial and deletes .NAME.HOST-PID.old.partial. Only its
# own machine can tell whether the process is still alive.
HOST = re.sub(r"[^A-Za-z0-9]+", "_", socket.gethostname())
_PARTIAL = re.compile(r"\.(?P<name>.+)\.(?P<host>\w+)-(?P<pid>\d+)(\.old)?\.partial")


@contextmanager
def whole_file(path: Path, *, sweep: bool = True) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success, the file written there is renamed to `path`.

    The bytes are on disk (fsync) before the rename. Neither a killed process nor a power failure therefore
    leaves an incomplete file at `path`. On an error, the temporary file is removed.

    Parameters
    ----------
    path : final path; missing parent folders are made.
    sweep : remove the temporary files that killed processes have left for this path. This lists the whole
        parent folder, which takes time and is not needed for many files inside a `whole_folder`.

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
    """As `whole_file`, for a folder with all its files; it replaces an older folder at `path`.

    Parameters
    ----------
    path : final path; missing parent folders are made.
    sweep : remove what killed processes have left for this path. This lists the whole parent folder; code
        that makes thousands of folders calls `remove_leftovers` once and passes False here.

    Raises
    ------
    NotADirectoryError : `path` is a file.
    OSError : a folder cannot be made, or the disk is full.
    """
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    if sweep:
        remove_leftovers(path.parent, path.name)
    partial = _partial_name(path)
    old = partial.with_suffix(".old.partial")
    _remove(partial)  # left by an earlier process with the same id
    _remove(old)
    partial.mkdir()
    try:
        yield partial
        for entry in partial.rglob("*"):
            _sync(entry)
        _sync(partial)
        if path.exists():
            path.replace(old)  # a rename: deleting in place would leave a part of the folder for a moment
        partial.replace(path)
        _sync(path.parent)
    finally:
        if old.exists() and not path.exists():
            old.replace(path)
        _remove(partial)
        _remove(old)


def is_partial(name: str) -> bool:
    """Whether `name` is a temporary name of `whole_file` or `whole_folder`."""
    return _PARTIAL.fullmatch(name) is not None


def remove_leftovers(folder: Path, name: str | None = None) -> None:
    """Remove the temporary files of killed processes in `folder`, for the final name `name` or for all."""
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries if entry.name.endswith(".partial")]
    for partial in names:
        match = _PARTIAL.fullmatch(partial)
        ours = match is not None and name in (None, match["name"]) and match["host"] == HOST
        if match and ours and not _is_alive(int(match["pid"])):
            _remove(folder / partial)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file, complete or not at all."""
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
        os.kill(pid, 0)  # signal 0 does nothing but check whether the process exists
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
