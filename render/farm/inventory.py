"""Which scenes of a dataset are rendered. The files decide, not the memory of a scheduler."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

from disk import FileHashes
from render.edited_scenes import is_edited, known_digest
from render.settings import RenderSettings, satisfies
from scenegen import Dataset, FileRecord, RenderRecord, read_failure, read_record

# done: all files are there, intact, and have this recipe. failed: rendering with this recipe failed. other:
# rendered with another recipe. damaged: files are gone or differ from the record. missing: everything else.
State = Literal["done", "failed", "other", "damaged", "missing"]
_READERS = 8  # threads that read files at the same time; network disks answer slowly


def known_recipe(dataset: Dataset, settings: RenderSettings, scene_id: str) -> str:
    """Recipe of a scene; empty if its folder is missing or unreadable, which rendering then reports."""
    digest = known_digest(dataset, scene_id)
    return settings.recipe(dataset, digest) if digest else ""


class Inventory:
    """States of the scenes of a dataset for some settings.

    Hashes of files are cached in ``renders/.hashes.json``, with size and time of change; `save` writes them.

    Attributes
    ----------
    edited : scenes, among those whose state was asked for, whose files are not those of ``dataset.json``.
    """

    def __init__(self, dataset: Dataset, settings: RenderSettings) -> None:
        self.dataset = dataset
        self.settings = settings
        self.edited: set[str] = set()
        self._hashes = FileHashes(dataset.renders)

    def state(self, scene_id: str) -> State:
        """State of one scene."""
        digest = known_digest(self.dataset, scene_id)
        if is_edited(self.dataset, scene_id, digest):
            self.edited.add(scene_id)
        recipe = self.settings.recipe(self.dataset, digest) if digest else ""
        state = self._recorded_state(scene_id, recipe)
        if state != "done":
            failure = read_failure(self.dataset.render_folder(scene_id))
            if failure is not None and failure.recipe == recipe:
                return "failed"
        return state

    def remember(self, scene_id: str, record: RenderRecord) -> None:
        """Add the hashes of a scene's files to the cache, from a record that has just been written."""
        folder = self.dataset.render_folder(scene_id)
        for name, file in record.files.items():
            self._hashes.learn(folder / name, file.sha256)

    def save(self) -> None:
        """Write the cached hashes to disk."""
        self._hashes.save()

    def _recorded_state(self, scene_id: str, recipe: str) -> State:
        folder = self.dataset.render_folder(scene_id)
        record = read_record(folder)
        if record is None:
            return "missing"
        if not satisfies(record.recipe, recipe):
            return "other"
        if not set(self.settings.files) <= set(record.files):
            return "missing"  # rendered to a smaller product
        try:
            whole = all(self._is_recorded(folder / name, expected) for name, expected in record.files.items())
        except OSError:
            whole = False
        return "done" if whole else "damaged"

    def _is_recorded(self, file: Path, expected: FileRecord) -> bool:
        found = file.stat()
        is_alike = stat.S_ISREG(found.st_mode) and found.st_size == expected.bytes
        return is_alike and self._hashes.sha256(file) == expected.sha256

    def states(
        self, scenes: Iterable[str], on_scene: Callable[[], object] = lambda: None
    ) -> dict[str, State]:
        """States of many scenes, in their order; calls `on_scene` after each."""
        found: dict[str, State] = {}
        wanted = list(scenes)
        try:
            with ThreadPoolExecutor(_READERS) as pool:
                for scene_id, state in zip(wanted, pool.map(self.state, wanted), strict=True):
                    found[scene_id] = state
                    on_scene()
        finally:
            self.save()
        return found
