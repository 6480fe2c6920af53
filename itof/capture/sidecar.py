"""The sidecar of a capture: what a file of raw frames does not say about itself."""

from __future__ import annotations

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import AliasChoices, Field
from pydantic.dataclasses import dataclass

from disk import NightError
from disk.contract import STRICT
from disk.quantities import (
    Bounds,
    ConverterNumber,
    Distortion,
    ExposureTime,
    FieldOfView,
    FocalLength,
    Fraction,
    Frequency,
    PhaseDeviation,
    PixelPlace,
    Radians,
)
from itof.binary_fields import fields_of
from itof.capture.formulas import names_in
from itof.capture.phase_steps import phasor_weights
from itof.light import OFFSET_STD_RAD

AXES: Final = ("frame", "frequency", "step", "tap", "row", "column")
CALIBRATION_FILE: Final = ("calibration_file", "dark_file")  # the second is that of earlier sidecars
BIN: Final = "bin"  # axis of histograms, which phasors take the place of
MOST_FREQUENCIES = 16
_FEW_BITS = 8
TOO_COARSE: Final = (
    "8-bit numbers are too coarse for hidden light, and often a picture for people: give raw frames of at "
    "least 10 bits"
)

Layout = Literal[
    "taps", "differences", "phasors", "amplitude-phase", "amplitude-depth", "histograms", "depth"
]
Name = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f]+$")]
Axis = Annotated[str, Field(max_length=60, pattern=r"^[a-z]+(\*[a-z]+)*$")]
Names = Annotated[tuple[Name, ...], Field(max_length=256)]
Angles = Annotated[tuple[Radians, ...], Field(max_length=64)]
Count = Annotated[int, Field(ge=1, le=64)]
Side = Annotated[int, Field(ge=1, le=2**20)]
Pixel = Annotated[int, Field(ge=0, le=2**14)]


class CaptureError(NightError):
    """A capture or its sidecar cannot be used: a file, a key or the frames themselves are wrong."""


@dataclass(frozen=True, config=STRICT)
class Lens:
    """Distortion of a lens by Brown and Conrady, as OpenCV calibrates it.

    With x, y the direction of a ray at z = 1 (right, down) and r² = x² + y², the pixel that sees it is at
    the column cx + fx (x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)) and the row
    cy + fy (y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y).

    Attributes
    ----------
    fx, fy : focal lengths, pixels of the sensor.
    cx, cy : principal point, pixels; the centre of the upper left pixel is at 0, 0.
    k1, k2, k3 : radial distortion.
    p1, p2 : tangential distortion.
    maps_to : ``pixel`` if the equation leads from a ray to its pixel; ``ray`` if the coefficients lead from
        the place of a pixel, (column - cx) / fx and (row - cy) / fy, to its ray.

    Source: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32, 1966.
    """

    fx: FocalLength
    fy: FocalLength
    cx: PixelPlace
    cy: PixelPlace
    k1: Distortion = 0.0
    k2: Distortion = 0.0
    k3: Distortion = 0.0
    p1: Distortion = 0.0
    p2: Distortion = 0.0
    maps_to: Literal["pixel", "ray"] = "pixel"


@dataclass(frozen=True, config=STRICT)
class Binary:
    """How bare numbers lie in a file without a format of its own.

    Attributes
    ----------
    fields : what a record holds, one after the other: ``NAME TYPE [SIDExSIDE] [stride BYTES]``
        (`itof.binary_fields.fields_of`). Records follow each other to the end of the file.
    shape : records of a frame; by default one. Arrays have the axes (frame, shape, sides).
    header : bytes before the first record.
    """

    fields: Annotated[tuple[Name, ...], Field(min_length=1, max_length=64)]
    shape: Annotated[tuple[Side, ...], Field(max_length=4)] = ()
    header: Annotated[int, Field(ge=0, le=2**40)] = 0

    def __post_init__(self) -> None:
        fields_of(self.fields)


