"""Paths that are put together from text of a file: they must lie inside the folder that they belong to."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from disk.night_error import NightError
from disk.path_like import PathLike


class OutsideError(NightError):
    """A path that leads out of its folder: by its text, or through a symbolic link."""


def inside(root: PathLike, *parts: str) -> Path:
    """`root` joined with `parts`, after a check that the result lies inside `root`.

    Every path of which a part comes from the contents of a file goes through this function. Only the part
    below `root` is checked: `root` itself may be, or lie behind, a symbolic link. A symbolic link below
    `root` is followed, and is allowed where it ends inside `root`. Files and folders need not exist.

    Parameters
    ----------
    root : the folder.
    parts : relative paths with ``/`` between folders.

    Returns
    -------
    The joined path; symbolic links in it are not replaced by their targets.

    Raises
    ------
    OutsideError : a part is empty, absolute, or contains ``..`` or a NUL, or a symbolic link leads out of
        `root`.
    """
    root = Path(root)
    names = [name for part in parts for name in _names(root, part)]
    if not names:
        raise OutsideError(f"a name in {root} is empty: correct the file that names it")
    path, place = root.joinpath(*names), str(root)
    for name in names:  # one call of the system for each: a dataset has 100,000 folders
        place = f"{place}/{name}"
        if not _is_link(place):
            continue
        real, real_root = os.path.realpath(path), os.path.realpath(root)
        if real != real_root and os.path.commonpath([real, real_root]) == real_root:
            return path
        raise OutsideError(
            f"{place} is a symbolic link to a place outside {root}: replace the link by the files themselves"
        )
    return path


def _names(root: Path, part: str) -> list[str]:
    """The folder and file names of a relative path; ``.`` is left out."""
    names = [name for name in part.split("/") if name not in ("", ".")]
    if names and ".." not in names and not part.startswith("/") and _is_writable(part):
        return names
    raise OutsideError(
        f"{part!r} is not the name of a file inside {root}: correct the file that names it; "
        "absolute paths and '..' are not allowed"
    )


def _is_writable(part: str) -> bool:
    """Whether the file system can have such a name: it has no NUL, and no half of a character."""
    try:
        return b"\0" not in os.fsencode(part)
    except UnicodeEncodeError:
        return False


def _is_link(place: str) -> bool:
    try:
        return stat.S_ISLNK(os.lstat(place).st_mode)
    except OSError:  # it does not exist; what cannot be reached cannot lead outside either
        return False
