"""Writes ``renders/rendering.json``: how a dataset is rendered, and the error of the hidden signal."""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection
from dataclasses import asdict, replace

from disk.extras import installed_versions
from render.farm.claims import rendering_record_locked
from render.settings import RenderSettings, settings_of
from scenegen import Dataset, RenderingRecord, read_recipe, read_record, write_rendering_record

_PACKAGES = ("night-nlos", "mitsuba", "drjit", "mitransient", "numpy", "OpenEXR")


def record_rendering(dataset: Dataset, settings: RenderSettings, whole: bool, *, finished: bool) -> None:
    """Write ``rendering.json`` at the start and at the end of a run.

    The recorded settings do not change as long as any scene is rendered with them. The recorded product does
    not change after a run of some scenes only, because most scenes may have the earlier product.

    Parameters
    ----------
    whole : whether the run covers all scenes of the dataset.
    finished : whether the run has ended; then the errors of the renders are recorded as well.
    """
    with rendering_record_locked(dataset.renders):
        _record(dataset, settings, whole, finished)


def _record(dataset: Dataset, settings: RenderSettings, whole: bool, finished: bool) -> None:
    before = dataset.rendering
    if before is not None:
        earlier = settings_of(before, dataset)
        same = earlier.common_recipe(dataset) == settings.common_recipe(dataset)
        if not finished or (not same and _rendered_errors(dataset, earlier)):
            return
        if same and (earlier.wants_transients or not whole):
            settings = replace(settings, product=earlier.product)
    errors = _rendered_errors(dataset, settings) if finished else []
    known = [error for error in errors if error is not None]
    layout = settings.layout(dataset)
    record = RenderingRecord(
        method=settings.method,
        product=settings.product,
        max_bounces=settings.bounces(dataset),
        options=asdict(settings.options),
        width=layout.width,
        height=layout.height,
        packages=installed_versions(_PACKAGES),
        scene_count=len(errors),
        hidden_error_median=statistics.median(known) if known else None,
        hidden_error_max=max(known, default=None),
    )
    if record != before:
        write_rendering_record(dataset.renders, record)


def _rendered_errors(dataset: Dataset, settings: RenderSettings) -> list[float | None]:
    """Estimated hidden-signal error of each scene rendered with `settings`; None if there is no estimate."""
    common = settings.common_recipe(dataset)
    errors = []
    for scene_id in dataset.ids():
        record = read_record(dataset.render_folder(scene_id))
        if record is None:
            continue
        recipe = read_recipe(record.recipe)
        if all(recipe.get(key) == value for key, value in common.items()):
            errors.append(_number(record.attributes.get("hidden_error")))
    return errors


def _number(text: str | None) -> float | None:
    """A finite number from 0 on; None for anything else."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if 0 <= value < math.inf else None


def rendered_otherwise(dataset: Dataset, settings: RenderSettings, scenes: Collection[str]) -> str | None:
    """A scene beside `scenes` that is rendered with the recorded settings, if these are not `settings`.

    None if there is none: then the scenes may be rendered with `settings`.
    """
    before = dataset.rendering
    if before is None:
        return None
    common = settings_of(before, dataset).common_recipe(dataset)
    if common == settings.common_recipe(dataset):
        return None
    for scene_id in dataset.ids():
        if scene_id not in scenes and (record := read_record(dataset.render_folder(scene_id))) is not None:
            recipe = read_recipe(record.recipe)
            if all(recipe.get(key) == value for key, value in common.items()):
                return scene_id
    return None
