"""Whether the frequencies of a preset can represent every depth of its mirrored scenes."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from math import floor, gcd, hypot, log10
from types import MappingProxyType

import numpy as np
from scipy.constants import speed_of_light

from disk.frequency_text import megahertz
from disk.preset_files import PresetError
from disk.quantities import Extent
from scenegen.object_settings import HiddenObjectSettings
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


def turns_of_first_phase(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> int:
    """How often the phase at the first frequency turns over the depths of mirrored scenes; 1 represents all.

    The depths are those up to `largest_mirrored_depth_m`.
    """
    range_m = speed_of_light / (2 * preset.itof.frequencies_hz[0])
    return floor(largest_mirrored_depth_m(preset, meshes) * (1 + _ROUNDING) / range_m) + 1


def largest_mirrored_depth_m(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> float:
    """Upper bound of the distance between the camera and the mirror image of any hidden object, metres.

    That distance is the one between the camera's mirror image and the object. The bound is the largest one
    to the range of the objects' centres, at a corner of this box, plus the largest radius about a centre.
    It is attained if all rotations are allowed. With a spread of the camera, whose mirror image moves as far
    as the camera itself, half the diagonal of its box is added. A mesh that is not in `meshes` counts as the
    cube of its longest side.
    """
    mirrored_m = mirror_image(np.array(preset.camera.location_m), walls_of(preset)[0])  # (3,)
    settings = preset.hidden_object
    location = settings.location_m
    ranges = np.array([location.x, location.y, location.z])  # (3, 2)
    if settings.composite_fraction > 0:
        offset = np.array(settings.composite_offset_m) * settings.size_factor[1]
        ranges = ranges + np.array([min(offset[0], 0), max(offset[1], 0)])  # of the first and the second part
    corners = np.array(list(product(*ranges)))  # (8, 3)
    farthest_m = float(np.linalg.norm(corners - mirrored_m, axis=1).max())
    moved_m = 3**0.5 * preset.camera_spread.location_m
    return farthest_m + moved_m + largest_radius_m(preset, meshes)


def largest_radius_m(preset: Preset, meshes: Mapping[Shape, UnitMesh] = NO_MESHES) -> float:
    """Largest distance of a point of a hidden object from its centre, metres."""
    settings = preset.hidden_object
    return settings.size_factor[1] * max(_radius_m(settings, shape, meshes) for shape in settings.shapes)


def _radius_m(settings: HiddenObjectSettings, shape: Shape, meshes: Mapping[Shape, UnitMesh]) -> float:
    """Largest distance of a point of a shape from its centre, in its usual size, metres."""
    size_m: Extent = settings.size_m.of(shape)
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
