"""Reading measurement files: phasors from a real camera or from ``night-render``.

==================  ========================================================================================
``.exr``            one image with the channels of ``itof.exr``: ``itof.<f>MHz.Re`` and ``itof.<f>MHz.Im``
``.npz``            arrays ``phasors``, ``frequencies_hz`` and optionally ``reference``
``.h5``, ``.hdf5``  data sets with the same names
==================  ========================================================================================

``phasors`` is (H, W, F) or (N, H, W, F) complex, ``frequencies_hz`` is (F,) in Hz, ``reference`` is (H, W, F)
complex. Reading a file never executes anything in it: pickled arrays are refused.
"""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from itof import ImageFileError, read_image
from scenegen import NightError

ARRAYS: Final[tuple[str, ...]] = ("phasors", "frequencies_hz", "reference")
_SAME_FREQUENCY = 1e-6  # relative tolerance; changes the phase of 20 m optical path at 20 MHz by 8e-6 rad
# RuntimeError: the archive is encrypted or its compression is unknown. TokenError: a header is damaged.
_NPZ_ERRORS = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
    tokenize.TokenError,
)


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
    """

    path: Path
    phasors: NDArray[np.complexfloating[Any, Any]]
    frequencies_hz: tuple[float, ...]
    reference: NDArray[np.complexfloating[Any, Any]] | None
    in_training_unit: bool

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
            if not np.isclose(found[index], f, rtol=_SAME_FREQUENCY, atol=0)
        ]
        if missing:
            is_megahertz = found.max() < 1e4  # no camera modulates below 10 kHz
            hint = "; frequencies_hz is in Hz, not MHz" if is_megahertz else ""
            raise MeasurementError(
                f"{self.path} holds {_megahertz(found)}, the network also needs {_megahertz(missing)}{hint}"
            )
        reference = None if self.reference is None else self.reference[..., nearest]
        return Measurement(
            self.path, self.phasors[..., nearest], tuple(frequencies_hz), reference, self.in_training_unit
        )


def read_measurement(path: Path) -> Measurement:
    """Read a measurement file; its ending tells the format.

    Raises
    ------
    MeasurementError : the ending is unknown; the file is missing, damaged or of another format; an array is
        missing or has the wrong type or shape; a value is not finite.
    """
    readers = {".exr": _read_exr, ".npz": _read_npz, ".h5": _read_hdf5, ".hdf5": _read_hdf5}
    reader = readers.get(path.suffix.lower())
    if not path.is_file():
        raise MeasurementError(f"{path} {'is a folder' if path.is_dir() else 'does not exist'}")
    if reader is None:
        ending = f"the ending {path.suffix}" if path.suffix else "no ending"
        raise MeasurementError(f"{path} has {ending}: measurements are read from {', '.join(readers)} files")
    return reader(path)


def _read_exr(path: Path) -> Measurement:
    try:
        image = read_image(path)
    except ImageFileError as error:
        raise MeasurementError(str(error)) from None
    try:
        phasors, frequencies_hz = image.phasors()  # (H, W, F)
    except ImageFileError as error:
        raise MeasurementError(f"{path} holds no phasors: {error}") from None
    _refuse_not_finite(path, "phasors", phasors[None])
    return Measurement(path, phasors[None], frequencies_hz, None, in_training_unit=True)


def _read_npz(path: Path) -> Measurement:
    try:
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            names = archive.files if isinstance(archive, np.lib.npyio.NpzFile) else None
            found = {name: archive[name] for name in ARRAYS if names and name in names}
    except _NPZ_ERRORS as error:
        if "allow_pickle" in str(error):
            reason = "it holds pickled Python objects, which could run any program; save plain arrays"
        else:
            reason = f"it is damaged or no .npz archive ({error})"
        raise MeasurementError(f"{path} cannot be read: {reason}") from None
    if names is None:
        raise MeasurementError(f"{path} is one bare array, not an .npz archive: write it with numpy.savez")
    return _measurement(path, found, names)


def _read_hdf5(path: Path) -> Measurement:
    try:
        with h5py.File(path, "r") as file:
            names = list(file)
            found = {
                name: np.asarray(file[name][()])
                for name in ARRAYS
                if isinstance(file.get(name), h5py.Dataset)
            }
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise MeasurementError(f"{path} cannot be read: it is damaged or no HDF5 file ({error})") from None
    return _measurement(path, found, names)


def _measurement(path: Path, found: Mapping[str, NDArray[Any]], names: Sequence[str]) -> Measurement:
    """The measurement of the arrays `found`, after checks; `names` are all names in the file."""
    for name in ARRAYS[:2]:
        if name not in found:
            there = ", ".join(sorted(map(str, names))) or "nothing"
            raise MeasurementError(f"{path} has no array {name}; it holds {there}")
    frequencies_hz = _frequencies(path, found["frequencies_hz"])
    phasors = found["phasors"]
    count = len(frequencies_hz)
    _refuse_other_axes(path, "phasors", phasors, count, "(H, W, F) or (N, H, W, F)", (3, 4))
    phasors = phasors if phasors.ndim == 4 else phasors[None]
    _refuse_not_finite(path, "phasors", phasors)
    reference = found.get("reference")
    if reference is not None:
        _refuse_other_axes(path, "reference", reference, count, "(H, W, F)", (3,))
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
    return Measurement(path, phasors, frequencies_hz, reference, in_training_unit=False)


def _frequencies(path: Path, values: NDArray[Any]) -> tuple[float, ...]:
    if values.dtype.kind not in "iuf" or values.ndim != 1 or not values.size:
        raise MeasurementError(
            f"{path}: frequencies_hz must be a list of numbers, got {values.dtype} of shape {values.shape}"
        )
    frequencies_hz = tuple(float(value) for value in values)
    if not all(0 < f < np.inf for f in frequencies_hz) or len(set(frequencies_hz)) < len(frequencies_hz):
        raise MeasurementError(f"{path}: frequencies_hz must be different positive numbers: {frequencies_hz}")
    return frequencies_hz


def _refuse_other_axes(
    path: Path, name: str, values: NDArray[Any], frequency_count: int, shape: str, axes: tuple[int, ...]
) -> None:
    if values.dtype.kind != "c":
        raise MeasurementError(f"{path}: {name} must be complex, Re + j Im, got {values.dtype}")
    if values.ndim not in axes or not values.size:
        raise MeasurementError(f"{path}: {name} must have the shape {shape}, got {values.shape}")
    if values.shape[-1] != frequency_count:
        raise MeasurementError(
            f"{path}: {name} of shape {values.shape} must have {frequency_count} values on its last axis, "
            "one for each of frequencies_hz"
        )


def _refuse_not_finite(path: Path, name: str, images: NDArray[Any]) -> None:
    """Refuse (N, H, W, F) images with NaN or infinite values; the message names the first one."""
    for index, image in enumerate(images):
        bad = int(np.count_nonzero(~np.isfinite(image)))
        if bad:
            where = f"image {index} of {name}" if len(images) > 1 else name
            raise MeasurementError(f"{path}: {where} holds {bad} values that are NaN or infinite")


def _megahertz(frequencies_hz: Sequence[float] | NDArray[np.float64]) -> str:
    return ", ".join(f"{frequency_hz / 1e6:g}" for frequency_hz in frequencies_hz) + " MHz"
