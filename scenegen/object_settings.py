"""Settings of the hidden objects: shapes, sizes, places, and how many there are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic.dataclasses import dataclass

from disk.contract import STRICT
from disk.quantities import LENGTH, Degrees, Extent, Fraction, Length, Metres, Reflectance, SizeFactor
from scenegen.shapes import MESH_PREFIX, PRIMITIVES, Shape


def _ascending(bounds: tuple[float, float]) -> tuple[float, float]:
    if bounds[0] > bounds[1]:
        raise ValueError(f"range [{bounds[0]:g}, {bounds[1]:g}] is empty: give the lower bound first")
    return bounds


def _range(given: Any) -> Any:
    """A number is the range of that number alone."""
    if isinstance(given, list):
        return tuple(given)
    is_number = isinstance(given, int | float) and not isinstance(given, bool)
    return (given, given) if is_number else given


_RANGE = (BeforeValidator(_range), AfterValidator(_ascending))
MetreRange = Annotated[tuple[Metres, Metres], *_RANGE]
DegreeRange = Annotated[tuple[Degrees, Degrees], *_RANGE]
FactorRange = Annotated[tuple[SizeFactor, SizeFactor], *_RANGE]
_ONE_SIZE = (1.0, 1.0)


def distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """The entries of a list, none of which may occur twice."""
    if len(set(values)) != len(values):
        raise ValueError("an entry occurs twice in the list")
    return values


@dataclass(frozen=True, config=STRICT)
class LocationRanges:
    """Range of the hidden object's centre along each world axis, metres."""

    x: MetreRange = (1.0, 1.3)
    y: MetreRange = (0.5, 1.3)
    z: MetreRange = (1.25, 1.95)


@dataclass(frozen=True, config=STRICT)
class RotationRanges:
    """Ranges of the hidden object's XYZ Euler angles, degrees."""

    x: DegreeRange = (-90.0, 90.0)
    y: DegreeRange = (-90.0, 90.0)
    z: DegreeRange = (-90.0, 90.0)


@dataclass(frozen=True, config=STRICT)
class ShapeSizes:
    """Extents of each primitive along its own axes, and the longest side of every mesh; metres.

    The paper gives only "up to 0.5 m³", which is ambiguous. With these sizes, the ratio of background to
    object pixels is near that of the released training log (docs/science/design.md, Primitive sizes). The
    extents of the concave plane are sagitta, chord and
    height of an arc of radius 0.35 m over ±1 rad, 0.6 m high.
    """

    cube: Extent = (0.5, 0.5, 0.5)
    cylinder: Extent = (0.4, 0.4, 0.55)
    sphere: Extent = (0.56, 0.56, 0.56)
    cone: Extent = (0.56, 0.56, 0.55)
    concave_plane: Extent = (0.1609, 0.589, 0.6)
    parallelepiped: Extent = (0.3, 0.3, 0.6)
    mesh: Length = 0.5

    def of(self, shape: Shape) -> Extent:
        """Extents of a primitive along x, y and z, metres; for a mesh, its longest side three times."""
        if shape.startswith(MESH_PREFIX):
            return (self.mesh, self.mesh, self.mesh)
        size: Extent = getattr(self, shape)
        return size


@dataclass(frozen=True, config=STRICT)
class HiddenObjectSettings:
    """Shapes, places, rotations, sizes and reflectance of the hidden objects.

    The fraction `empty_fraction` of the scenes has no object: these are empty corners. Of the others, the
    fraction `composite_fraction` has two different shapes, if there are two; the second one is displaced by
    `composite_offset_m` (per axis) and turned by `composite_rotation_deg` (per angle) against the first.
    If there is a `least_reflectance`, each scene draws one reflectance for all of its objects, evenly between
    that and `reflectance`. Each scene draws one factor by which `size_m` and the offset of its second shape
    are multiplied, evenly in the logarithm: from 0.5 to 1 there are as many as from 1 to 2, as no size is
    the natural one.
    """

    shapes: Annotated[tuple[Shape, ...], Field(min_length=1), AfterValidator(distinct)] = PRIMITIVES
    composite_fraction: Fraction = 0.142857
    location_m: LocationRanges = LocationRanges()
    rotation_deg: RotationRanges = RotationRanges()
    composite_offset_m: MetreRange = (-0.12, 0.15)
    composite_rotation_deg: DegreeRange = (-45.0, 45.0)
    size_m: ShapeSizes = ShapeSizes()
    reflectance: Reflectance = 1.0
    least_reflectance: Annotated[Reflectance | None, Field(exclude_if=lambda value: value is None)] = None
    # Left out of files where they change nothing, so that datasets without them keep their bytes.
    size_factor: Annotated[FactorRange, Field(exclude_if=lambda value: value == _ONE_SIZE)] = _ONE_SIZE
    empty_fraction: Annotated[Fraction, Field(exclude_if=lambda value: value == 0)] = 0.0

    @property
    def pair_fraction(self) -> float:
        """Fraction of composites among the scenes with objects."""
        return self.composite_fraction if len(self.shapes) > 1 else 0.0

    @property
    def has_one_size(self) -> bool:
        """Whether all objects of a shape have the same size."""
        return self.size_factor == _ONE_SIZE

    def __post_init__(self) -> None:
        self.refuse_sizes(side for shape in self.shapes for side in self.size_m.of(shape))

    def refuse_sizes(self, extents_m: Iterable[float]) -> None:
        """Refuse extents, metres, that become none by a factor that scenes may draw (`ValueError`)."""
        sizes_m = list(extents_m) or [1.0]
        for size_m, factor in ((min(sizes_m), self.size_factor[0]), (max(sizes_m), self.size_factor[1])):
            problem = LENGTH.problem(size_m * factor)
            if problem:
                raise ValueError(f"size_factor = {factor:g}, times an extent of {size_m:g} m, {problem}")
