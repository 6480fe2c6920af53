"""Deletion of the transients of rendered scenes; their phasors and ground truth stay.

Only rendering makes transients again: phasors cannot be converted back (`render.products.conversion`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from disk import remove_leftovers, sha256_of
from itof import read_image
from render.farm.claims import joined_run, rendering_record_locked
from render.products.conversion import ExportError
from scenegen import IMAGE_FILES, TRANSIENT_FILES, Dataset, read_record, write_record, write_rendering_record


def transient_bytes(dataset: Dataset, scenes: Iterable[str]) -> int:
    """Bytes of the transients of several scenes, which `delete_transients` would free."""
    return sum(file.stat().st_size for scene_id in scenes for file in _transients(dataset, scene_id))


def delete_transients(
    dataset: Dataset, scenes: Iterable[str], on_scene: Callable[[], object] = lambda: None
) -> int:
    """Delete the transients of several scenes and keep phasors and ground truth (product ``itof``).

    First, the images of all these scenes are checked against their records. A scene's record is changed on
    disk before its transients are deleted: a kill can leave transients without a record, which the next call
    deletes, but not a record without its files. If these are all scenes of the dataset, ``rendering.json``
    gets the product ``itof`` before the first scene, so that the next run renders no transients again.

    Parameters
    ----------
    on_scene : called after the check of each scene.

    Returns
    -------
    Bytes freed; a scene without transients counts 0.

    Raises
    ------
    ExportError : a scene is not rendered, or its images are damaged; then nothing is deleted.
    OtherRunError : a run of ``night-render`` renders the dataset now.
    """
    wanted = list(scenes)
    bare = [scene_id for scene_id in wanted if read_record(dataset.render_folder(scene_id)) is None]
    if bare:
        raise ExportError(
            f"{len(bare)} of {len(wanted)} scenes, first {bare[0]}, are not rendered: no transients were "
            "deleted"
        )
    with joined_run(dataset.renders, "drop-transients"):
        for scene_id in wanted:
            _refuse_without_images(dataset, scene_id)
            on_scene()
        with rendering_record_locked(dataset.renders):
            rendering = dataset.rendering
            if rendering is not None and set(wanted) == set(dataset.ids()):
                write_rendering_record(dataset.renders, replace(rendering, product="itof"))
        return sum(_delete(dataset, scene_id) for scene_id in wanted)


def _refuse_without_images(dataset: Dataset, scene_id: str) -> None:
    """Refuse a scene whose phasors and ground truth are not there as they were rendered."""
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    for name in IMAGE_FILES:
        file = folder / name
        expected = record.files.get(name) if record else None
        if expected is None or not file.is_file() or sha256_of(file) != expected.sha256:
            problem = "is missing or not what was rendered"
        elif not all(np.isfinite(values).all() for values in read_image(file).channels.values()):
            problem = "holds NaN or infinity"
        else:
            continue
        raise ExportError(
            f"scene {scene_id}: {name} {problem}, so no transients were deleted: render the scene again"
        )


def _delete(dataset: Dataset, scene_id: str) -> int:
    """Delete the transients of a scene and return their size."""
    folder = dataset.render_folder(scene_id)
    remove_leftovers(folder)
    record, files = read_record(folder), _transients(dataset, scene_id)
    if record is None:  # somebody deleted it just now
        return 0
    kept = {name: entry for name, entry in record.files.items() if name not in TRANSIENT_FILES}
    if kept != record.files:
        write_record(folder, replace(record, files=kept))
    freed = sum(file.stat().st_size for file in files)
    for file in files:
        file.unlink()
    return freed


def _transients(dataset: Dataset, scene_id: str) -> list[Path]:
    folder = dataset.render_folder(scene_id)
    return [folder / name for name in TRANSIENT_FILES if (folder / name).is_file()]