@dataclass(frozen=True, config=STRICT)
class Sidecar:
    """What the frames of a capture mean.

    Attributes
    ----------
    layout : ``taps`` (numbers of each tap in each raw frame), ``differences`` (of two taps, DCS),
        ``phasors``, ``amplitude-phase``, ``amplitude-depth``, ``histograms`` of single photons, or ``depth``:
        one for all frequencies, which is refused, because the hidden light is lost.
    arrays : names of the arrays in the file, or of the channels of an ``.exr``: taps, differences, phasors
        (or their real parts), phases or depths. Several arrays are stacked along `stacked_along`. The array
        of a file without names is ``array``. Each name can be a formula (`itof.capture.formulas`).
    binary : how the arrays lie in a file without a format of its own.
    most_nan : largest part of an array that may be NaN or infinite; these pixels count as dead.
    window : left column, upper row, width and height of the part of the sensor that is used, pixels. The
        image becomes that of a camera that is turned to the middle of the window, as wide as this allows.
    amplitude_arrays : the same for the amplitudes of the two last layouts.
    imaginary_arrays : the same for the imaginary parts, if `arrays` are the real parts of phasors.
    stacked_along : ``frame``, ``frequency``, ``step`` or ``tap``.
    axes : order of the axes of each array, of frame, frequency, step, tap, row and column. An axis of size
        one may be left out. ``frequency*step`` is one axis with all steps of the first frequency first.
    bin_width_s : of ``histograms``, whose axis is ``bin``: seconds of the time of flight. Phasors at
        `frequencies_hz` take their place; bin 0 begins when the light leaves the camera.
    files : ``together`` if each file holds all frequencies; ``frequencies`` if the files are given frequency
        by frequency, in the order of `frequencies_hz`; ``steps`` if, for each of them, they
        are given step by step.
    frequencies_hz : modulation frequencies in the order of the arrays, Hz.
    horizontal_fov_deg : full horizontal field of view of the pinhole camera that the image is or becomes,
        degrees.
    step_count : number of phase steps, which divide the period evenly: 0, 2π/N, ...
    steps_rad : the phase steps instead, radians: a tap is brightest for light whose phase is that of the
        step.
    tap_count, taps_rad : the same for the taps of a pixel: their phases beside that of the step. Two taps are
        half a period apart.
    phase_sign : 1 if the phases that result grow with distance; -1 if they fall.
    phase_offsets_rad : what the camera adds to the phases at each frequency, radians; it is subtracted.
    phase_offset_arrays : arrays of the same for each pixel, radians; several are those of the frequencies.
        Their axes are those of `axes` without frame, step and tap.
    phase_offsets_std_rad : how well this is known, standard deviations; the default of 0.1 is that of a
        camera that its maker calibrated. A wall's distance is as uncertain as they make it.
    phase_unit : of ``amplitude-phase``: ``rad``, ``deg``, or ``dn`` with `phase_period_dn` numbers per
        period.
    depth_unit : of ``amplitude-depth``: ``m`` or ``mm``.
    depth_along : ``ray`` of the pixel, or optical ``axis``.
    dark_arrays : names of the arrays of dark frames, which are averaged and subtracted; they have the axes of
        `arrays`, or `dark_axes`.
    calibration_file : file in the folder of the sidecar with arrays that the files of the frames do not have.
    exposures_s : exposure time of each frame, seconds, if they differ; or `exposure_array`, the name of an
        array with them.
    saturation_dn : numbers that reach it, also negative ones, are saturated; by default 2^bits - 1 of
        ``taps``.
    bits : of the converter.
    alternating_row_sign : every second row has the opposite sign, counted from the upper and the lower edge,
        as in the Kinect v2.
    rows_from_bottom, columns_from_right : the image is upside down, or mirrored.
    lens : distortion, which is taken out.
    """

    layout: Layout
    arrays: Annotated[Names, Field(min_length=1)]
    axes: Annotated[tuple[Axis, ...], Field(min_length=2, max_length=6)]
    frequencies_hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=MOST_FREQUENCIES)]
    horizontal_fov_deg: FieldOfView
    amplitude_arrays: Names = ()
    imaginary_arrays: Names = ()
    stacked_along: Literal["frame", "frequency", "step", "tap"] | None = None
    binary: Binary | None = None
    bin_width_s: Annotated[float, Bounds(1e-13, 1e-6, "s")] | None = None
    most_nan: Fraction = 0.01
    window: tuple[Pixel, Pixel, Side, Side] | None = None
    files: Literal["together", "frequencies", "steps"] = "together"
    step_count: Count | None = None
    steps_rad: Angles = ()
    tap_count: Count | None = None
    taps_rad: Angles = ()
    phase_sign: Literal[1, -1] = 1
    phase_offsets_rad: Angles = ()
    phase_offset_arrays: Names = ()
    phase_offsets_std_rad: Annotated[tuple[PhaseDeviation, ...], Field(max_length=MOST_FREQUENCIES)] = ()
    phase_unit: Literal["rad", "deg", "dn"] = "rad"
    phase_period_dn: ConverterNumber | None = None
    depth_unit: Literal["m", "mm"] = "m"
    depth_along: Literal["ray", "axis"] = "ray"
    dark_arrays: Names = ()
    dark_axes: Annotated[tuple[Axis, ...], Field(max_length=6)] = ()
    calibration_file: Name | None = Field(default=None, validation_alias=AliasChoices(*CALIBRATION_FILE))
    exposures_s: tuple[ExposureTime, ...] = ()
    exposure_array: Name | None = None
    saturation_dn: ConverterNumber | None = None
    bits: Annotated[int, Field(ge=1, le=32)] | None = None
    alternating_row_sign: bool = False
    rows_from_bottom: bool = False
    columns_from_right: bool = False
    lens: Lens | None = None

    def __post_init__(self) -> None:
        _refuse_axes(self)
        _refuse_units(self)
        _refuse_pairs(self)
        _ = self.wanted  # parses the formulas
        if self.is_raw:
            phasor_weights(self.steps, self.taps)

    @property
    def is_raw(self) -> bool:
        """Whether the arrays hold phase steps."""
        return self.layout in ("taps", "differences")

    def takes_complex(self, name: str) -> bool:
        """Whether an array of the frames may hold complex numbers."""
        return self.layout == "phasors" and not self.imaginary_arrays and name in self.arrays

    @property
    def steps(self) -> tuple[float, ...]:
        """Phases of the steps, radians."""
        return _phases(self.steps_rad, self.step_count)

    @property
    def taps(self) -> tuple[float, ...]:
        """Phases of the taps, radians."""
        return _phases(self.taps_rad, self.tap_count)

    @property
    def saturation(self) -> float | None:
        """Smallest size of a number that is saturated; None if unknown."""
        if self.saturation_dn is None and self.bits is not None and self.layout == "taps":
            return float(2**self.bits - 1)
        return self.saturation_dn

    @property
    def offset_std_rad(self) -> tuple[float, ...]:
        """(F,) standard deviations of the phase offsets that are left, radians."""
        return self.phase_offsets_std_rad or (OFFSET_STD_RAD,) * len(self.frequencies_hz)

    @property
    def wanted(self) -> tuple[str, ...]:
        """Names of all arrays in the files."""
        exposure = () if self.exposure_array is None else (self.exposure_array,)
        others = (*self.dark_arrays, *self.phase_offset_arrays, *exposure)
        each = (*self.arrays, *self.amplitude_arrays, *self.imaginary_arrays, *others)
        return tuple(dict.fromkeys(name for text in each for name in names_in(text)))


