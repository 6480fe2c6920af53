"""Averages over groups of scenes: by shape, roughness of the wall, position and size."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from model.judging.scene_result import SceneResult

POSITION_BINS = 4
NO_OBJECT = "no object"
AXES = (
    ("x", "distance from the relay wall"),
    ("y", "distance behind the middle wall"),
    ("z", "height above the floor"),
)
Ranges = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Group:
    """Averages over the scenes of one group.

    Attributes
    ----------
    name : name of the group, for readers.
    count : number of scenes.
    depth_mae_m, no_object_mae_m : MAE over all pixels of the prediction and of "no object", metres.
    object_mae_m : MAE on the object, metres, over the scenes for which it is defined; None if for none.
    miou : mean of object IoU and background IoU.
    """

    name: str
    count: int
    depth_mae_m: float
    object_mae_m: float | None
    miou: float
    no_object_mae_m: float


@dataclass(frozen=True)
class GroupTable:
    """All scenes, each in one group; `key` is for programs, `title` and `explanation` are for readers."""

    key: str
    title: str
    explanation: str
    groups: tuple[Group, ...]


def group_tables(scenes: Sequence[SceneResult], location_ranges_m: Ranges) -> tuple[GroupTable, ...]:
    """Tables by shape, composite or simple, roughness, position on each axis, and size.

    Parameters
    ----------
    location_ranges_m : lower and upper bound of the objects' positions on each world axis, metres.
    """
    by_axis = [
        _by_axis(scenes, axis, bounds_m) for axis, bounds_m in zip(range(3), location_ranges_m, strict=True)
    ]
    return (
        GroupTable(
            "object_class",
            "Shape",
            "Shape of the hidden object.",
            _groups(scenes, lambda s: s.object_class, lambda name, _: _words(name)),
        ),
        GroupTable(
            "composite",
            "Simple or composite",
            "A composite consists of two different primitives.",
            _groups(
                scenes,
                lambda s: (s.location_m is None, s.is_composite),
                lambda key, _: NO_OBJECT if key[0] else "composite" if key[1] else "simple",
            ),
        ),
        GroupTable(
            "roughness",
            "Roughness of the relay wall",
            "A low roughness is glossy, 1 is almost diffuse.",
            _groups(
                scenes,
                lambda s: 2.0 if s.roughness is None else s.roughness,  # above 1: diffuse is last
                lambda _, some: "diffuse" if some[0].roughness is None else f"{some[0].roughness:g}",
            ),
        ),
        *by_axis,
        _by_size(scenes),
    )


def _by_axis(scenes: Sequence[SceneResult], axis: int, bounds_m: tuple[float, float]) -> GroupTable:
    """Bins of equal width along one world axis; the first and the last are open. Empty corners come last."""
    letter, meaning = AXES[axis]
    edges_m = np.linspace(*bounds_m, POSITION_BINS + 1)  # (POSITION_BINS + 1,)
    names = [*(f"{low:.3f}–{high:.3f} m" for low, high in pairwise(edges_m)), NO_OBJECT]

    def place(scene: SceneResult) -> int:
        if scene.location_m is None:
            return POSITION_BINS
        return int(np.searchsorted(edges_m[1:-1], scene.location_m[axis], side="right"))

    return GroupTable(
        f"{letter}_m",
        f"Position: {meaning} ({letter})",
        "Centre of the object (of a composite: its first part). The title holds for the paper's room.",
        _groups(scenes, place, lambda place, _: names[place]),
    )


def _by_size(scenes: Sequence[SceneResult]) -> GroupTable:
    """Quartiles by the number of true object pixels."""
    inner = np.quantile([s.object_pixels for s in scenes], (0.25, 0.5, 0.75))

    def name(_: Hashable, some: Sequence[SceneResult]) -> str:
        pixels = [s.object_pixels for s in some]
        return f"{min(pixels)}–{max(pixels)} pixels"

    return GroupTable(
        "object_pixels",
        "Size in the image",
        "Quartiles by the number of pixels that show the object.",
        _groups(scenes, lambda s: int(np.searchsorted(inner, s.object_pixels, side="left")), name),
    )


def _groups(
    scenes: Sequence[SceneResult],
    key: Callable[[SceneResult], Any],
    name: Callable[[Any, Sequence[SceneResult]], str],
) -> tuple[Group, ...]:
    """Groups of scenes with equal `key`, in ascending order of it."""
    members: dict[Any, list[SceneResult]] = {}
    for scene in scenes:
        members.setdefault(key(scene), []).append(scene)
    return tuple(_average(name(value, members[value]), members[value]) for value in sorted(members))


def _average(name: str, scenes: Sequence[SceneResult]) -> Group:
    on_object = [m for s in scenes if (m := s.prediction.object_mae_m) is not None]
    return Group(
        name=name,
        count=len(scenes),
        depth_mae_m=float(np.mean([s.prediction.depth_mae_m for s in scenes])),
        object_mae_m=float(np.mean(on_object)) if on_object else None,
        miou=float(np.mean([s.prediction.miou for s in scenes])),
        no_object_mae_m=float(np.mean([s.no_object.depth_mae_m for s in scenes])),
    )


def _words(name: str) -> str:
    return name if name.startswith("mesh:") else name.replace("_", " ")
