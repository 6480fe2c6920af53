"""The table of the rendering methods by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from render.options import BatchedOptions, ManyLightOptions, PathOptions
from render.transport.many_light import ManyLight
from render.transport.method import Method
from render.transport.path_tracer import PathTracer

# A method is built from its own options and the active Mitsuba variant.
METHODS: dict[str, Callable[[Any, str], Method]] = {
    ManyLightOptions.method: ManyLight,
    PathOptions.method: PathTracer,
    # what the engine cannot render: `render.rendering` asks that first
    BatchedOptions.method: lambda options, variant: ManyLight(options.for_other_scenes(), variant),
}