def _phases(given: tuple[float, ...], count: int | None) -> tuple[float, ...]:
    if given:
        return given
    return tuple(2 * np.pi * place / (count or 1) for place in range(count or 1))


def _refuse_axes(sidecar: Sidecar) -> None:
    """Axes that are unknown or named twice."""
    for key, axes in (("axes", sidecar.axes), ("dark_axes", sidecar.dark_axes)):
        parts = [part for axis in axes for part in axis.split("*")]
        known = (*AXES, BIN) if sidecar.layout == "histograms" else AXES
        unknown = [part for part in parts if part not in known]
        if unknown:
            raise ValueError(f"{key} names {unknown[0]}, which is none of {', '.join(AXES)}")
        if len(set(parts)) < len(parts) or sidecar.stacked_along in parts:
            raise ValueError(f"{key} and stacked_along name an axis twice")
    if not {"row", "column"} <= {part for axis in sidecar.axes for part in axis.split("*")}:
        raise ValueError("axes must name row and column")
    many = len(sidecar.arrays) > 1 or len(sidecar.dark_arrays) > 1
    if many and sidecar.stacked_along is None:
        raise ValueError("several arrays need stacked_along: frame, frequency, step or tap")


def _refuse_units(sidecar: Sidecar) -> None:
    """Numbers that must be in another unit."""
    if len(set(sidecar.frequencies_hz)) < len(sidecar.frequencies_hz):
        raise ValueError("frequencies_hz names a frequency twice")
    for key in ("phase_offsets_rad", "phase_offsets_std_rad"):
        if len(getattr(sidecar, key)) not in (0, len(sidecar.frequencies_hz)):
            raise ValueError(f"{key} must have {len(sidecar.frequencies_hz)} values, one for each frequency")


