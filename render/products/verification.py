"""Verification of rendered scenes: every file is read again, no cached hash is used."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from disk import NightError
from disk.counted import counted
from itof import read_image
from processes.worker_processes import results_in_order, worker_pool
from render.farm.claims import claimed
from render.products.content_checks import (
    changed_files,
    wrong_phasors,
    wrong_pixels,
    wrong_storage,
    wrong_transient,
    wrong_truth,
)
from render.settings import RenderError
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILES,
    BadRender,
    Dataset,
    RenderRecord,
    open_dataset,
    read_bad_render,
    read_recipe,
    read_record,
    write_bad_render,
)
from scenegen.render_folder import BAD_FILE
from scenegen.scene_folder import differences, folder_digest


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes
    ----------
    checked : number of rendered scenes, all of which were checked.
    problems : problems of each bad scene, as sentences.
    missing : number of scenes that are not rendered.
    damaged_scenes : what is wrong with the files of scenes, so that their renders could not be checked.
    defects : bad scenes, of those in `problems`, that were rendered twice with the same bytes.
    """

    checked: int
    problems: dict[str, list[str]]
    missing: int = 0
    damaged_scenes: dict[str, str] = field(default_factory=dict)
    defects: tuple[str, ...] = ()

    @property
    def renders_again(self) -> bool:
        """Whether the next run renders a bad scene again."""
        return len(self.problems) > len(self.defects)

    def as_data(self) -> dict[str, Any]:
        """The result as plain data (docs/reference/files.md, results as JSON)."""
        bad, damaged = len(self.problems), len(self.damaged_scenes)
        return {
            "good": self.checked - bad - damaged,
            "bad": bad,
            "not_rendered": self.missing,
            "not_checked": damaged,
            "problems": self.problems,
            "damaged_scenes": self.damaged_scenes,
            "defects": list(self.defects),
        }

    def sentences(self) -> list[str]:
        """The result as lines of text."""
        bad, damaged = len(self.problems), len(self.damaged_scenes)
        counts = f"{self.checked - bad - damaged} good, {bad} bad; {self.missing} not rendered"
        if damaged:
            counts += f"; {damaged} not checked, because their scene files are damaged"
        return [
            *(f"scene files damaged: {id_}: {why}" for id_, why in self.damaged_scenes.items()),
            *(f"bad: {id_}: {'; '.join(problems)}" for id_, problems in self.problems.items()),
            *(
                f"bad again: {id_}: it was rendered twice with the same bytes and is not rendered again. "
                "This is a defect of NIGHT, in the render or in the check: please report it"
                for id_ in self.defects
            ),
            f"{counted(self.checked, 'scene')} checked: {counts}",
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
    read-only. If the files of a bad scene are as they were written, ``bad.json`` remembers them. If the next
    render has the same bytes and is bad again, its record stays, because rendering once more does not help.
    A render cannot be checked against damaged scene files; it is kept.

    Parameters
    ----------
    workers : number of processes that check scenes.
    on_scene : called after each scene.
    """
    rendered = [s for s in scenes if (dataset.render_folder(s) / RECORD_FILE).exists()]
    bad, damaged, defects = {}, {}, []
    for scene_id, (damage, judged) in _checked(dataset, rendered, workers):
        on_scene()
        if damage:
            damaged[scene_id] = damage
        elif not judged.problems:
            with suppress(OSError):  # of a read-only folder
                (dataset.render_folder(scene_id) / BAD_FILE).unlink(missing_ok=True)
        elif (final := judged if judged.again else _condemned(dataset, scene_id, judged)).problems:
            bad[scene_id] = final.problems
            if final.again:
                defects.append(scene_id)
    return Verification(len(rendered), bad, len(scenes) - len(rendered), damaged, tuple(defects))


def scene_damage(dataset: Dataset, scene_id: str) -> str:
    """What is wrong with the files of a rendered scene; empty if nothing is.

    They are right if they are those of ``dataset.json``, or edited ones from which the scene was rendered.
    """
    folder, listed = dataset.scene_folder(scene_id), dataset.entry(scene_id).sha256
    try:
        found = folder_digest(folder)
    except (NightError, OSError) as error:
        return str(error)
    record = read_record(dataset.render_folder(scene_id))
    rendered = read_recipe(record.recipe).get("scene_sha256") if record else None
    return "" if listed is None or found in (listed, rendered) else differences(folder)


@dataclass(frozen=True)
class _Judgement:
    """What is wrong with a rendered scene.

    Attributes
    ----------
    problems : sentences; empty if nothing is wrong.
    record : its record, if all files are as they were written, from the scene as it is now.
    again : whether an earlier render with the same bytes was bad, too.
    """

    problems: list[str]
    record: RenderRecord | None = None
    again: bool = False


def _condemned(dataset: Dataset, scene_id: str, judged: _Judgement) -> _Judgement:
    """Judge a bad scene again and, if it is still bad, delete its record and remember its intact files."""
    folder = dataset.render_folder(scene_id)
    try:
        with claimed(dataset.renders, scene_id) as claim:
            if claim is None:
                return _Judgement([])  # another process is rendering it again
            judged = _judged(dataset, scene_id)
            if judged.problems and not judged.again:
                (folder / RECORD_FILE).unlink(missing_ok=True)
                _remember(folder, judged)
            claim.forget()
    except OSError as error:
        return _Judgement([*judged.problems, f"its record could not be deleted ({error.strerror})"])
    return judged


def _remember(folder: Path, judged: _Judgement) -> None:
    if judged.record is not None:
        bad = BadRender(judged.record.recipe, judged.record.files, tuple(judged.problems))
        with suppress(OSError):  # of a full disk: the scene is then rendered once more than needed
            write_bad_render(folder, bad)


def _judged(dataset: Dataset, scene_id: str) -> _Judgement:
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    if record is None:
        return _Judgement([f"{RECORD_FILE} is damaged"])
    problems = list(changed_files(folder, record))
    if problems:
        return _Judgement(problems)  # the contents of changed files tell nothing more
    recipe = read_recipe(record.recipe)
    try:
        if recipe.get("scene_sha256") != folder_digest(dataset.scene_folder(scene_id)):
            return _Judgement(["the scene was changed after it was rendered"])
        problems.extend(_wrong_contents(dataset, scene_id, record, recipe))  # keeps those before an error
    except (ValueError, LookupError, TypeError, OSError) as error:
        problems.append(" ".join(str(error).split()) or type(error).__name__)
    bad = read_bad_render(folder) if problems else None
    return _Judgement(problems, record, bad is not None and bad.is_again(record))


def _wrong_contents(
    dataset: Dataset, scene_id: str, record: RenderRecord, recipe: dict[str, Any]
) -> Iterator[str]:
    folder = dataset.render_folder(scene_id)
    width, height = recipe["size"]
    image, truth = read_image(folder / MEASUREMENT_FILE), read_image(folder / GROUND_TRUTH_FILE)
    problems = [
        *wrong_storage(folder, record),
        *wrong_pixels(MEASUREMENT_FILE, image, (height, width)),
        *wrong_pixels(GROUND_TRUTH_FILE, truth, (height, width)),
    ]
    yield from problems
    if problems:
        return
    yield from wrong_phasors(image, dataset.preset.itof.frequencies_hz)
    yield from wrong_truth(dataset, scene_id, truth)
    for name in TRANSIENT_FILES:
        if name in record.files:
            yield from wrong_transient(folder / name, image, (height, width))


def _checked(
    dataset: Dataset, scenes: Sequence[str], workers: int
) -> Iterator[tuple[str, tuple[str, _Judgement]]]:
    """Each scene with its damage and its problems."""
    if min(workers, len(scenes)) <= 1:
        for scene_id in scenes:
            yield scene_id, _looked_at(dataset, scene_id)
        return
    workers = min(workers, len(scenes))
    try:
        with worker_pool(workers, _start_worker, dataset.root) as pool:
            answers = results_in_order(pool, _verify_in, scenes, 2 * workers)
            for scene_id, answer in zip(scenes, answers, strict=True):
                if answer is not None:
                    yield scene_id, answer
    except BrokenProcessPool:
        raise RenderError(
            "a worker process was killed, perhaps because memory ran out: try fewer --workers"
        ) from None


_workers: list[tuple[Path, Event]] = []  # of this process, if it is a worker
_opened: list[Dataset] = []  # in the first task: the parent gets its errors, but not those of the start


def _looked_at(dataset: Dataset, scene_id: str) -> tuple[str, _Judgement]:
    damage = scene_damage(dataset, scene_id)
    return damage, _Judgement([]) if damage else _judged(dataset, scene_id)


def _start_worker(root: Path, stop: Event) -> None:
    _workers.append((root, stop))


def _verify_in(scene_id: str) -> tuple[str, _Judgement] | None:
    """Damage and problems of a scene; None if the command is ending."""
    root, stop = _workers[0]
    if stop.is_set():
        return None
    if not _opened:
        _opened.append(open_dataset(root))
    return _looked_at(_opened[0], scene_id)
