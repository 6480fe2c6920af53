"""The tables [[object]] of a preset: objects by file or shape, each with its own size, place and turn."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from disk.preset_files import PresetError
from disk.quantities import Extent, Location, LongestOrSides, Reflectance, Rotation, Vector
from scenegen.object_settings import LocationRanges, MetreRange, RotationRanges, ShapeSizes
from scenegen.shapes import MESH_PREFIX, PRIMITIVES, Shape, known_shape

Unit = Literal["m", "cm", "mm"]
Path = tuple[Vector, ...]  # waypoints
UpAxis = Literal["y", "z"]
METRES: Final[dict[Unit, float]] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_MOST_WAYPOINTS: Final = 100_000
_OF_PATHS: Any = Field(  # left out of files where it is None
    min_length=2, max_length=_MOST_WAYPOINTS, exclude_if=lambda value: value is None
)


def _mesh_file(file: str) -> str:
    known_shape(MESH_PREFIX + file)
    return file


def _primitive(shape: str) -> str:
    if shape not in PRIMITIVES:
        raise ValueError(f"no such shape: give {', '.join(PRIMITIVES)}, or a mesh by its file")
    return shape


@dataclass(frozen=True, config=STRICT)
class Thing:
    """A mesh file of the user, relative to the preset's folder, or a primitive; all else may be missing.

    Attributes
    ----------
    size_m : longest side, metres, or all three of a primitive; None for those of `ShapeSizes`.
    unit : of the mesh's coordinates, in place of `size_m`. Whoever reads the mesh puts `size_m` in its place.
    up : axis of the mesh that becomes the scene's z; None for z, and for y in a GLB file.
    rotation_deg : as `HiddenObjectSettings.rotation_deg`, which None takes.
    reflectance : times that of `HiddenObjectSettings`.
    path_m : waypoints of its centre over a sequence, at equal steps of time, joined by straight lines.
    path_deg : the same for its angles, in place of `rotation_deg`.
    """

    file: Annotated[str, AfterValidator(_mesh_file)] | None = None
    shape: Annotated[str, AfterValidator(_primitive)] | None = None
    size_m: LongestOrSides | None = None
    unit: Unit | None = None
    up: UpAxis | None = None
    rotation_deg: RotationRanges | None = None
    reflectance: Reflectance = 1.0
    path_m: Annotated[tuple[Location, ...] | None, _OF_PATHS] = None
    path_deg: Annotated[tuple[Rotation, ...] | None, _OF_PATHS] = None

    def __post_init__(self) -> None:
        if self.path_deg and self.rotation_deg:
            raise ValueError("give path_deg or rotation_deg, not both")
        if (self.file is None) == (self.shape is None):
            raise ValueError("an object has either a file or a shape")
        if self.file is None and (self.unit or self.up):
            raise ValueError("unit and up are for a mesh file, not for a shape: give its size_m")
        if self.unit and self.size_m is not None:
            raise ValueError("give the unit of the mesh or its size_m, not both")
        if self.file and isinstance(self.size_m, tuple):
            raise ValueError("a mesh keeps its shape: size_m is its longest side, one number")

    @property
    def name(self) -> Shape:
        """Its shape in scenes."""
        return self.shape or f"{MESH_PREFIX}{self.file}"

    def extent_m(self, sizes: ShapeSizes) -> Extent:
        """Its extents as those of a hidden object of a scene.

        Raises
        ------
        PresetError : they are those of a mesh that is not read yet.
        """
        if self.unit:
            raise PresetError(
                f"object {self.file} has its size from its mesh, which is not read here: give its size_m"
            )
        if isinstance(self.size_m, tuple):
            return self.size_m
        usual_m = sizes.of(self.name)
        if self.size_m is None:
            return usual_m
        x, y, z = (side * self.size_m / max(usual_m) for side in usual_m)
        return (x, y, z)


@dataclass(frozen=True, config=STRICT)
class OffsetRanges:
    """Ranges of a place relative to another one, along the world axes, metres."""

    x: MetreRange = (0.0, 0.0)
    y: MetreRange = (0.0, 0.0)
    z: MetreRange = (0.0, 0.0)


@dataclass(frozen=True, config=STRICT)
class BesideObject(Thing):
    """An object that is in a scene with another one, whose centre its own is `offset_m` from.

    In a sequence, one without `path_m` moves with the other, but does not turn with it.
    """

    offset_m: OffsetRanges = OffsetRanges()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path_m and self.offset_m != OffsetRanges():
            raise ValueError("give path_m or offset_m, not both")


@dataclass(frozen=True, config=STRICT)
class ListedObject(Thing):
    """An object, and those that are beside it in its scenes.

    Attributes
    ----------
    location_m : as `HiddenObjectSettings.location_m`, which None takes.
    """

    location_m: LocationRanges | None = None
    beside: tuple[BesideObject, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path_m and self.location_m:
            raise ValueError("give path_m or location_m, not both")

    def places_m(self, usual: LocationRanges) -> LocationRanges:
        """Ranges of its centre: around its path, its own or the usual ones."""
        return LocationRanges(*_around(self.path_m)) if self.path_m else self.location_m or usual

    def turns_deg(self, usual: RotationRanges) -> RotationRanges:
        """The same of its angles."""
        return RotationRanges(*_around(self.path_deg)) if self.path_deg else self.rotation_deg or usual

    def offsets_m(self, beside: BesideObject, usual: LocationRanges) -> OffsetRanges:
        """Ranges of the centre of an object beside it, relative to its own."""
        if not beside.path_m:
            return beside.offset_m
        own = self.places_m(usual)
        both = zip(_around(beside.path_m), (own.x, own.y, own.z), strict=True)
        return OffsetRanges(*((low - own_high, high - own_low) for (low, high), (own_low, own_high) in both))

    @property
    def things(self) -> tuple[Thing, ...]:
        """The object itself, then those beside it."""
        return (self, *self.beside)

    @property
    def class_name(self) -> str:
        """Class of its scenes."""
        return " + ".join(thing.name for thing in self.things)


def on_path(path: Path, frame: int, count: int) -> Vector:
    """Place of a path in one of `count` frames; the first is at its start, the last at its end."""
    last = max(count - 1, 1)
    leg, rest = divmod(frame * (len(path) - 1), last)  # whole numbers: a frame on a waypoint is exactly there
    start, end = path[leg], path[min(leg + 1, len(path) - 1)]
    x, y, z = (a + (b - a) * rest / last for a, b in zip(start, end, strict=True))
    return (x, y, z)


def _around(path: Path) -> list[tuple[float, float]]:
    """Smallest and largest value of each axis."""
    return [(min(axis), max(axis)) for axis in zip(*path, strict=True)]