def _refuse_pairs(sidecar: Sidecar) -> None:
    """Keys that exclude or need each other."""
    layout, count = sidecar.layout, len(sidecar.arrays)
    amplitudes, imaginary = sidecar.amplitude_arrays, sidecar.imaginary_arrays
    with_amplitude = layout.startswith("amplitude")
    taps = sidecar.tap_count or sidecar.taps_rad
    steps = sidecar.step_count or sidecar.steps_rad
    dark = sidecar.dark_arrays
    wrong = {
        "give step_count or steps_rad, not both": sidecar.step_count and sidecar.steps_rad,
        "give tap_count or taps_rad, not both": sidecar.tap_count and sidecar.taps_rad,
        "give exposures_s or exposure_array, not both": sidecar.exposure_array and sidecar.exposures_s,
        f"the layout {layout} needs amplitude_arrays": with_amplitude and not amplitudes,
        f"the layout {layout} has no amplitude_arrays": amplitudes and not with_amplitude,
        "arrays and amplitude_arrays must be as many": amplitudes and len(amplitudes) != count,
        "imaginary_arrays goes with the layout phasors": imaginary and layout != "phasors",
        "arrays and imaginary_arrays must be as many": imaginary and len(imaginary) != count,
        "differences have no taps: leave out tap_count and taps_rad": layout == "differences" and taps,
        f"the layout {layout} has neither steps nor taps": not sidecar.is_raw and (taps or steps),
        "phase_unit dn and phase_period_dn go together": (sidecar.phase_unit == "dn")
        != (sidecar.phase_period_dn is not None),
        "dark frames go with the layouts taps and differences": dark and not sidecar.is_raw,
        "depths along the axis go neither with a lens nor with a window: give depths along the rays": (
            (sidecar.lens or sidecar.window) and sidecar.depth_along == "axis"
        ),
        "the layout histograms, the axis bin and bin_width_s go together": len(
            {layout == "histograms", sidecar.bin_width_s is not None, BIN in sidecar.axes}
        )
        > 1,
        "the layout histograms has neither frequency, step nor tap": layout == "histograms"
        and not {"frequency", "step", "tap"}.isdisjoint("*".join(sidecar.axes).split("*")),
        "files steps goes with the layouts taps and differences": sidecar.files == "steps"
        and not sidecar.is_raw,
        TOO_COARSE: sidecar.bits is not None and sidecar.bits <= _FEW_BITS,
    }
    for sentence, is_wrong in wrong.items():
        if is_wrong:
            raise ValueError(sentence)
