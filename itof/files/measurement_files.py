"""Reading measurement files: phasors from a real camera or from ``night-render``.

==================  ========================================================================================
``.exr``            one image with the channels of ``itof.exr``: ``itof.<f>MHz.Re`` and ``itof.<f>MHz.Im``
``.npz``            arrays ``phasors``, ``frequencies_hz``; optionally ``reference``, ``horizontal_fov_deg``
``.h5``, ``.hdf5``  data sets with the same names
==================  ========================================================================================

``phasors`` is (H, W, F) or (N, H, W, F) complex, ``frequencies_hz`` is (F,) in Hz, ``reference`` is (H, W, F)
complex, ``horizontal_fov_deg`` is one angle or (N,). Reading a file never executes anything in it: pickled
arrays, HDF5 filters from plugins and links to other files are refused. The file is read in a process of its
own (`itof.files.measurement_process`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from disk import NightError, PathLike
from disk.frequency_text import megahertz
from disk.quantities import FREQUENCY, fov_problem
from itof.arrays import Complex, Numbers, Phasors
from itof.exr.image import FIELD_OF_VIEW
from itof.files.array_claims import ARRAYS, RefusedError
from itof.files.measurement_process import FileContents, read_contents

_ENDINGS = (".exr", ".npz", ".h5", ".hdf5")
SAME_FREQUENCY = 1e-6  # relative tolerance; changes the phase of 20 m optical path at 20 MHz by 8e-6 rad


class MeasurementError(NightError):
    """A measurement file is missing or damaged, or its arrays are not as required."""


@dataclass(frozen=True)
class Measurement:
    """Contents of a measurement file.

    Attributes
    ----------
    path : the file.
    phasors : (N, H, W, F) complex.
    frequencies_hz : F modulation frequencies, Hz, in the order of the phasors.
    reference : (H, W, F) complex capture of the empty corner; None if the file has none.
    in_training_unit : whether the phasors have the unit of rendered scenes; cameras have other units.
    ignored : names of arrays in the file that are not used, such as ``ref`` for ``reference``.
    fields_of_view_deg : N full horizontal fields of view; empty if the file does not have them.
    """

    path: Path
    phasors: Phasors
    frequencies_hz: tuple[float, ...]
    reference: Phasors | None
    in_training_unit: bool
    ignored: tuple[str, ...] = ()
    fields_of_view_deg: tuple[float, ...] = ()

    def at(self, frequencies_hz: Sequence[float]) -> Measurement:
        """The measurement with these frequencies only, Hz, in this order.

        Raises
        ------
        MeasurementError : a frequency was not measured.
        """
        found = np.array(self.frequencies_hz)  # (F,)
        nearest = [int(np.argmin(np.abs(found - f))) for f in frequencies_hz]
        missing = [
            f
            for f, index in zip(frequencies_hz, nearest, strict=True)
            if not np.isclose(found[index], f, rtol=SAME_FREQUENCY, atol=0)
        ]
        if missing:
            hint = "; frequencies_hz is in Hz, not MHz" if found.max() < FREQUENCY.least else ""
            raise MeasurementError(
                f"{self.path} holds {megahertz(*found)}, the network also needs {megahertz(*missing)}{hint}"
            )
        reference = None if self.reference is None else self.reference[..., nearest]
        return replace(
            self,
            phasors=self.phasors[..., nearest],
            frequencies_hz=tuple(frequencies_hz),
            reference=reference,
        )


def read_measurement(path: PathLike) -> Measurement:
    """Read a measurement file; its ending tells the format.

    Raises
    ------
    MeasurementError : the ending is unknown; the file is missing, damaged or of another format, or claims
        more than the memory of this machine can hold; an array is missing or has the wrong type or shape; a
        value is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise MeasurementError(f"{path} {'is a folder' if path.is_dir() else 'does not exist'}")
    if path.suffix.lower() not in _ENDINGS:
        ending = f"the ending {path.suffix}" if path.suffix else "no ending"
        known = ", ".join(_ENDINGS)
        raise MeasurementError(
            f"{path} has {ending}: measurements are read from {known} files{_advice(path)}"
        )
    try:
        contents = read_contents(path)
    except RefusedError as error:
        raise MeasurementError(str(error)) from None
    return measurement_of(path, contents)


def _advice(path: Path) -> str:
    return (
        f": night-eval capture import {path} --sidecar FILE --out OUT.npz makes a measurement of raw frames "
        "or photon histograms"
    )


