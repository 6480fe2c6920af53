"""Verification of rendered scenes: every file is read again, no cached hash is used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from itof import read_image
from render.farm.claims import claimed
from render.products.content_checks import (
    changed_files,
    wrong_phasors,
    wrong_pixels,
    wrong_storage,
    wrong_transient,
    wrong_truth,
)
from render.settings import RenderError, read_recipe, scene_sha256
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILES,
    Dataset,
    open_dataset,
    read_record,
)


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes
    ----------
    checked : number of rendered scenes, all of which were checked.
    problems : problems of each bad scene, as sentences.
    missing : number of scenes that are not rendered.
    """

    checked: int
    problems: dict[str, list[str]]
    missing: int = 0

    def sentences(self) -> list[str]:
        """The result as lines of text."""
        bad = len(self.problems)
        counts = f"{self.checked - bad} good, {bad} bad; {self.missing} not rendered"
        return [
            *(f"bad: {scene_id}: {'; '.join(problems)}" for scene_id, problems in self.problems.items()),
            f"{self.checked} scenes checked: {counts}",
        ]


def verify(
    dataset: Dataset,
    scenes: Sequence[str],
    *,
    workers: int = 1,
    on_scene: Callable[[], object] = lambda: None,
) -> Verification:
    """Check every file of the rendered scenes among `scenes`.

    A scene without a record is not rendered and is not checked. The record of a bad scene is deleted, so that
    the next run renders it again. It stays if another process is rendering the scene, or if the folder is
    read-only.

    Parameters
    ----------
    workers : number of processes that check scenes.
    on_scene : called after each scene.
    """
    rendered = [s for s in scenes if (dataset.render_folder(s) / RECORD_FILE).exists()]
    bad = {}
    for scene_id, problems in _checked(dataset, rendered, workers):
        on_scene()
        if problems and (still := _condemned(dataset, scene_id, problems)):
            bad[scene_id] = still
    return Verification(len(rendered), bad, missing=len(scenes) - len(rendered))


def _condemned(dataset: Dataset, scene_id: str, problems: list[str]) -> list[str]:
    """Check a bad scene again, delete its record if it is still bad, and return its problems."""
    try:
        with claimed(dataset.renders, scene_id) as claim:
            if claim is None:
                return []  # another process is rendering it again
            problems = verify_scene(dataset, scene_id)
            if problems:
                (dataset.render_folder(scene_id) / RECORD_FILE).unlink(missing_ok=True)
            claim.forget()
    except OSError as error:
        return [*problems, f"its record could not be deleted ({error.strerror})"]
    return problems


def verify_scene(dataset: Dataset, scene_id: str) -> list[str]:
    """Problems of a rendered scene, as sentences; an empty list if there are none."""
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    if record is None:
        return [f"{RECORD_FILE} is damaged"]
    problems = list(changed_files(folder, record))
    if problems:
        return problems  # the contents of changed files tell nothing more
    recipe = read_recipe(record.recipe)
    try:
        if recipe.get("scene_sha256") != scene_sha256(dataset, scene_id):
            return ["the scene was changed after it was rendered"]
        width, height = recipe["size"]
        problems += wrong_storage(folder, record)
        image, truth = read_image(folder / MEASUREMENT_FILE), read_image(folder / GROUND_TRUTH_FILE)
        problems += wrong_pixels(MEASUREMENT_FILE, image, (height, width))
        problems += wrong_pixels(GROUND_TRUTH_FILE, truth, (height, width))
        if problems:
            return problems
        problems += wrong_phasors(image, dataset.preset.itof.frequencies_hz)
        problems += wrong_truth(dataset, scene_id, truth)
        for name in TRANSIENT_FILES:
            if name in record.files:
                problems += wrong_transient(folder / name, image, (height, width))
    except (ValueError, LookupError, TypeError, OSError) as error:
        problems.append(" ".join(str(error).split()) or type(error).__name__)
    return problems


def _checked(dataset: Dataset, scenes: Sequence[str], workers: int) -> Iterator[tuple[str, list[str]]]:
    if min(workers, len(scenes)) <= 1:
        for scene_id in scenes:
            yield scene_id, verify_scene(dataset, scene_id)
        return
    try:
        with ProcessPoolExecutor(min(workers, len(scenes)), mp_context=get_context("spawn")) as pool:
            answers = pool.map(_verify_in, repeat(str(dataset.root)), scenes, chunksize=4)
            yield from zip(scenes, answers, strict=True)
    except BrokenProcessPool:
        raise RenderError(
            "a worker process was killed, perhaps because memory ran out: try fewer --workers"
        ) from None


_opened: dict[str, Dataset] = {}  # of this worker process


def _verify_in(root: str, scene_id: str) -> list[str]:
    if root not in _opened:
        _opened[root] = open_dataset(Path(root))
    return verify_scene(_opened[root], scene_id)
