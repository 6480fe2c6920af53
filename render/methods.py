"""The rendering methods by name."""

from __future__ import annotations

from collections.abc import Callable

from render.method import Method
from render.path_tracer import PathTracer

# A method is built from (paths per pixel, Mitsuba variant).
METHODS: dict[str, Callable[[int, str], Method]] = {PathTracer.name: PathTracer}
DEFAULT_METHOD = PathTracer.name
