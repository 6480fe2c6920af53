"""Settings and options of a rendering run from the command line."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scenegen import Dataset

if TYPE_CHECKING:
    from render import RenderSettings, RunOptions

_RUN_OPTIONS = ("workers", "scheduler", "retry_failed", "replace", "ignore_space")


def render_settings(dataset: Dataset, options: Mapping[str, Any]) -> RenderSettings:
    """Settings of before, changed by the options that are given."""
    from render import settings_for

    return settings_for(dataset, {name: value for name, value in options.items() if value is not None})


def chosen_run(dataset: Dataset, options: dict[str, Any]) -> tuple[RenderSettings, RunOptions]:
    """How to render, and the options of the run that change no pixel."""
    from render import RunOptions

    run = {name: options.pop(name) for name in _RUN_OPTIONS}
    run_options = RunOptions(cluster_file=options.pop("cluster"), **run)
    return render_settings(dataset, options), run_options
