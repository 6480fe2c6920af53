"""What a fit may change of a candidate: places, rotations, extents, and what is unknown of the walls."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from model.refinement.light.corner_light import euler_deg, vector
from scenegen.pose import rotation_matrix, wall_normal
from scenegen.scene import HiddenObject, Scene
from scenegen.shapes import Shape

Floats = NDArray[np.float64]
ROUGHNESS: Final = (0.05, 1.0)  # smallest and largest of a relay wall
_STEP_M, _STEP_RAD, _STEP_SIZE, _STEP_ROUGHNESS = 1e-2, 0.025, 2e-2, 2e-2  # of the differences
_WIDER: Final = 3.0  # with few nodes: shadows move from node to node, and light changes in steps
# Of one step, by kind.
FARTHEST: Final = {"place": 0.15, "turn": 0.5, "size": 0.2, "room": 0.15, "roughness": 0.3}


@dataclass(frozen=True)
class Fitted:
    """What is fitted besides the poses of objects.

    Attributes
    ----------
    roughness : of the relay wall.
    sizes : extents of the objects.
    room : how far the middle wall is along the normals of both walls.
    """

    roughness: bool = False
    sizes: bool = False
    room: bool = False


@dataclass(frozen=True)
class Unknown:
    """One number: of which object, of which kind, and which of its kind.

    `steps` are the two changes whose difference gives the derivative, the larger one first.
    """

    part: int
    kind: str
    place: int
    steps: tuple[float, float]

    @classmethod
    def about(cls, part: int, kind: str, place: int, step: float) -> Unknown:
        """With a step either way."""
        return cls(part, kind, place, (step, -step))


def unknowns(candidate: Scene, fitted: Fitted, fine: bool) -> list[Unknown]:
    """The unknowns of a candidate; `fine` : whether the light is computed with many nodes."""
    return list(_unknowns(candidate, fitted, 1.0 if fine else _WIDER))


def _unknowns(candidate: Scene, fitted: Fitted, wider: float) -> Iterator[Unknown]:
    for index, part in enumerate(candidate.hidden_objects):
        yield from (Unknown.about(index, "place", axis, wider * _STEP_M) for axis in range(3))
        if part.shape != "sphere":
            yield from (Unknown.about(index, "turn", axis, wider * _STEP_RAD) for axis in range(3))
        if fitted.sizes:
            yield from (
                Unknown.about(index, "size", axis, wider * _STEP_SIZE)
                for axis in range(len(stretches(part.shape)))
            )
    now = candidate.relay_wall.roughness
    if fitted.room:
        yield from (Unknown.about(0, "room", axis, _STEP_M) for axis in range(2))
    if fitted.roughness and now is not None:
        least, most = (limit - now for limit in ROUGHNESS)
        more = min(max(_STEP_ROUGHNESS, least + 2 * _STEP_ROUGHNESS), most)
        yield Unknown(0, "roughness", 0, (more, more - 2 * _STEP_ROUGHNESS))


def within_reach(candidate: Scene, numbers: Sequence[Unknown], change: Floats) -> Floats:
    """A change of the unknowns, shortened to what is likely to be better and can be."""
    reached = change.copy()
    for (_, kind), places in _groups(numbers).items():
        reached[places] = _shortened(reached[places], FARTHEST[kind])
        now = candidate.relay_wall.roughness
        if kind == "roughness" and now is not None:
            reached[places] = np.clip(now + reached[places], *ROUGHNESS) - now
    return reached


def changed(candidate: Scene, numbers: Sequence[Unknown], change: Floats) -> Scene:
    """The candidate with its unknowns changed."""
    parts, wall, middle = list(candidate.hidden_objects), candidate.relay_wall, candidate.middle_wall
    for (index, kind), places in _groups(numbers).items():
        values = np.zeros(3)
        values[[numbers[place].place for place in places]] = change[places]
        if kind == "place":
            parts[index] = moved(parts[index], values)
        elif kind == "turn":
            parts[index] = moved(parts[index], np.zeros(3), values)
        elif kind == "size":
            parts[index] = stretched(parts[index], values[: len(stretches(parts[index].shape))])
        elif kind == "room":
            by_m = values[0] * wall_normal(wall) + values[1] * wall_normal(middle)
            middle = replace(middle, location_m=vector(np.asarray(middle.location_m) + by_m))
        elif wall.roughness is not None:
            wall = replace(wall, roughness=float(np.clip(wall.roughness + values[0], *ROUGHNESS)))
    return replace(candidate, hidden_objects=tuple(parts), relay_wall=wall, middle_wall=middle)


def _groups(numbers: Sequence[Unknown]) -> dict[tuple[int, str], list[int]]:
    """Places of the unknowns of each object and kind."""
    groups: dict[tuple[int, str], list[int]] = {}
    for place, unknown in enumerate(numbers):
        groups.setdefault((unknown.part, unknown.kind), []).append(place)
    return groups


def moved(part: HiddenObject, by_m: Floats, turned_rad: Floats | None = None) -> HiddenObject:
    """Moved by a vector and then turned about its centre by a rotation vector, in world axes."""
    part = replace(part, location_m=vector(np.asarray(part.location_m) + by_m))
    if turned_rad is None or not turned_rad.any():
        return part
    axes = Rotation.from_rotvec(turned_rad).as_matrix() @ rotation_matrix(part.rotation_deg)
    return replace(part, rotation_deg=euler_deg(axes))


def stretched(part: HiddenObject, exponents: Floats) -> HiddenObject:
    """With its free extents (`stretches`) multiplied by the exponential of (n,) numbers."""
    return replace(part, size_m=vector(np.asarray(part.size_m) * np.exp(exponents @ stretches(part.shape))))


def stretches(shape: Shape) -> Floats:
    """(n, 3) which extents change together; a cube stays a cube, and what is round stays round."""
    if shape in ("cube", "sphere"):
        return np.ones((1, 3))
    if shape == "parallelepiped":
        return np.eye(3)
    return np.array([[1.0, 1, 0], [0, 0, 1]])


def _shortened(values: Floats, longest: float) -> Floats:
    length = math.sqrt(values @ values)
    return values if length <= longest else values * (longest / length)
