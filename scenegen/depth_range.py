"""Whether the frequencies of a preset can represent every depth of its mirrored scenes."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from math import floor, gcd, hypot, log10
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from disk.frequency_text import megahertz
from disk.preset_files import PresetError
from disk.quantities import Extent
from scenegen.object_settings import LocationRanges
from scenegen.object_tables import BesideObject, OffsetRanges
from scenegen.pose import mirror_image
from scenegen.preset import Preset
from scenegen.sampling import walls_of
from scenegen.shapes import Shape
from scenegen.unit_meshes import UnitMesh

NO_MESHES: Mapping[Shape, UnitMesh] = MappingProxyType({})
_ROUNDING = 1e-6  # relative, of float32 coordinates


def refuse_wrapping_depths(preset: Preset, meshes: Mapping[Shape, UnitMesh]) -> None:
    """Refuse a preset whose scenes can have mirrored depths that its frequencies together do not represent.

    With f their greatest common divisor, all phases of a depth d are those of d + c / 2f, too.

    Parameters
    ----------
    meshes : the mesh files that the preset's shapes name, by shape.

    Raises
    ------
    PresetError : a depth can be c / 2f or more.
    """
    depth_m, frequencies_hz = largest_mirrored_depth_m(preset, meshes), preset.itof.frequencies_hz
    range_m = speed_of_light / (2 * gcd(*map(round, frequencies_hz)))
    if range_m <= depth_m * (1 + _ROUNDING):
        raise PresetError(
            f"itof.frequencies_hz: {megahertz(*frequencies_hz)} can represent depths below {range_m:.4g} m, "
            f"and mirrored hidden objects can be up to {depth_m:.4g} m from the camera: put a lower "
            f"frequency first, at most {megahertz(_highest_hz(depth_m))}"
        )


def turns_of_first_phase(preset: Preset) -> int:
    """How often the phase at the first frequency turns over the depths of mirrored scenes; 1 represents all.

    The depths are those up to `largest_mirrored_depth_m`.
    """
    range_m = speed_of_light / (2 * preset.itof.frequencies_hz[0])
    return floor(largest_mirrored_depth_m(preset) * (1 + _ROUNDING) / range_m) + 1


def largest_mirrored_depth_m(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> float:
    """Upper bound of the distance between the camera and the mirror image of any hidden object, metres.

    That distance is the one between the camera's mirror image and the object. The bound is the largest one
    to the range of the objects' centres, at a corner of this box, plus the largest radius about a centre.
    It is attained if all rotations are allowed. With a spread of the camera, whose mirror image moves as far
    as the camera itself, half the diagonal of its box is added. A mesh that is not in `meshes` counts as the
    cube of its longest side.
    """
    mirrored_m = mirror_image(np.array(preset.camera.location_m), walls_of(preset)[0])  # (3,)
    moved_m = 3**0.5 * preset.camera_spread.location_m
    return moved_m + max(
        float(np.linalg.norm(np.array(list(product(*box))) - mirrored_m, axis=1).max()) + radius_m
        for box, radius_m in boxes(preset, meshes)
    )


def largest_radius_m(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> float:
    """Largest distance of a point of a hidden object from its centre, metres."""
    return max(radius_m for _, radius_m in boxes(preset, meshes))


def boxes(
    preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES
) -> list[tuple[NDArray[np.float64], float]]:
    """Boxes (3, 2) of the centres of hidden objects, metres, and the largest radius of those in each."""
    hidden = preset.hidden_object
    least, most = hidden.size_factor
    found = []
    for listed in preset.object:
        box = _box(listed.places_m(hidden.location_m))
        for thing in listed.things:
            offset = _box(thing.offset_m) if isinstance(thing, BesideObject) else np.zeros((3, 2))
            low, high = offset[:, 0], offset[:, 1]
            ends = np.stack([np.minimum(least * low, most * low), np.maximum(least * high, most * high)], 1)
            path = np.array(thing.path_m or ())
            centres = np.stack([path.min(axis=0), path.max(axis=0)], 1) if thing.path_m else box + ends
            radius_m = _radius_m(thing.name, thing.extent_m(hidden.size_m), meshes)
            found.append((centres, most * radius_m))
    if not found:
        box = _box(hidden.location_m)
        if hidden.pair_fraction > 0:
            low_m, high_m = hidden.composite_offset_m
            box = box + np.array([min(low_m * most, 0), max(high_m * most, 0)])  # of the first and the second
        radius_m = max(_radius_m(shape, hidden.size_m.of(shape), meshes) for shape in hidden.shapes)
        found.append((box, most * radius_m))
    return found


def _box(ranges: LocationRanges | OffsetRanges) -> NDArray[np.float64]:
    return np.array([ranges.x, ranges.y, ranges.z])


def _radius_m(shape: Shape, size_m: Extent, meshes: Mapping[Shape, UnitMesh]) -> float:
    """Largest distance of a point of a shape from its centre, metres."""
    x, y, z = size_m
    if shape in meshes:
        return meshes[shape].radius * x  # x is the longest side, which the mesh has as 1
    if shape == "sphere":
        return max(size_m) / 2
    if shape in ("cylinder", "cone"):
        return hypot(max(x, y), z) / 2
    return hypot(x, y, z) / 2


def _highest_hz(depth_m: float) -> float:
    """The highest frequency of three digits whose range contains `depth_m`."""
    limit_hz = speed_of_light / (2 * depth_m * (1 + _ROUNDING))
    digits = 2 - floor(log10(limit_hz))
    frequency_hz = floor(limit_hz * 10**digits) / 10**digits
    return frequency_hz if frequency_hz < limit_hz else frequency_hz - 10**-digits
