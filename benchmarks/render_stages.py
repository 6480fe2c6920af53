"""Timers around the functions that render a scene.

The functions are replaced where they are looked up, so the renderer needs no hooks. Where one timed function
calls another, the time counts for the outer one. DrJit is waited for at both ends of a stage.
"""

import importlib
import inspect
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

_TRANSPORT = "render.transport"
_FIRST_LATTICE = "runs at the first lattice"
# Stage, and the functions in it: module, and name there. A product without transients has no time bins.
STAGES: dict[str, tuple[tuple[str, str], ...]] = {
    "read the scene's files": (
        ("render.rendering", "read_scene_folder"),
        ("render.rendering", "scene_of"),
        ("render.rendering", "edited_attributes"),
    ),
    "SHA-256 of scene and renders": (("render.rendering", "digest_of"), ("render.rendering", "sha256_of")),
    "load both scenes, build their BVHs": (("render.rendering", "scene_from_data"),),
    "checks of the scene": (
        (f"{_TRANSPORT}.many_light", "read_hidden_surface"),
        (f"{_TRANSPORT}.many_light", "check_many_light_scene"),
    ),
    "pilot: where light arrives": ((f"{_TRANSPORT}.many_light", "light_density"),),
    "lights of trials and image": ((f"{_TRANSPORT}.many_light", "make_lights"),),
    _FIRST_LATTICE: (),  # timed below, because its pairs are counted, too
    "finer lattice and its check": ((f"{_TRANSPORT}.many_light", "make_field"),),
    "direct return": ((f"{_TRANSPORT}.many_light", "gather_direct"),),
    "hidden image": ((f"{_TRANSPORT}.passes.hidden_pass", "HiddenField.image"),),
    "time bins": (
        (f"{_TRANSPORT}.passes.transient_pass", "transient_rows"),
        (f"{_TRANSPORT}.passes.transient_pass", "_row_blocks"),
    ),
    "phasors of bins": (("itof.measurement", "MeasurementMatrix.apply_streaming"),),
    "ground truth": (("render.rendering", "trace_ground_truth"),),
    "encode and write files": (
        ("render.rendering", "write_image"),
        ("itof.exr.transient", "TransientWriter.write_rows"),
        ("render.rendering", "write_record"),
    ),
    "wait for the disk (fsync)": (("disk.whole_writing", "_sync"),),
}


@contextmanager
def stage_times() -> Iterator[dict[str, float]]:
    """Seconds of each stage in the block, and what it asked for: ``pairs`` of a point and a light.

    Also ``curve pairs`` of a node and a light for time bins, and ``curve seconds``, which count as time bins.
    """
    clock = _Clock()
    with _patched(
        [
            (target, lambda function, stage=stage: clock.timed(stage, function))
            for stage, targets in STAGES.items()
            for target in targets
        ]
        + [
            ((f"{_TRANSPORT}.passes.hidden_pass", "gather_lights"), clock.counting_gather),
            ((f"{_TRANSPORT}.passes.hidden_pass", "gather_runs"), clock.counting_gather),
            (
                (f"{_TRANSPORT}.many_light", "gather_runs"),
                lambda function: clock.timed(_FIRST_LATTICE, clock.counting_gather(function)),
            ),
            ((f"{_TRANSPORT}.lights.light_pass", "_arrivals_of"), clock.counting_arrivals),
            ((f"{_TRANSPORT}.passes.hidden_curves", "_curves_at"), clock.counting_curves),
        ]
    ):
        yield clock.seconds


@contextmanager
def last_field() -> Iterator[list[Any]]:
    """The hidden field that was made last in the block, in a list."""
    made: list[Any] = []

    def keeping(function: Callable[..., Any]) -> Callable[..., Any]:
        def kept(*given: Any, **named: Any) -> Any:
            made[:] = [function(*given, **named)]
            return made[0]

        return kept

    with _patched([((f"{_TRANSPORT}.many_light", "make_field"), keeping)]):
        yield made


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.is_running = False

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.is_running:
            yield
            return
        import drjit as dr

        dr.sync_thread()
        self.is_running, started = True, time.perf_counter()
        try:
            yield
            dr.sync_thread()
        finally:
            self.seconds[name] += time.perf_counter() - started
            self.is_running = False

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        if inspect.isgeneratorfunction(function):

            def generated(*given: Any, **named: Any) -> Iterator[Any]:
                items, end = function(*given, **named), object()
                while True:
                    with self.stage(name):
                        item = next(items, end)
                    if item is end:
                        return
                    yield item

            return generated

        def called(*given: Any, **named: Any) -> Any:
            with self.stage(name):
                return function(*given, **named)

        return called

    def counting_gather(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(scene: Any, points: Any, frequencies_hz: Any, lights: Any) -> Any:
            self.seconds["pairs"] += len(points) * len(lights)
            return function(scene, points, frequencies_hz, lights)

        return counted

    def counting_curves(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(scene: Any, nodes: Any, field: Any, *given: Any) -> Any:
            self.seconds["curve pairs"] += len(nodes) * len(field.lights)
            started = time.perf_counter()
            curves = function(scene, nodes, field, *given)
            self.seconds["curve seconds"] += time.perf_counter() - started
            return curves

        return counted

    def counting_arrivals(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def counted(scene: Any, emitter: Any, points: Any, wall_points: int, seed: int) -> Any:
            self.seconds["pairs"] += len(points.position) * wall_points
            return function(scene, emitter, points, wall_points, seed)

        return counted


@contextmanager
def _patched(changes: list[tuple[tuple[str, str], Callable[[Any], Any]]]) -> Iterator[None]:
    """Replace functions by what is made of them, for the time of the block."""
    patches = []
    for (module, path), make in changes:
        owner: Any = importlib.import_module(module)
        *classes, name = path.split(".")
        for part in classes:
            owner = getattr(owner, part)
        patches.append(patch.object(owner, name, make(getattr(owner, name))))
    for one in patches:
        one.start()
    try:
        yield
    finally:
        for one in reversed(patches):
            one.stop()
