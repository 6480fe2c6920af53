"""The rendering methods by name."""

from __future__ import annotations

from collections.abc import Callable

from render.many_light import ManyLight
from render.method import Method, MethodOptions
from render.path_tracer import PathTracer

# A method is built from its options and the active Mitsuba variant.
METHODS: dict[str, Callable[[MethodOptions, str], Method]] = {
    ManyLight.name: ManyLight,
    PathTracer.name: PathTracer,
}
DEFAULT_METHOD = ManyLight.name
