"""The arrays of an exported dataset: their names, number types, axes, units and meanings.

A row of every array is one scene. Axes: N scenes, H image rows from the top, W columns from the left, F
modulation frequencies. docs/reference/files.md describes the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

FORMAT: Final = "NIGHT dataset"
FORMAT_VERSION: Final = 1
ABOUT: Final = (
    "Look-behind-a-corner scenes: what an indirect time-of-flight camera measures of a wall, and the hidden "
    "object as a mirror in the place of the wall would show it. Row i of every array is scene i."
)
NO_ROUGHNESS: Final = -1.0  # in the column of a number that is above 0: a file of results holds no NaN


@dataclass(frozen=True)
class ArrayKind:
    """What the attributes of an array say: number type, axes, units and meaning."""

    dtype: type[np.generic]
    axes: str
    units: str
    description: str


_RADIANCE = (
    "W m^-2 sr^-1 for a projector of irradiance scale 1 (radiant intensity pi / cos^3 of the angle to its "
    "axis); renders of another program: their own unit"
)
_METRES, _NONE = "m", "1"
_PHASORS = (
    "complex iToF phasors of the measurement, {what}: the sum over this light of its radiance times "
    "exp(+2j pi f L / c), with its optical path length L (out and back) and the frequency f of frequencies_hz"
)
# Arrays of images, a row of which is a scene. The parts of the phasors are not in every render.
IMAGES: Final = {
    "phasors": ArrayKind(np.complex64, "N,H,W,F", _RADIANCE, _PHASORS.format(what="all light")),
    "direct_phasors": ArrayKind(
        np.complex64, "N,H,W,F", _RADIANCE, _PHASORS.format(what="one bounce on the relay wall")
    ),
    "hidden_phasors": ArrayKind(
        np.complex64, "N,H,W,F", _RADIANCE, _PHASORS.format(what="all light that met the hidden object")
    ),
    "mirrored_phasors": ArrayKind(
        np.complex64,
        "N,H,W",
        _NONE,
        "ground truth: complex phasor of the object's mirror image in the relay wall at the first of "
        "frequencies_hz, exp(+2j pi f 2 d / c) with the radial depth d; 0 on background",
    ),
    "radial_depth_m": ArrayKind(
        np.float32,
        "N,H,W",
        _METRES,
        "ground truth: distance of the object's mirror image from the camera along the ray of the pixel "
        "centre; 0 on background",
    ),
    "mask": ArrayKind(np.uint8, "N,H,W", _NONE, "ground truth: 1 on the hidden object, 0 on background"),
}
ROUGHNESS: Final = ArrayKind(
    np.float64,
    "N",
    _NONE,
    "alpha of the relay wall's material roughplastic, in (0, 1]; "
    f"{NO_ROUGHNESS:g} for a diffuse wall, which has none",
)
VIEWS: Final = ArrayKind(np.float64, "N", "degrees", "full horizontal field of view of the camera")
TEXT: Final = "text"  # their unit
TEXTS: Final = {
    "scene_id": "id of the scene in its dataset, six or more digits",
    "object_class": "shape of the hidden object, or composite",
    "split": "train, validation or test",
    "scene": "JSON: the scene as plain data (scene.json); lengths in metres, angles in degrees",
    "render": "JSON: recipe, provenance and files of the render (render.json); null for one without a record",
}
FREQUENCIES: Final = ArrayKind(np.float64, "F", "Hz", "modulation frequencies, ascending")
SPLIT_ROWS: Final = ArrayKind(np.int64, "rows", _NONE, "rows of the scenes of this split, ascending")
DOCUMENTS: Final = {
    "preset": "JSON: all settings of the scenes, as resolved when they were made; units are in the names",
    "provenance": "JSON: programs, versions and seed of the scenes, how they were rendered, licence",
    "left_out": "JSON: the scenes of the dataset that are not in this file, and why, by id",
}