def measurement_of(path: Path, contents: FileContents) -> Measurement:
    """The measurement in the arrays of a file; `MeasurementError` if they are not as they should be."""
    found = contents.arrays
    for name in ARRAYS[:2]:
        if name not in found:
            there = ", ".join(sorted(contents.names)[:20]) or "nothing"
            raise MeasurementError(f"{path} has no array {name}; it holds {there}{_advice(path)}")
    frequencies_hz = _frequencies(path, found["frequencies_hz"])
    count = len(frequencies_hz)
    phasors = _phasors(path, "phasors", found["phasors"], count, "(H, W, F) or (N, H, W, F)", (3, 4))
    phasors = phasors if phasors.ndim == 4 else phasors[None]
    _refuse_not_finite(path, "phasors", phasors)
    reference = None
    if "reference" in found:
        reference = _phasors(path, "reference", found["reference"], count, "(H, W, F)", (3,))
        _refuse_not_finite(path, "reference", reference[None])
        if reference.shape != phasors.shape[1:]:
            raise MeasurementError(
                f"{path}: reference of shape {reference.shape} does not fit images of {phasors.shape[1:]}"
            )
        dark = int(np.count_nonzero((reference == 0).any(axis=-1) & (phasors != 0).any(axis=(0, -1))))
        if dark:
            raise MeasurementError(
                f"{path}: reference is 0 in {dark} pixels that have light in the measurement: capture the "
                "empty corner with the same exposure"
            )
    views_deg: tuple[float, ...] = ()
    if FIELD_OF_VIEW in found:
        views_deg = _fields_of_view(path, found[FIELD_OF_VIEW], len(phasors), reference is not None)
    return Measurement(
        path,
        phasors,
        frequencies_hz,
        reference,
        in_training_unit=path.suffix.lower() == ".exr",
        ignored=tuple(name for name in contents.names if name not in ARRAYS),
        fields_of_view_deg=views_deg,
    )


def _frequencies(path: Path, values: Numbers) -> tuple[float, ...]:
    if values.dtype.kind not in "iuf" or values.ndim != 1 or not values.size:
        raise MeasurementError(
            f"{path}: frequencies_hz must be a list of numbers, got {values.dtype} of shape {values.shape}"
        )
    frequencies_hz = tuple(float(value) for value in values)
    if not all(0 < f < np.inf for f in frequencies_hz) or len(set(frequencies_hz)) < len(frequencies_hz):
        raise MeasurementError(f"{path}: frequencies_hz must be different positive numbers: {frequencies_hz}")
    return frequencies_hz


def _fields_of_view(path: Path, values: Numbers, count: int, has_reference: bool) -> tuple[float, ...]:
    """The field of view of each of so many images."""
    if values.dtype.kind not in "iuf" or values.shape not in ((), (1,), (count,)):
        raise MeasurementError(
            f"{path}: {FIELD_OF_VIEW} must be one number, or one for each of the {count} images, got "
            f"{values.dtype} of shape {values.shape}"
        )
    views_deg = tuple(float(value) for value in np.broadcast_to(values, (count,)))
    for view_deg in views_deg:
        if problem := fov_problem(view_deg):
            raise MeasurementError(f"{path}: {problem}")
    if has_reference and len(set(views_deg)) > 1:
        raise MeasurementError(f"{path}: a reference is that of one camera, but {FIELD_OF_VIEW} has several")
    return views_deg


def _phasors(
    path: Path, name: str, values: Numbers, frequency_count: int, shape: str, axes: tuple[int, ...]
) -> Phasors:
    """`values`, if they are complex and have one of these numbers of axes."""
    if values.dtype.kind != "c":
        raise MeasurementError(f"{path}: {name} must be complex, Re + j Im, got {values.dtype}")
    if values.ndim not in axes or not values.size:
        raise MeasurementError(f"{path}: {name} must have the shape {shape}, got {values.shape}")
    if values.shape[-1] != frequency_count:
        raise MeasurementError(
            f"{path}: {name} of shape {values.shape} must have {frequency_count} values on its last axis, "
            "one for each of frequencies_hz"
        )
    return cast(Complex, values)


def _refuse_not_finite(path: Path, name: str, images: Numbers) -> None:
    """Refuse (N, H, W, F) images with NaN or infinite values; the message names the first one."""
    for index, image in enumerate(images):
        bad = int(np.count_nonzero(~np.isfinite(image)))
        if bad:
            where = f"image {index} of {name}" if len(images) > 1 else name
            raise MeasurementError(f"{path}: {where} holds {bad} values that are NaN or infinite")
