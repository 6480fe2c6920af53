"""The rendering methods by name."""

from __future__ import annotations

from collections.abc import Callable

from render.transport.many_light import ManyLight
from render.transport.method import Method, MethodOptions
from render.transport.path_tracer import PathTracer

# A method is built from its options and the active Mitsuba variant.
METHODS: dict[str, Callable[[MethodOptions, str], Method]] = {
    ManyLight.name: ManyLight,
    PathTracer.name: PathTracer,
}
DEFAULT_METHOD = ManyLight.name
