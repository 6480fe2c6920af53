"""Keeping ``renders/rendering.json``: how a dataset is rendered, and how well."""

from __future__ import annotations

import statistics
from dataclasses import asdict, replace
from importlib.metadata import version

from render.farm.claims import noting
from render.settings import RenderSettings, read_recipe, settings_of
from scenegen import Dataset, RenderingRecord, read_record, write_rendering_record

_PACKAGES = ("night-nlos", "mitsuba", "drjit", "mitransient", "numpy", "OpenEXR")


def note_rendering(dataset: Dataset, settings: RenderSettings, whole: bool, *, finished: bool) -> None:
    """Keep in ``rendering.json`` how the dataset is rendered, and at the end of a run how well.

    Settings of before stay as long as any scene is rendered with them, and the product of before after a run
    that was not of the whole dataset: a few scenes rendered otherwise do not speak for the others.
    """
    with noting(dataset.renders):
        _note(dataset, settings, whole, finished)


def _note(dataset: Dataset, settings: RenderSettings, whole: bool, finished: bool) -> None:
    before = dataset.rendering
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
    note = RenderingRecord(
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
        write_rendering_record(dataset.renders, note)


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
