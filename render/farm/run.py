"""A run of ``night-render``: look what is there, plan, refuse what does not fit, render the rest."""

from __future__ import annotations

import json
import logging
import os
import secrets
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from render.backend import select_variant
from render.farm.claims import joined_run
from render.farm.clusters import connected
from render.farm.inventory import Inventory, State
from render.farm.jobs import GROWTH_BYTES, Outcome
from render.farm.plan import make_plan
from render.farm.queue import QueueError, RenderQueue, Tally
from render.settings import RenderError, RenderSettings, read_recipe, settings_of
from render.transport.method import MethodOptions
from scenegen import Dataset, RenderingProvenance, open_dataset, read_record, write_index

LOG_FILE = "night-render.log"
_PACKAGES = ("night-nlos", "mitsuba", "drjit", "mitransient", "numpy", "OpenEXR")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunOptions:
    """How a run works, none of which changes a pixel.

    Attributes
    ----------
    workers, scheduler, cluster_file : where jobs run (`render.farm.clusters.connected`).
    retry_failed : render scenes again that failed before.
    replace : render scenes again that were rendered with other settings.
    ignore_space : start although the disk looks too small.
    growth_bytes : what a worker process may grow by before a fresh one takes its place.
    progress : show a bar where there is a terminal.
    """

    workers: int | None = None
    scheduler: str | None = None
    cluster_file: Path | None = None
    retry_failed: bool = False
    replace: bool = False
    ignore_space: bool = False
    growth_bytes: int = GROWTH_BYTES
    progress: bool = True


@dataclass(frozen=True)
class RunResult:
    """How a run ended.

    Attributes
    ----------
    rendered : scenes that this run rendered.
    present : scenes that were there, or were meanwhile rendered by another command.
    failures : reason by scene that failed now.
    skipped_failures : scenes that failed in an earlier run and were not tried again.
    """

    rendered: int
    present: int
    failures: dict[str, str] = field(default_factory=dict)
    skipped_failures: int = 0


def settings_for(dataset: Dataset, given: dict[str, Any]) -> RenderSettings:
    """Settings of a run: what the dataset was rendered with before, if it was, changed by what is given.

    `given` has keys of `RenderSettings` and of its `MethodOptions`. Giving another method, error or number of
    lights than before starts from the defaults of the method's options.
    """
    before = dataset.index.rendering
    settings = settings_of(before, dataset) if before else RenderSettings(product="both")
    option_names = set(asdict(MethodOptions()))
    options = {name: value for name, value in given.items() if name in option_names}
    others = {name: value for name, value in given.items() if name not in option_names}
    if options or others.get("method", settings.method) != settings.method:
        others["options"] = MethodOptions(**options)
    return replace(settings, **others)


