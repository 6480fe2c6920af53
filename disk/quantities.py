"""Bounds of the numbers in files, with their units. Each kind of number has them here only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Discriminator, Field, GetCoreSchemaHandler, Tag
from pydantic_core import core_schema


@dataclass(frozen=True)
class Bounds:
    """Least and largest value of a number, and its unit; as the annotation of a type, pydantic checks them.

    Attributes
    ----------
    below, above : advice for a number out of the bounds.
    """

    least: float
    most: float
    unit: str = ""
    below: str = ""
    above: str = ""

    def problem(self, value: float) -> str | None:
        """Why a number is refused, as a predicate; None if it is within the bounds."""
        if self.least <= value <= self.most:
            return None
        unit, given = f" {self.unit}" if self.unit else "", f"{value:.10g}"
        advice = self.below if value < self.least else self.above
        ending = f": {advice}" if advice else ""
        return f"must be {self.least:g} to {self.most:g}{unit} (got {given}){ending}"

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, value: float) -> float:
        problem = self.problem(value)
        if problem:
            raise ValueError(problem)
        return value


FARTHEST_M = 1000
MIN_FOV_DEG, MAX_FOV_DEG = 1.0, 170.0  # also least of an image that is imported
LENGTH = Bounds(1e-4, 1000, "m")  # float32 coordinates cannot hold thinner objects
FREQUENCY = Bounds(1e6, 1e10, "Hz", below="give Hz, as 20e6 for 20 MHz")  # cameras modulate within
TRANSMITTED = Bounds(1e-6, 1)  # part of the light or of its electrons
BIN_WIDTH = Bounds(1e-9, 1e6, "m")  # of a transient file of any program; those of presets are a `Length`
JOB_MEMORY = Bounds(1e8, 1e15, "bytes", below="give it with a unit, like 32GB")
JOB_COUNT = Bounds(1, 1e6)

# Without a unit.
WholeCount = Annotated[int, Field(ge=1, le=1_000_000_000)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Positive = Annotated[float, Bounds(1e-37, 1e37)]  # float32 holds them
NotNegative = Annotated[float, Bounds(0, 1e12)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Reflectance = Annotated[float, Field(ge=0, le=1)]
RelativeError = Annotated[float, Bounds(1e-6, 1)]
Roughness = Annotated[float, Bounds(1e-4, 1)]
Transmitted = Annotated[float, TRANSMITTED]
FNumber = Annotated[float, Bounds(0.1, 1000)]
CosinePower = Annotated[float, Bounds(0, 100)]
DutyCycle = Annotated[float, Bounds(0.001, 0.999)]
SpreadOverWidth = Annotated[float, Bounds(1e-4, 10)]
TapMismatch = Annotated[float, Bounds(-0.99, 0.99)]
SizeFactor = Annotated[float, Bounds(0.01, 100)]
ClassName = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]+$")]  # a shape, or a mesh's file

# Lengths and angles.
_Coordinate = Annotated[float, Bounds(-1e6, 1e6)]  # metres or degrees, also beyond those of presets
Vector = tuple[_Coordinate, _Coordinate, _Coordinate]
Metres = Annotated[float, Bounds(-FARTHEST_M, FARTHEST_M, "m")]
Distance = Annotated[float, Bounds(0, FARTHEST_M, "m")]
Length = Annotated[float, LENGTH]
LampOffset = Annotated[float, Bounds(-0.5, 0.5, "m")]
CameraMove = Annotated[float, Bounds(0, 100, "m")]
Degrees = Annotated[float, Bounds(-360, 360, "degrees")]
QuarterTurn = Annotated[float, Bounds(0, 90, "degrees")]
HalfTurn = Annotated[float, Bounds(0, 180, "degrees")]
WholeTurn = Annotated[float, Bounds(0, 360, "degrees")]
FieldOfView = Annotated[float, Bounds(MIN_FOV_DEG, MAX_FOV_DEG, "degrees")]
BeamAngle = Annotated[float, Bounds(0.05, MAX_FOV_DEG, "degrees")]  # of a projector
Radians = Annotated[
    float,
    Bounds(-4 * math.pi, 4 * math.pi, "radians", *["give radians, not degrees"] * 2),
]
PhaseSpread = Annotated[float, Bounds(0, 4 * math.pi, "radians", above="give radians, not degrees")]
PhaseDeviation = Annotated[float, Bounds(1e-5, 10, "radians")]
Extent = tuple[Length, Length, Length]
LongestOrSides = Annotated[
    Annotated[Length, Tag("number")] | Annotated[Extent, Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]
Location = tuple[Metres, Metres, Metres]
Rotation = tuple[Degrees, Degrees, Degrees]

# Light, and what a sensor makes of it.
Frequency = Annotated[float, FREQUENCY]
Wavelength = Annotated[float, Bounds(300, 1100, "nm")]
Power = Annotated[float, Bounds(1e-9, 1e6, "W")]
Irradiance = Annotated[float, Bounds(0, 1e6, "W/m²")]
PixelPitch = Annotated[float, Bounds(0.01, 1e6, "µm")]
FullWell = Annotated[float, Bounds(1, 1e12, "electrons")]
Electrons = Annotated[float, Bounds(0, 1e12, "electrons")]
ElectronRate = Annotated[float, Bounds(0, 1e12, "electrons per second")]
ElectronsPerNumber = Annotated[float, Bounds(1e-6, 1e12, "electrons per DN")]
ConverterOffset = Annotated[float, Bounds(0, 1e12, "DN")]
ConverterNumber = Annotated[float, Bounds(1e-6, 1e12, "DN")]

# Times and speeds.
FrameRate = Annotated[float, Bounds(1e-3, 1e6, "Hz")]
Speed = Annotated[float, Bounds(-10, 10, "m/s")]
RiseTime = Annotated[float, Bounds(0, 1e-6, "s")]
IntegrationTime = Annotated[float, Bounds(1e-12, 1e3, "s")]
ExposureTime = Annotated[float, Bounds(1e-12, 1e6, "s")]
Minutes = Annotated[float, Bounds(0, 1e9, "minutes")]

# Places in an image.
FocalLength = Annotated[float, Bounds(1e-3, 1e6, "pixels")]
PixelPlace = Annotated[float, Bounds(-1e6, 1e6, "pixels")]
Distortion = Annotated[float, Bounds(-1e3, 1e3)]
WeakDistortion = Annotated[float, Bounds(-1, 1)]


def fov_problem(fov_deg: float) -> str | None:
    """Why no camera has this horizontal field of view, degrees, as a sentence; None if one may have it."""
    if MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
        return None
    return f"no camera sees {fov_deg:g} degrees: the field of view is {MIN_FOV_DEG:g} to {MAX_FOV_DEG:g}"
