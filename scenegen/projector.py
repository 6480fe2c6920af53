"""A projector with a place, a field of view or dots of its own: its settings, and its image."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from disk.quantities import BeamAngle, Location, Rotation

_MOST_TEXELS = 2**24
_TEXELS = 2  # along a dot: Mitsuba enlarges images of one row or column, and with them their aspect ratio

Dots = tuple[Annotated[int, Field(ge=1, le=10_000)], Annotated[int, Field(ge=1, le=10_000)]]
Spacing = Annotated[int, Field(ge=1, le=1001)]


@dataclass(frozen=True, config=STRICT)
class ProjectorSettings:
    """The projector of all scenes. What is not given is that of the camera, and goes with it.

    Attributes
    ----------
    horizontal_fov_deg : of the projector's image, degrees.
    location_m, rotation_deg : pose in the room, as of the camera.
    dots : columns and rows of square dots, which fill the image and so give its aspect ratio: ``[1, 1]`` is a
        spot, ``[200, 1]`` a line. Not given: evenly lit, with the camera's aspect ratio.
    spacing : of the dots from middle to middle, in widths of a dot; an odd number. 1 leaves no gaps.
    """

    horizontal_fov_deg: BeamAngle | None = None
    location_m: Location | None = None
    rotation_deg: Rotation | None = None
    dots: Dots | None = None
    spacing: Spacing = 1

    def __post_init__(self) -> None:
        check_dots(self.dots, self.spacing)


def check_dots(dots: Dots | None, spacing: int) -> None:
    """Refuse a pattern that no image can show.

    Raises
    ------
    ValueError : an even spacing, a spacing without dots, or an image of more than 16 million texels.
    """
    if spacing % 2 == 0:
        raise ValueError(f"spacing must be odd, so that a dot is in the middle of its cell: got {spacing}")
    if dots is None and spacing > 1:
        raise ValueError("spacing is that of dots: give dots, too")
    if dots is not None and dots[0] * dots[1] * (_TEXELS * spacing) ** 2 > _MOST_TEXELS:
        raise ValueError(f"an image of {dots[0]} x {dots[1]} dots with the spacing {spacing} is too large")


def dots_image(dots: Dots, spacing: int) -> NDArray[np.float64]:
    """(H, W) 1 in the dots, 0 elsewhere."""
    cell = np.zeros((spacing, spacing))
    cell[spacing // 2, spacing // 2] = 1
    return np.tile(cell, dots[::-1]).repeat(_TEXELS, axis=0).repeat(_TEXELS, axis=1)