def render_dataset(
    dataset: Dataset,
    settings: RenderSettings,
    scenes: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> RunResult:
    """Render those of `scenes` that are not rendered yet; what is done, stays.

    Raises
    ------
    RenderError : scenes rendered with other settings, a disk too small, scenes without description.
    OtherRunError, ClusterError, BackendError, QueueError : another command with other settings, no workers,
        no device, or something that stops all work. What was rendered before that stays.
    """
    if not (options.scheduler or options.cluster_file):
        select_variant(settings.device)  # what cannot work here is said before anything is touched
    renders = dataset.root / "renders"
    with joined_run(renders, json.dumps(settings.common_recipe(dataset))), _log_file(renders / LOG_FILE):
        states = _look(dataset, settings, scenes, options)
        todo = _todo(dataset, states, options)
        whole = set(scenes) == set(dataset.ids())
        done = [scene_id for scene_id, state in states.items() if state == "done"]
        skipped = sum(state == "failed" for state in states.values()) if not options.retry_failed else 0
        result = RunResult(0, len(done), skipped_failures=skipped)
        if todo:
            plan = make_plan(dataset, settings, todo, done)
            for sentence in plan.sentences():
                say(sentence)
                log.info(sentence)
            refusal = plan.refusal()
            if refusal and not options.ignore_space:
                raise RenderError(refusal)
            _note_settings(dataset, settings, whole, finished=False)
            try:
                tally = _work(dataset, settings, todo, options)
            except QueueError:
                _note_settings(dataset, settings, whole, finished=True)
                raise
            counts = tally.counts
            result = RunResult(counts["rendered"], len(done) + counts["present"], tally.failures, skipped)
        _note_settings(dataset, settings, whole, finished=True)
        log.info(
            "%d rendered, %d were there, %d failed", result.rendered, result.present, len(result.failures)
        )
    return result


def _look(
    dataset: Dataset, settings: RenderSettings, scenes: Sequence[str], options: RunOptions
) -> dict[str, State]:
    inventory = Inventory(dataset, settings)
    with tqdm(total=len(scenes), unit="scene", desc="look", disable=not options.progress or None) as bar:
        return inventory.states(scenes, bar.update)


def _todo(dataset: Dataset, states: dict[str, State], options: RunOptions) -> list[str]:
    """Scenes to render, in order."""
    others = [scene_id for scene_id, state in states.items() if state == "other"]
    if others and not options.replace:
        raise RenderError(
            f"{len(others)} scenes of {dataset.root} (first {others[0]}) are rendered with other settings, "
            "or were changed since: leave the options out to go on with the settings of before, or give "
            "--replace to render them again"
        )
    wanted = {"missing", "damaged", "other"} | ({"failed"} if options.retry_failed else set())
    return [scene_id for scene_id, state in states.items() if state in wanted]


def _work(dataset: Dataset, settings: RenderSettings, todo: Sequence[str], options: RunOptions) -> Tally:
    run_id = secrets.token_hex(8)
    connection = connected(
        workers=min(options.workers, len(todo)) if options.workers else None,
        scheduler=options.scheduler,
        cluster_file=options.cluster_file,
        device=settings.device,
    )
    with (
        connection as client,
        tqdm(total=len(todo), unit="scene", desc="render", disable=not options.progress or None) as bar,
    ):
        inventory, failed = Inventory(dataset, settings), 0

        def note(outcome: Outcome, final: bool) -> None:
            nonlocal failed
            _log_outcome(outcome, final)
            if final:
                failed += outcome.kind == "failed"
                bar.set_postfix(failed=failed, refresh=False)
                bar.update()
            if outcome.kind == "rendered":
                record = read_record(dataset.render_folder(outcome.scene_id))
                if record is not None:
                    inventory.remember(outcome.scene_id, record)

        queue = RenderQueue(client, dataset, settings, run_id, note, options.growth_bytes)
        if options.cluster_file:
            queue.patience_s = None
        try:
            return queue.run(todo)
        finally:
            inventory.save()


def _log_outcome(outcome: Outcome, final: bool) -> None:
    if outcome.kind == "failed":
        after = "given up" if final else "once more"
        log.info("%s failed on %s: %s (%s)", outcome.scene_id, outcome.worker, outcome.reason, after)
    elif outcome.kind == "rendered":
        made = outcome.attributes
        how = ", ".join(f"{name} {made[name]}" for name in ("lights", "hidden_error") if name in made)
        log.info(
            "%s rendered in %.2f s on %s (%s)",
            *(outcome.scene_id, outcome.seconds, outcome.worker, how or made.get("method", "")),
        )
        for line in outcome.log.splitlines():
            log.info("%s: %s", outcome.scene_id, line)


def _note_settings(dataset: Dataset, settings: RenderSettings, whole: bool, *, finished: bool) -> None:
    """Keep in ``dataset.json`` how the dataset is rendered, and at the end of a run how well.

    Settings of before stay as long as any scene is rendered with them, and the product of before after a run
    that was not of the whole dataset: a few scenes rendered otherwise do not speak for the others.
    """
    before = open_dataset(dataset.root).index.rendering
    if before is not None:
        earlier = settings_of(before, dataset)
        same = earlier.common_recipe(dataset) == settings.common_recipe(dataset)
        if not finished or (not same and _rendered_errors(dataset, earlier)):
            return
        if same and (earlier.wants_transients or not whole):
            settings = replace(settings, product=earlier.product)  # that of all scenes, not of a few
    errors = _rendered_errors(dataset, settings) if finished else []
    known = [error for error in errors if error is not None]
    layout = settings.layout(dataset)
    note = RenderingProvenance(
        method=settings.method,
        product=settings.product,
        max_bounces=settings.bounces(dataset),
        options=asdict(settings.options),
        width=layout.width,
        height=layout.height,
        packages={name: version(name) for name in _PACKAGES},
        scene_count=len(errors),
        hidden_error_median=statistics.median(known) if known else None,
        hidden_error_max=max(known, default=None),
    )
    if note != before:
        index = open_dataset(dataset.root).index  # as it is now: night-gen may have added scenes meanwhile
        write_index(dataset.root, replace(index, rendering=note))


def _rendered_errors(dataset: Dataset, settings: RenderSettings) -> list[float | None]:
    """Estimated hidden-signal error of every scene rendered with `settings`; None where there is none."""
    common = settings.common_recipe(dataset)
    errors = []
    for scene_id in dataset.ids():
        record = read_record(dataset.render_folder(scene_id))
        if record is None:
            continue
        recipe = read_recipe(record.recipe)
        if all(recipe.get(key) == value for key, value in common.items()):
            error = record.attributes.get("hidden_error")
            errors.append(float(error) if error is not None else None)
    return errors


@contextmanager
def _log_file(file: Path) -> Iterator[None]:
    """Append what the run logs to a file; a disk that takes no more of it stops nothing."""
    try:
        handler: logging.Handler = logging.FileHandler(file, encoding="utf-8")
    except OSError:
        handler = logging.NullHandler()
    handler.setFormatter(logging.Formatter(f"%(asctime)s {os.getpid()} %(message)s"))
    handler.handleError = lambda record: None  # type: ignore[method-assign]
    logger = logging.getLogger("render")
    level, propagate = logger.level, logger.propagate
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.addHandler(handler)
    try:
        yield
    except BaseException as error:
        log.info("ended: %s", " ".join(str(error).split()) or type(error).__name__)
        raise
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = propagate
        handler.close()
