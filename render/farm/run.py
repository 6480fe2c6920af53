"""A run of ``night-render DATASET``: take stock of the renders, check the plan, render what is missing."""

from __future__ import annotations

import json
import logging
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from disk import NightError, PathLike, inside
from processes.progress import showing_progress
from render.backend import select_variant
from render.edited_scenes import refuse_edited, refuse_measured, without_effect
from render.farm.claims import joined_run, refuse_other_run
from render.farm.clusters import check_cluster, connected
from render.farm.inventory import Inventory, State
from render.farm.jobs import GROWTH_BYTES, Outcome
from render.farm.plan import Plan, make_plan
from render.farm.queue import QueueError, RenderQueue, Tally
from render.farm.rendering_record import record_rendering, rendered_otherwise
from render.farm.run_log import LOG_FILE, log_file, log_outcome, logged
from render.farm.run_result import RunResult
from render.farm.submissions import Submissions
from render.settings import RenderError, RenderSettings
from scenegen import Dataset, read_record

log = logging.getLogger(__name__)

_GROUP = 512  # scenes


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that do not change any pixel.

    Attributes
    ----------
    workers, scheduler, cluster_file : where jobs run (`render.farm.clusters.connected`).
    retry_failed : whether to try scenes again that failed before.
    replace : whether to render scenes again that were rendered with other settings.
    ignore_space : whether to start even if the disk seems too small.
    growth_bytes : memory that a worker process may grow by before it is replaced.
    progress : whether to show the progress.
    """

    workers: int | None = None
    scheduler: str | None = None
    cluster_file: PathLike | None = None
    retry_failed: bool = False
    replace: bool = False
    ignore_space: bool = False
    growth_bytes: int = GROWTH_BYTES
    progress: bool = True


def render_dataset(
    dataset: Dataset,
    settings: RenderSettings,
    scenes: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> RunResult:
    """Render the scenes among `scenes` that are not rendered yet.

    Parameters
    ----------
    say : called with each sentence of the plan.

    Raises
    ------
    RenderError : a scene is rendered with other settings, or its files are not those that ``dataset.json``
        vouches for, or the disk is too small.
    OtherRunError : another command renders the dataset with other settings.
    ClusterError : there are no workers.
    BackendError : this machine cannot render on the requested device.
    QueueError : no further scene can be rendered. The scenes rendered so far stay.
    """
    refuse_measured(dataset)
    _refuse_device(settings, options)  # before any file is written, as the next check
    check_cluster(options.scheduler, options.cluster_file, options.workers)
    renders = dataset.renders
    with (
        joined_run(renders, json.dumps(settings.common_recipe(dataset))),
        log_file(inside(renders, LOG_FILE)),
    ):
        found = _look(dataset, settings, scenes, options, say)
        whole = set(scenes) == set(dataset.ids())
        result = RunResult(0, len(found.done), skipped_failures=found.skipped)
        if found.todo:
            plan = _checked_plan(dataset, settings, found, options, logged(say))
            record_rendering(dataset, settings, whole, finished=False)
            try:
                tally = _work(dataset, settings, found.todo, options, logged(say))
            except QueueError:
                if renders.is_dir():  # a deleted dataset must not come back
                    record_rendering(dataset, settings, whole, finished=True)
                raise
            present = len(found.done) + tally.counts["present"]
            result = RunResult(tally.counts["rendered"], present, tally.failures, found.skipped, plan)
        record_rendering(dataset, settings, whole, finished=True)
        log.info(
            "%d rendered, %d were there already, %d failed",
            result.rendered,
            result.present,
            len(result.failures),
        )
    return _with_errors(result, dataset)


def plan_run(
    dataset: Dataset,
    settings: RenderSettings,
    scenes: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> RunResult:
    """Say what `render_dataset` would do, and render nothing.

    Raises
    ------
    RenderError, OtherRunError, ClusterError, BackendError : as in `render_dataset`. A scheduler that does not
        answer is not noticed, because nothing is connected.
    """
    refuse_measured(dataset)
    _refuse_device(settings, options)
    check_cluster(options.scheduler, options.cluster_file, options.workers)
    refuse_other_run(dataset.renders, json.dumps(settings.common_recipe(dataset)))
    found = _look(dataset, settings, scenes, options, say)
    plan = None
    if found.todo:
        plan = _checked_plan(dataset, settings, found, options, say)
    else:
        say(f"nothing to render: {len(found.done)} rendered before, {found.skipped} failed earlier")
    return _with_errors(RunResult(0, len(found.done), skipped_failures=found.skipped, plan=plan), dataset)


def _with_errors(result: RunResult, dataset: Dataset) -> RunResult:
    """The result with the errors that ``rendering.json`` has."""
    record = dataset.rendering
    if record is None:
        return result
    wanted = None if record.options.get("lights") else record.options.get("error")
    return replace(result, hidden_error_max=record.hidden_error_max, wanted_error=wanted)


@dataclass(frozen=True)
class _Found:
    """The scenes of a run: those to render, those that are rendered, and how many failed earlier."""

    todo: list[str]
    done: list[str]
    skipped: int


def _look(
    dataset: Dataset,
    settings: RenderSettings,
    scenes: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> _Found:
    other = None if options.replace else rendered_otherwise(dataset, settings, set(scenes))
    if other is not None:
        raise RenderError(
            f"scene {other} of {dataset.root} is rendered with other settings, and all scenes of a dataset "
            "have the same: leave the options out to go on with the earlier settings, or give --again changed"
        )
    inventory = Inventory(dataset, settings)
    with showing_progress(len(scenes), "scene", "look", show=options.progress) as bar:
        states = inventory.states(scenes, bar.update)
    unfinished = [s for s, state in states.items() if state != "done" and s in inventory.edited]
    edited = [s for s in unfinished if options.retry_failed or states[s] != "failed"]
    if not settings.accept_edited:
        refuse_edited(dataset, edited)
    elif sentence := without_effect(dataset, edited):
        say(sentence)
    return _Found(
        todo=_todo(dataset, states, options),
        done=[scene_id for scene_id, state in states.items() if state == "done"],
        skipped=sum(state == "failed" for state in states.values()) if not options.retry_failed else 0,
    )


def _checked_plan(
    dataset: Dataset,
    settings: RenderSettings,
    found: _Found,
    options: RunOptions,
    say: Callable[[str], object],
) -> Plan:
    """Say the plan; then `RenderError` if it does not fit the disk."""
    plan = make_plan(dataset, settings, found.todo, found.done)
    for sentence in plan.sentences():
        say(sentence)
    refusal = plan.refusal()
    if refusal and not options.ignore_space:
        raise RenderError(refusal)
    return plan


def _refuse_device(settings: RenderSettings, options: RunOptions) -> None:
    """`BackendError` if this machine must render and cannot."""
    if options.scheduler is None and options.cluster_file is None:
        select_variant(settings.device)


def _todo(dataset: Dataset, states: dict[str, State], options: RunOptions) -> list[str]:
    """Scenes to render, in order."""
    others = [scene_id for scene_id, state in states.items() if state == "other"]
    if others and not options.replace:
        raise RenderError(
            f"{len(others)} scenes of {dataset.root} (first {others[0]}) are rendered with other settings, "
            "or were changed since: leave the options out to go on with the earlier settings, or give "
            "--again changed to render them again"
        )
    wanted = {"missing", "damaged", "other"} | ({"failed"} if options.retry_failed else set())
    return [scene_id for scene_id, state in states.items() if state in wanted]


def _grouped(dataset: Dataset, todo: Sequence[str]) -> list[str]:
    """The scenes with those of the same relay wall next to each other, within groups of `_GROUP` scenes.

    Mitsuba takes 25 ms to prepare a rough wall, which a worker keeps for the next scene. The groups are
    small, so that an interrupted run leaves scenes of all walls.
    """

    def roughness(scene_id: str) -> float:
        try:
            return dataset.scene(scene_id).relay_wall.roughness or 0.0
        except (NightError, OSError):
            return 0.0  # rendering reports it

    groups = [todo[start : start + _GROUP] for start in range(0, len(todo), _GROUP)]
    return [scene_id for group in groups for scene_id in sorted(group, key=roughness)]


def _work(
    dataset: Dataset,
    settings: RenderSettings,
    todo: Sequence[str],
    options: RunOptions,
    say: Callable[[str], object],
) -> Tally:
    run_id, submissions = secrets.token_hex(8), Submissions()
    connection = connected(
        workers=min(options.workers, len(todo)) if options.workers else None,
        scheduler=options.scheduler,
        cluster_file=options.cluster_file,
        device=settings.device,
        keys_folder=dataset.renders.resolve(),
        submissions=submissions,
    )
    with connection as client, showing_progress(len(todo), "scene", "render", show=options.progress) as bar:
        inventory, failed = Inventory(dataset, settings), 0

        def count(outcome: Outcome, final: bool) -> None:
            nonlocal failed
            log_outcome(outcome, final)
            if final:
                failed += outcome.kind == "failed"
                bar.set_postfix(failed=failed, refresh=False)
                bar.update()
            if outcome.kind == "rendered":
                record = read_record(dataset.render_folder(outcome.scene_id))
                if record is not None:
                    inventory.remember(outcome.scene_id, record)

        queue = RenderQueue(client, dataset, settings, run_id, count, options.growth_bytes, say=say)
        if options.cluster_file is not None:
            queue.patience_s, queue.submissions = None, submissions
        try:
            return queue.run(_grouped(dataset, todo))
        finally:
            inventory.save()
