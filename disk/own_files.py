"""Outputs that are replaced as a whole: folders may hold nothing but what the program wrote there."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path

from disk.file_hashes import sha256_of
from disk.night_error import NightError
from disk.partials import remove_leftovers
from disk.path_like import PathLike

_NAMED = 3  # files that a refusal names


def hashes_of(folder: Path) -> dict[str, str]:
    """SHA-256 of every file in a folder, by its path within the folder, in order of these paths."""
    files = {file.relative_to(folder).as_posix(): file for file in folder.rglob("*") if file.is_file()}
    return {name: sha256_of(files[name]) for name in sorted(files)}


def refuse_taken(out: PathLike, *, replacing: bool) -> None:
    """Refuse to write a file where there is something, unless that is to be replaced.

    Raises
    ------
    NightError : there is something at `out`.
    """
    path = Path(out)
    if (path.exists() or path.is_symlink()) and not replacing:
        raise NightError(f"{path} exists already: give another name to --out, or --replace")


def refuse_other_files(
    out: Path, written: Callable[[Path], Mapping[str, str | None]], what: str, error: type[NightError]
) -> None:
    """Refuse an output folder that holds anything but an earlier `what`, before it is replaced.

    If a process was killed while it replaced the folder, the folder is first put back.

    Parameters
    ----------
    written : function of the folder that returns the files of an earlier `what`: SHA-256 by path within the
        folder, None for a file whose contents are unknown. A folder is named with a slash at its end.
    what : name of the contents, for the message.

    Raises
    ------
    error : `out` is a file, or holds a file that is not `written` or was changed; the message names it.
    OSError : a folder or file in it cannot be read.
    """
    if out.parent.is_dir():
        remove_leftovers(out.parent, out.name)
    if not out.exists():
        return
    if not out.is_dir():
        raise error(f"{out} is a file: give the {what} a folder of its own")
    found = list(islice(other_files(out, written(out)), _NAMED + 1))
    if found:
        names = ", ".join(found[:_NAMED]) + (" and more" if len(found) > _NAMED else "")
        raise error(
            f"{out} holds other things than an earlier {what}: {names}; move them elsewhere, or choose "
            "another folder"
        )


def other_files(root: Path, written: Mapping[str, str | None]) -> Iterator[str]:
    """Yield the files and folders in `root` that are not `written`, and the files that have changed.

    A folder that is not `written` is yielded with a slash at its end, and not searched. Links are never
    `written`.

    Parameters
    ----------
    written : as that function of `refuse_other_files` returns it.
    """
    folders = {f"{parent.as_posix()}/" for name in written for parent in Path(name).parents}
    folders |= {name for name in written if name.endswith("/")}
    for place, below, files in os.walk(root, onerror=_raise):
        prefix = "" if place == str(root) else f"{Path(place).relative_to(root).as_posix()}/"
        for name in sorted(files):
            if f"{prefix}{name}" not in written:
                yield f"{prefix}{name}"
            elif _is_changed(Path(place, name), written[f"{prefix}{name}"]):
                yield f"{prefix}{name} (changed)"
        for name in sorted(below):
            if f"{prefix}{name}/" not in folders or Path(place, name).is_symlink():
                below.remove(name)  # it is named as a whole
                yield f"{prefix}{name}/"
        below.sort()


def _raise(error: OSError) -> None:
    raise error


def _is_changed(file: Path, sha256: str | None) -> bool:
    if file.is_symlink() or not file.is_file():
        return True
    return sha256 is not None and sha256_of(file) != sha256
