"""What this machine can do at most: occlusion rays, memory bandwidth, files that reach the disk."""

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_RAYS = 2**22
_COPIED_BYTES = 2**28  # more than any cache holds


def occlusion_rays(scene: Any) -> float:
    """Occlusion rays per second, from random points of the relay wall to where hidden objects are."""
    import drjit as dr
    import mitsuba as mi

    rng = np.random.default_rng(0)
    wall = mi.Point3f(
        np.stack([np.full(_RAYS, 1e-3), *rng.uniform([[-0.8], [0.8]], [[1.7], [2.5]], (2, _RAYS))])
    )
    place = mi.Point3f(rng.uniform([[1.0], [0.5], [1.25]], [[1.3], [1.3], [1.95]], (3, _RAYS)))
    dr.eval(wall, place)

    def trace() -> None:
        hit = scene.ray_test(mi.Ray3f(wall, dr.normalize(place - wall), dr.norm(place - wall), 0, []))
        dr.eval(hit)
        dr.sync_thread()

    return _RAYS / _shortest(trace)


def copied_bytes() -> float:
    """Bytes per second that numpy copies with one thread; each is read and written."""
    source = np.ones(_COPIED_BYTES, np.uint8)
    target = np.empty_like(source)
    return _COPIED_BYTES / _shortest(lambda: np.copyto(target, source))


def file_seconds(folder: Path, size: int) -> float:
    """Seconds to write a file of some bytes and wait until it is on the disk (fsync)."""
    contents = np.random.default_rng(0).bytes(size)

    def write() -> None:
        with (folder / "limit").open("wb") as file:
            file.write(contents)
            file.flush()
            os.fsync(file.fileno())

    return _shortest(write)


def _shortest(action: Callable[[], None]) -> float:
    """Seconds of the fastest of four calls."""
    times = []
    for _ in range(4):
        started = time.perf_counter()
        action()
        times.append(time.perf_counter() - started)
    return min(times)
