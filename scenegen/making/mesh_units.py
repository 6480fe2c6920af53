"""Unit and up axis of the user's meshes: what formats say, and what looks wrong."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from scenegen.object_settings import RotationRanges
from scenegen.object_tables import METRES, Thing, Unit, UpAxis

Sides = tuple[float, float, float]
_TALLER: Final = 1.2  # than high: what may lie on its back
_UPRIGHT_DEG: Final = 45.0  # most that objects with an up axis turn about the others
_LIKELY_M: Final = (0.05, 3.0)  # longest side of things that are behind a corner


def default_up(file: str) -> UpAxis:
    """The axis that is up in a file that does not say it: glTF has y, most others z."""
    return "y" if _is_gltf(file) else "z"


def default_unit(file: str) -> Unit | None:
    """The unit of a format; None if it has none.

    Source: Khronos glTF 2.0 specification, sec. 3.4 (metres, +Y up).
    """
    return "m" if _is_gltf(file) else None


def mesh_size_m(unit: Unit, sides: Sides) -> float:
    """Longest side, metres."""
    return METRES[unit] * max(sides)


def doubts(thing: Thing, unit: Unit | None, sides: Sides, turns: RotationRanges) -> Iterator[str]:
    """What looks wrong of a mesh, with its numbers and the key that corrects it, as sentences.

    Parameters
    ----------
    unit : of the coordinates; None if the size is given.
    sides : of its bounding box in the unit of the file, with z up.
    turns : of the object; one that turns any way has no up.
    """
    _, depth, height = sides
    stands = max(map(abs, (*turns.x, *turns.y))) <= _UPRIGHT_DEG
    if stands and thing.up is None and default_up(str(thing.file)) == "z" and depth > _TALLER * height:
        yield (
            f"mesh {thing.file} is {depth:.3g} long along y and {height:.3g} high along z: if it lies on its "
            'back, its y axis is up, and [[object]] needs up = "y" (else up = "z")'
        )
    if unit is None:
        return
    size_m, (least_m, most_m) = mesh_size_m(unit, sides), _LIKELY_M
    if not least_m <= size_m <= most_m:
        others = {u: mesh_size_m(u, sides) for u in METRES if least_m <= mesh_size_m(u, sides) <= most_m}
        metres = "" if unit == "m" else f", which is {size_m:.4g} m"
        said = " or ".join(f'unit = "{other}" makes it {there_m:.3g} m' for other, there_m in others.items())
        yield (
            f"mesh {thing.file} has a longest side of {max(sides):.4g} {unit}{metres}: "
            f"{said or 'give its size_m'} in [[object]]"
        )


def _is_gltf(file: str) -> bool:
    return file.lower().endswith(".glb")
