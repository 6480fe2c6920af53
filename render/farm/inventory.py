"""What of a dataset is rendered: read from the files alone, never from a scheduler's memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

from render.settings import RenderError, RenderSettings
from scenegen import Dataset, FileHashes, RenderRecord, read_failure, read_record

# done: all files whole, of this recipe. failed: tried with this recipe in vain. other: rendered with other
# settings. damaged: recorded, but files are gone or not what was recorded. missing: none of these.
State = Literal["done", "failed", "other", "damaged", "missing"]
_READERS = 8  # threads that read files at once, for disks across a network


def known_recipe(dataset: Dataset, settings: RenderSettings, scene_id: str) -> str:
    """Recipe of a scene; empty when its description is gone, of which rendering it will tell."""
    try:
        return settings.recipe(dataset, scene_id)
    except (OSError, RenderError):
        return ""


class Inventory:
    """States of scenes under some settings.

    Hashes are remembered in ``renders/.hashes.json`` by size and time of change; `save` keeps them.
    """

    def __init__(self, dataset: Dataset, settings: RenderSettings) -> None:
        self.dataset = dataset
        self.settings = settings
        self._hashes = FileHashes(dataset.renders)

    def state(self, scene_id: str) -> State:
        """State of one scene."""
        recipe = known_recipe(self.dataset, self.settings, scene_id)
        state = self._recorded_state(scene_id, recipe)
        if state != "done":
            failure = read_failure(self.dataset.render_folder(scene_id))
            if failure is not None and failure.recipe == recipe:
                return "failed"
        return state

    def remember(self, scene_id: str, record: RenderRecord) -> None:
        """Take the hashes of a scene's files from its record, which was written just now."""
        folder = self.dataset.render_folder(scene_id)
        for name, file in record.files.items():
            self._hashes.learn(folder / name, file.sha256)

    def save(self) -> None:
        """Keep the hashes on disk."""
        self._hashes.save()

    def _recorded_state(self, scene_id: str, recipe: str) -> State:
        folder = self.dataset.render_folder(scene_id)
        record = read_record(folder)
        if record is None:
            return "missing"
        if record.recipe != recipe:
            return "other"
        if not set(self.settings.files) <= set(record.files):
            return "missing"  # rendered to a smaller product
        try:
            whole = all(
                (folder / name).stat().st_size == expected.bytes
                and self._hashes.sha256(folder / name) == expected.sha256
                for name, expected in record.files.items()
            )
        except OSError:
            whole = False
        return "done" if whole else "damaged"

    def states(
        self, scenes: Iterable[str], on_scene: Callable[[], object] = lambda: None
    ) -> dict[str, State]:
        """States of many scenes, in their order."""
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
