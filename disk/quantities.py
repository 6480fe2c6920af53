"""Bounds of the numbers in files: counts, lengths, angles, shares. Each kind of number has them here only."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

WholeCount = Annotated[int, Field(ge=1, le=1_000_000_000)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # metres or degrees, also beyond those of presets
FARTHEST_M = 1000
Vector = tuple[_Coordinate, _Coordinate, _Coordinate]
Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Length = Annotated[float, Field(ge=1e-4, le=1000)]  # metres; float32 coordinates cannot hold thinner objects
Extent = tuple[Length, Length, Length]
Location = tuple[Metres, Metres, Metres]
Rotation = tuple[Degrees, Degrees, Degrees]
Reflectance = Annotated[float, Field(ge=0, le=1)]
ClassName = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]  # a shape, or a mesh's file
Roughness = Annotated[float, Field(gt=0, le=1)]
MIN_FOV_DEG, MAX_FOV_DEG = 1.0, 170.0  # also least of an image that is imported
FieldOfView = Annotated[float, Field(ge=MIN_FOV_DEG, le=MAX_FOV_DEG)]  # degrees


def fov_problem(fov_deg: float) -> str | None:
    """Why no camera has this horizontal field of view, degrees, as a sentence; None if one may have it."""
    if MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
        return None
    return f"no camera sees {fov_deg:g} degrees: the field of view is {MIN_FOV_DEG:g} to {MAX_FOV_DEG:g}"
