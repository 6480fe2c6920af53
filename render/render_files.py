"""The folder of a scene's render: what an earlier render has left there, and the record of a new one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import remove_leftovers, sha256_of
from itof.exr.image import image_bytes
from render.settings import RenderError
from scenegen import (
    IMAGE_FILES,
    MEASUREMENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILES,
    FileRecord,
    RenderRecord,
    forget_bad_render,
    read_record,
    remove_failure,
)
from scenegen.render_folder import difference


def begin(folder: Path, recipe: str, *, keeps_transients: bool) -> Callable[[], None]:
    """Make a folder ready for a render with a recipe.

    An earlier render with another recipe, or a damaged one, is forgotten at once.

    Returns
    -------
    What forgets the earlier render: to be called when all new files are written, before one gets its name.
    It deletes the record, and all transients but those that are kept: intact ones recorded for `recipe`.
    """
    earlier = read_record(folder) if folder.is_dir() else None
    forget = partial(_forget, folder, earlier, recipe if keeps_transients else "")
    if not folder.is_dir():
        return forget
    if earlier is None or earlier.recipe != recipe or _is_damaged(folder, earlier):
        forget()
    remove_leftovers(folder)  # of any file: the folder is ours
    remove_failure(folder)
    return forget


def image_file(
    name: str, channels: Mapping[str, NDArray[np.float32]], attributes: Mapping[str, str]
) -> bytes:
    """The contents of the image `name`.

    Phasors are not packed: that saves 2 % of the file, for most of the time of writing.

    Raises
    ------
    RenderError : a pixel is NaN or infinite.
    """
    if not all(np.isfinite(values).all() for values in channels.values()):
        raise RenderError(
            f"scene {attributes['scene_id']}: {name} has NaN or infinite pixels: it was not written"
        )
    return image_bytes(channels, attributes, packed=name != MEASUREMENT_FILE)


def record_of(attributes: Mapping[str, str], files: Mapping[str, Path | bytes]) -> RenderRecord:
    """The record of files, given by place or contents; the recipe is one of their attributes."""
    return RenderRecord(
        recipe=attributes["recipe"],
        attributes={name: text for name, text in attributes.items() if name != "recipe"},
        files={name: _described(file) for name, file in files.items()},
    )


def finish(folder: Path, record: RenderRecord) -> RenderRecord:
    """Remove what says that the scene could not be rendered, or that another render of it was bad."""
    remove_failure(folder)  # another command may have given the scene up meanwhile
    forget_bad_render(folder, record)
    return record


def _described(file: Path | bytes) -> FileRecord:
    if isinstance(file, bytes):
        return FileRecord(bytes=len(file), sha256=hashlib.sha256(file).hexdigest())
    return FileRecord(bytes=file.stat().st_size, sha256=sha256_of(file))


def _forget(folder: Path, record: RenderRecord | None, recipe: str) -> None:
    kept = record.files if record is not None and record.recipe == recipe else {}
    (folder / RECORD_FILE).unlink(missing_ok=True)
    for name in TRANSIENT_FILES:
        file = folder / name
        if file.is_file() and (name not in kept or sha256_of(file) != kept[name].sha256):
            file.unlink()


def _is_damaged(folder: Path, record: RenderRecord) -> bool:
    images = {name: record.files[name] for name in IMAGE_FILES if name in record.files}
    return any(difference(folder / name, expected) for name, expected in images.items())
