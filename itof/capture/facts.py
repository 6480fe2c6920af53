"""What a capture tells about itself beside its phasors, as plain data for the record of an import."""

from __future__ import annotations

import math
from typing import Annotated, Final

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from disk.counted import counted
from disk.quantities import FieldOfView, Fraction

LARGEST_RAD: Final = 7.0  # of a noise or a drift; phases differ by at most 2 pi
_MOST_DECIMALS = 4  # of milliradians

Count = Annotated[int, Field(ge=1, le=2**31)]
Phases = Annotated[
    tuple[Annotated[float, Field(ge=0, le=LARGEST_RAD)], ...], Field(min_length=1, max_length=16)
]


@dataclass(frozen=True, config=STRICT)
class CaptureFacts:
    """Numbers of a capture.

    Attributes
    ----------
    frames : that were averaged.
    sensor_size, image_size : width and height, pixels.
    horizontal_fov_deg : of the image, degrees.
    noise_rad : noise of the middle pixel's phase in the mean at each frequency, radians, without that of the
        dark frames; None for one frame.
    drift_rad : largest less smallest phase of a frame at each frequency, common to all pixels, radians.
    saturated, dead : parts of the sensor pixels, 0 to 1.
    empty_pixels : part of the image pixels that hold nothing, 0 to 1.
    """

    frames: Count
    sensor_size: tuple[Count, Count]
    image_size: tuple[Count, Count]
    horizontal_fov_deg: FieldOfView
    noise_rad: Phases | None
    drift_rad: Phases
    saturated: Fraction
    dead: Fraction
    empty_pixels: Fraction

    @property
    def sentences(self) -> tuple[str, ...]:
        """The numbers as text."""
        width, height = self.image_size
        binned = (
            "" if self.image_size == self.sensor_size else "binned from {}x{}, ".format(*self.sensor_size)
        )
        frames = f"{counted(self.frames, 'frame')} of {width}x{height} pixels"
        told = [f"{frames}, {binned}{self.horizontal_fov_deg:.4g} degrees wide"]
        if self.noise_rad is not None:
            told.append(f"noise of a pixel: {milliradians(self.noise_rad)}; hidden light is 1 to 3 mrad")
        if self.saturated or self.dead:
            told.append(
                f"left out: {100 * self.saturated:.2g} % of the sensor pixels are saturated, "
                f"{100 * self.dead:.2g} % dead"
            )
        return tuple(told)


def milliradians(phases_rad: tuple[float, ...]) -> str:
    """Phases as text with two digits each, or whole milliradians: ``0.12, 1.0, 1402 mrad``."""
    return ", ".join(_two_digits(1e3 * phase_rad) for phase_rad in phases_rad) + " mrad"


def _two_digits(number: float) -> str:
    rounded = abs(float(f"{number:.1e}"))
    if rounded < 10.0**-_MOST_DECIMALS:
        return "0"
    decimals = min(max(1 - math.floor(math.log10(rounded)), 0), _MOST_DECIMALS)
    return f"{number:.{decimals}f}"
