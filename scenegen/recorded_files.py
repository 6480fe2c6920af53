"""Rendered files, compared with the record of their render before anything parses them.

``render.json`` has the size and the SHA-256 of every file. A file that differs from them was damaged or
exchanged. No image library may see such a file: libraries crash on damaged files, or read wrong numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from disk.inner_paths import inside
from disk.night_error import NightError
from scenegen.dataset import Dataset
from scenegen.render_folder import RECORD_FILE, difference, read_record

RENDER_AGAIN: Final = "delete it and render it again"  # what to do with a recorded file that cannot be read


class RenderFileError(NightError):
    """A rendered file is missing, or is not the one that ``night-render`` wrote."""


def is_recorded(dataset: Dataset, scene: str) -> bool:
    """Whether a scene has a record, or is in a dataset whose measurements come from another program."""
    return read_record(dataset.render_folder(scene)) is not None or dataset.rendering is None


def recorded_file(dataset: Dataset, scene: str, name: str) -> Path:
    """Path of a file of a scene's render, after its bytes have been compared with the record.

    The file is hashed at every call; no earlier hash is trusted. Where ``night-render`` has never rendered
    the dataset, a scene may have files without a record: measurements from another program. They pass.

    Parameters
    ----------
    name : name of the file, one of those in `scenegen.render_folder`.

    Raises
    ------
    RenderFileError : the scene has no record, or the file is missing or differs from its record.
    """
    folder = dataset.render_folder(scene)
    file = inside(folder, name)
    record = read_record(folder)
    if record is None and dataset.rendering is None:
        return file
    if record is None:
        raise RenderFileError(
            f"scene {scene}: its renders are unfinished or were found damaged (there is no usable "
            f"{RECORD_FILE} in {folder}): run night-render {dataset.root} again"
        )
    if name not in record.files:
        raise RenderFileError(
            f"scene {scene}: {file} is not among the files that {RECORD_FILE} names: "
            f"run night-render {dataset.root}, which renders it again"
        )
    if difference(file, record.files[name]):
        raise changed_file(dataset, scene, file)
    return file


def changed_file(dataset: Dataset, scene: str, file: Path) -> RenderFileError:
    """The error about a file that differs from its record."""
    return RenderFileError(
        f"scene {scene}: {file} is not the file that night-render wrote (its SHA-256 differs from the one in "
        f"{RECORD_FILE}): run night-render {dataset.root}, which renders it again"
    )
