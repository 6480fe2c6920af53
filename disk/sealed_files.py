"""Files of many folders, each set whole or absent, that wait for the disk together."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from errno import EISDIR
from pathlib import Path

from disk.partials import partial_folder, remove_leftovers
from disk.whole_writing import TOGETHER, make_folder, sync

_AT_ONCE = 64  # sets that wait for the disk together


@dataclass(frozen=True)
class SealedFiles:
    """Files of a folder, and a seal: one that appears last and says that the others are there.

    Attributes
    ----------
    folder : made if it is missing; other files in it stay.
    files : contents by name.
    seal : name and contents.
    before : called when all files are written, before the first one gets its name. It removes an older seal.
    """

    folder: Path
    files: Mapping[str, bytes]
    seal: tuple[str, bytes]
    before: Callable[[], None]


def write_sealed(sets: Sequence[SealedFiles]) -> list[OSError | None]:
    """Write sets of files, each in a folder of its own; returns the error of each, None where all is well.

    All bytes and names of a set are on disk before its seal gets its name. So neither a killed process nor a
    power failure leaves a seal without whole files. The files are written in a temporary folder beside the
    first of the folders; the sets wait for the disk side by side, and it writes its journal for all at once.
    """
    errors: list[OSError | None] = [_made(each.folder) for each in sets]
    good = [number for number, error in enumerate(errors) if error is None]
    if not good:
        return errors
    beside = sets[good[0]].folder.parent
    try:
        for parent in {sets[number].folder.parent for number in good}:
            sync(parent)
        remove_leftovers(beside, TOGETHER)
        with partial_folder(beside / TOGETHER) as stage, ThreadPoolExecutor(min(_AT_ONCE, len(good))) as pool:
            places = [stage / str(number) for number in good]
            found = pool.map(_written, [sets[number] for number in good], places)
            for number, error in zip(good, found, strict=True):
                errors[number] = error
    except OSError as error:  # of the temporary folder: nothing can be written
        return [each or error for each in errors]
    return errors


def _made(folder: Path) -> OSError | None:
    try:
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
    except OSError as error:
        return error
    return None


def _written(files: SealedFiles, stage: Path) -> OSError | None:
    """Write one set; its temporary files are at `stage` with other endings."""
    name = files.seal[0]
    partials = {each: stage.with_name(f"{stage.name}.{each}") for each in (*files.files, name)}
    try:
        for each, content in (*files.files.items(), files.seal):
            _write(partials[each], content, files.folder / each)
        files.before()
        for each in files.files:
            _rename(partials[each], files.folder / each)
        sync(files.folder)
        _rename(partials[name], files.folder / name)
        sync(files.folder)
    except OSError as error:
        return error
    return None


def _rename(partial: Path, final: Path) -> None:
    """Give a file its name; errors have that name, too."""
    try:
        partial.replace(final)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(final)) from error


def _write(partial: Path, content: bytes, final: Path) -> None:
    """Write a new file to disk; errors have the name of the `final` one."""
    if final.is_dir() and not final.is_symlink():
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR), str(final))
    try:
        with partial.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(final)) from error
