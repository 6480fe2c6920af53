"""How the primitives hide light: each is a quadric in its unit box. Plain numbers, for arrays and kernels."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from scenegen.shapes import Shape
from scenegen.unit_meshes import ARC_DEPTH, ARC_WIDTH


class Hiding(IntEnum):
    """What of a unit box hides light.

    BOX : all of it.
    SOLID : where the quadric is not above 0.
    SHEET : where the quadric is 0.
    MESH : triangles, which rays find.
    """

    BOX = 0
    SOLID = 1
    SHEET = 2
    MESH = 3


# x², y², z², x, z and 1 of the quadric.
Quadric = tuple[float, float, float, float, float, float]
NO_QUADRIC: Final[Quadric] = (0, 0, 0, 0, 0, 0)
_ARC: Final[Quadric] = (  # ((x + 1/2) / depth - 1)² + (y / width)² = 1
    *(1 / ARC_DEPTH**2, 1 / ARC_WIDTH**2, 0),
    *((1 - 2 * ARC_DEPTH) / ARC_DEPTH**2, 0, (0.25 - ARC_DEPTH) / ARC_DEPTH**2),
)
_PRIMITIVES: Final[dict[Shape, tuple[Quadric, Hiding]]] = {
    "cube": (NO_QUADRIC, Hiding.BOX),
    "parallelepiped": (NO_QUADRIC, Hiding.BOX),
    "sphere": ((1, 1, 1, 0, 0, -0.25), Hiding.SOLID),
    "cylinder": ((1, 1, 0, 0, 0, -0.25), Hiding.SOLID),
    "cone": ((1, 1, -0.25, 0, 0.25, -0.0625), Hiding.SOLID),  # radius (1/2 - z) / 2
    "concave_plane": (_ARC, Hiding.SHEET),
}


def quadric_of(shape: Shape) -> tuple[Quadric, Hiding]:
    """The quadric of a shape, and how it hides light."""
    return _PRIMITIVES.get(shape, (NO_QUADRIC, Hiding.MESH))


def is_convex(shape: Shape) -> bool:
    """Whether a shape is a convex solid, which hides no light from itself."""
    return quadric_of(shape)[1] in (Hiding.BOX, Hiding.SOLID)
