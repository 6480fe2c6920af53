"""Files and folders that appear complete or not at all."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from errno import EACCES, EBUSY, EDQUOT, EEXIST, EFBIG, EIO, EISDIR, ENOSPC, ENOTDIR, ENOTEMPTY, EROFS
from pathlib import Path

from disk.exchange import exchange
from disk.partials import older, partial_folder, remove_leftovers
from disk.path_like import PathLike

_WRITE_ERRORS = frozenset({ENOSPC, EDQUOT, EFBIG, EIO, EROFS})  # without a name when a write raises them
_OCCUPIED = frozenset({ENOTEMPTY, EEXIST, ENOTDIR})  # what renaming to a name in use raises
TOGETHER = "files"  # name of temporary folders whose files belong together
_ATTEMPTS = 100  # at a name that other processes keep taking
_MOST_UNWRITTEN = 2**16  # bytes that a library writes only when it closes a file, and more


@contextmanager
def whole_file(path: PathLike, *, sweep: bool = True) -> Iterator[Path]:
    """Yield a temporary path; on success, the file written there is renamed to `path`.

    The bytes are on disk (fsync) before the rename. Neither a killed process nor a power failure therefore
    leaves an incomplete file at `path`. On an error, the temporary file is removed. The file gets the
    permissions that the umask allows, whatever program wrote it. A link at `path` is replaced, not followed.

    Parameters
    ----------
    path : final path; missing parent folders are made.
    sweep : remove the temporary files that killed processes have left for this path. This lists the whole
        parent folder, which takes time and is not needed for many files inside a `whole_folder`.

    Raises
    ------
    IsADirectoryError : `path` is a folder.
    OSError : the folder cannot be made or written to, or the disk is full; the error names the file.
    """
    final = _with_name(path)
    if final.is_dir() and not final.is_symlink():
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(final))
    make_folder(final.parent)
    if sweep:
        remove_leftovers(final.parent, final.name)
    with partial_folder(final) as folder, _naming(final, folder):
        partial = folder / final.name
        yield partial
        _allow_what_umask_allows(partial)
        sync(partial)
        partial.replace(final)
        sync(final.parent)


@contextmanager
def whole_folder(path: PathLike, *, sweep: bool = True) -> Iterator[Path]:
    """As `whole_file`, for a folder with all its files; it replaces an older folder at `path`.

    The old and the new folder are exchanged in one step, so that readers find one of them at any moment.
    Where the file system cannot do this, the old folder is renamed first. If the process is killed between
    the two steps, the next `remove_leftovers` for this path, as at the start of this function, puts the old
    folder back.

    Parameters
    ----------
    path : final path; missing parent folders are made.
    sweep : remove what killed processes have left for this path. This lists the whole parent folder; code
        that makes thousands of folders calls `remove_leftovers` once and passes False here.

    Raises
    ------
    NotADirectoryError : `path` is a file.
    PermissionError : the older folder must not be changed.
    OSError : a folder cannot be made or replaced, or the disk is full; the error names the file.
    """
    final = _with_name(path)
    _refuse_irreplaceable(final)
    make_folder(final.parent)
    if sweep:
        remove_leftovers(final.parent, final.name)
    with partial_folder(final) as folder, _naming(final, folder):
        new = folder / final.name
        new.mkdir()
        yield new
        for entry in new.rglob("*"):
            if not entry.is_symlink():
                sync(entry)
        sync(new)
        _put_in_place(new, final)
        sync(final.parent)


@contextmanager
def whole_files(path: PathLike, before: Callable[[], None] = lambda: None) -> Iterator[Path]:
    """Yield a temporary folder; on success, its files are moved to the folder `path`, one after the other.

    Other files in `path` stay. On an error while they are written, no file there has changed. Files are
    written with `whole_file`.

    Parameters
    ----------
    path : the folder, which is made if it is missing.
    before : called when all files are written, before the first one is moved.
    """
    final = _with_name(path)
    make_folder(final)
    remove_leftovers(final, TOGETHER)
    with partial_folder(final / TOGETHER) as folder:
        try:
            yield folder
        except OSError as error:
            if not _lies_in(error.filename, folder):
                raise
            inner = Path(str(error.filename)).relative_to(folder)
            raise OSError(error.errno, error.strerror, str(final / inner)) from error
        files = sorted(folder.iterdir())
        for place in (final / file.name for file in files):
            if place.is_dir() and not place.is_symlink():
                raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(place))
        before()
        for file in files:
            if file.exists():  # `before` may have moved it
                file.replace(final / file.name)
        sync(final)


def write_text(path: PathLike, text: str) -> None:
    """Write a UTF-8 text file, complete or not at all.

    Bytes that are not UTF-8, which Python keeps in names of files, are written as escapes.
    """
    with whole_file(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="backslashreplace")


def _with_name(path: PathLike) -> Path:
    """`path` in a form whose last part is a name."""
    given = Path(path)
    return given if given.name not in ("", "..") else given.resolve()


def _refuse_irreplaceable(path: Path) -> None:
    """Refuse, before any work, a path that no folder can take."""
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(path))
    if os.path.ismount(path):
        raise OSError(EBUSY, "this folder is a mount point: choose a folder inside it", str(path))
    if path.is_dir() and not path.is_symlink() and not os.access(path, os.W_OK):
        raise PermissionError(EACCES, os.strerror(EACCES), str(path))


def make_folder(folder: Path) -> None:
    """Make a folder and its missing parents, so that they also survive a power failure."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(ENOTDIR, os.strerror(ENOTDIR), str(folder)) from None
    for made in reversed(missing):
        sync(made.parent)


@contextmanager
def _naming(path: Path, folder: Path) -> Iterator[None]:
    """Give errors of the temporary files in `folder`, and of a full disk, the name of the final file."""
    try:
        yield
    except OSError as error:
        nameless = error.filename is None and error.errno in _WRITE_ERRORS
        if not nameless and not _lies_in(error.filename, folder):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def _lies_in(name: object, folder: Path) -> bool:
    return isinstance(name, (str, os.PathLike)) and Path(name).is_relative_to(folder)


def _put_in_place(new: Path, path: Path) -> None:
    """Rename the folder `new` to `path`; what was there is then in the temporary folder."""
    old = older(new.parent, path)
    for attempt in range(_ATTEMPTS):
        try:
            if exchange(new, path):
                return
            shutil.rmtree(old, ignore_errors=True)  # of an earlier attempt: the one at `path` is newer
            path.rename(old)  # deleting in place would leave a part of the folder for a moment
        except FileNotFoundError:
            pass  # there is none to replace
        try:
            new.rename(path)
        except OSError as error:
            if error.errno not in _OCCUPIED or attempt == _ATTEMPTS - 1:
                raise
        else:
            return


def _allow_what_umask_allows(file: Path) -> None:
    """Libraries that write to a temporary file of their own leave one that only the owner can read."""
    wanted = stat.S_IMODE(file.parent.stat().st_mode) & 0o666  # the folder was made with the umask
    mode = stat.S_IMODE(file.stat().st_mode)
    if wanted & ~mode:
        with suppress(PermissionError):  # a file system without permissions
            file.chmod(mode | wanted)


def sync(path: Path) -> None:
    """Wait until the bytes of a file, or the names in a folder, are on disk; errors have its name."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        os.close(descriptor)


def errno_of_writing(path: Path) -> int:
    """Why a file could not be written: the error of writing more to it, or EIO if there is none."""
    try:
        with path.open("ab") as stream:
            stream.write(bytes(_MOST_UNWRITTEN))
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        return error.errno or EIO
    return EIO
