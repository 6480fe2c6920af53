"""A run of ``night-render``: look what is there, plan, refuse what does not fit, render the rest."""

from __future__ import annotations

import json
import logging
import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from render.backend import select_variant
from render.farm.claims import joined_run
from render.farm.clusters import check_cluster, connected
from render.farm.inventory import Inventory, State
from render.farm.jobs import GROWTH_BYTES, Outcome
from render.farm.note import note_rendering
from render.farm.plan import make_plan
from render.farm.queue import QueueError, RenderQueue, Tally
from render.options import option_names, options_of
from render.settings import RenderError, RenderSettings, settings_of
from scenegen import Dataset, read_record
from scenegen.progress import showing_progress

LOG_FILE = "night-render.log"

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

    def sentences(self, renders: Path) -> list[str]:
        """What was done, for people to read; `renders` is the folder of the renders."""
        return [f"{self.rendered} scenes rendered, {self.present} were there; {renders}"]

    def complaints(self, renders: Path) -> list[str]:
        """What failed and what to do about it, for people to read; nothing when all went well."""
        lines = [f"failed: scene {scene_id}: {reason}" for scene_id, reason in sorted(self.failures.items())]
        if self.failures:
            lines.append(
                f"{len(self.failures)} scenes failed; logs are in {renders}/<id>/failure.log, and "
                "night-render --retry-failed tries them again"
            )
        if self.skipped_failures:
            lines.append(
                f"{self.skipped_failures} scenes failed earlier and were left out: night-render "
                "--retry-failed tries them again, night-render status names them"
            )
        return lines


def settings_for(dataset: Dataset, given: dict[str, Any]) -> RenderSettings:
    """Settings of a run: what the dataset was rendered with before, if it was, changed by what is given.

    `given` has keys of `RenderSettings`, ``method``, and names of the method's options (`render.options`).
    Giving another method, error or number of lights than before starts from the defaults of the method's
    options.

    Raises
    ------
    OptionError, RenderError : a method or option that there is not, or an impossible value.
    """
    before = dataset.rendering
    settings = settings_of(before, dataset) if before else RenderSettings(product="both")
    known = option_names()
    options = {name: value for name, value in given.items() if name in known}
    others = {name: value for name, value in given.items() if name not in known}
    method = others.pop("method", settings.method)
    if options or method != settings.method:
        others["options"] = options_of(method, options)
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
    _refuse_device(settings, options)  # before anything is touched
    renders = dataset.renders
    with joined_run(renders, json.dumps(settings.common_recipe(dataset))), _log_file(renders / LOG_FILE):
        found = _look(dataset, settings, scenes, options)
        whole = set(scenes) == set(dataset.ids())
        result = RunResult(0, len(found.done), skipped_failures=found.skipped)
        if found.todo:
            _announce(dataset, settings, found, options, say)
            note_rendering(dataset, settings, whole, finished=False)
            try:
                tally = _work(dataset, settings, found.todo, options)
            except QueueError:
                note_rendering(dataset, settings, whole, finished=True)
                raise
            present = len(found.done) + tally.counts["present"]
            result = RunResult(tally.counts["rendered"], present, tally.failures, found.skipped)
        note_rendering(dataset, settings, whole, finished=True)
        log.info(
            "%d rendered, %d were there, %d failed", result.rendered, result.present, len(result.failures)
        )
    return result


def plan_run(
    dataset: Dataset,
    settings: RenderSettings,
    scenes: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> None:
    """Say what `render_dataset` would do, and render nothing.

    Raises
    ------
    RenderError, OtherRunError, ClusterError, BackendError : as of `render_dataset`, but for a scheduler that
        does not answer.
    """
    _refuse_device(settings, options)
    check_cluster(options.scheduler, options.cluster_file)
    recipe = json.dumps(settings.common_recipe(dataset))
    with joined_run(dataset.renders, recipe) if dataset.renders.is_dir() else nullcontext():
        found = _look(dataset, settings, scenes, options)
        if found.todo:
            _announce(dataset, settings, found, options, say)
        else:
            say(f"nothing to render: {len(found.done)} scenes are there, {found.skipped} failed earlier")


@dataclass(frozen=True)
class _Found:
    """What a run finds: scenes to render, scenes that are there, and how many failed earlier and are left."""

    todo: list[str]
    done: list[str]
    skipped: int


def _look(dataset: Dataset, settings: RenderSettings, scenes: Sequence[str], options: RunOptions) -> _Found:
    inventory = Inventory(dataset, settings)
    with showing_progress(len(scenes), "scene", "look", show=options.progress) as bar:
        states = inventory.states(scenes, bar.update)
    return _Found(
        todo=_todo(dataset, states, options),
        done=[scene_id for scene_id, state in states.items() if state == "done"],
        skipped=sum(state == "failed" for state in states.values()) if not options.retry_failed else 0,
    )


def _announce(
    dataset: Dataset,
    settings: RenderSettings,
    found: _Found,
    options: RunOptions,
    say: Callable[[str], object],
) -> None:
    """Say the plan; `RenderError` where it does not fit the disk."""
    plan = make_plan(dataset, settings, found.todo, found.done)
    for sentence in plan.sentences():
        say(sentence)
        log.info(sentence)
    refusal = plan.refusal()
    if refusal and not options.ignore_space:
        raise RenderError(refusal)


def _refuse_device(settings: RenderSettings, options: RunOptions) -> None:
    """`BackendError` where this machine is to render and cannot."""
    if not (options.scheduler or options.cluster_file):
        select_variant(settings.device)


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
    with connection as client, showing_progress(len(todo), "scene", "render", show=options.progress) as bar:
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
