"""The arrays in the files of a capture, with their axes in one order and cut to the window of the sidecar."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from disk import sha256_of
from itof import phasors
from itof.arrays import Numbers
from itof.binary_fields import BinaryLayout
from itof.capture.formulas import names_in, value_of
from itof.capture.frame_axes import ordered, stacked
from itof.capture.sidecar import BIN, TOO_COARSE, CaptureError, Sidecar
from itof.files.array_claims import RefusedError
from itof.files.measurement_process import FileContents, read_contents
from itof.files.picture_reading import IMAGE_ENDINGS
from itof.light import SPEED_OF_LIGHT

ENDINGS: Final = (".npz", ".npy", ".h5", ".hdf5", ".exr", ".mat", ".mkv", *IMAGE_ENDINGS)
SMALLEST: Final = 1e-30  # largest number of an array, whose square is not 0
LARGEST: Final = 1e30  # number whose square can be summed
FEW: Final = 3  # files or arrays in a sentence
_MOST_NAMES = 20  # of arrays in a sentence


def refuse_repeated(files: Sequence[Path]) -> None:
    """Refuse files of a capture, and of its empty corner, one of which is there twice.

    Frames that are counted twice have no noise of their own, and a capture over itself has no hidden light.

    Raises
    ------
    CaptureError : two paths lead to one file, or two files have the same SHA-256.
    """
    seen: dict[Path | tuple[int, str], Path] = {}
    places = [Path(os.path.realpath(file)) for file in files]  # `resolve` fails on links that go round
    sizes = [place.stat().st_size if place.is_file() else -1 for place in places]
    for file, place, size in zip(files, places, sizes, strict=True):
        if (first := seen.setdefault(place, file)) is not file:
            raise CaptureError(f"{file} is given twice, also as {first}: give each file once")
        if size < 0 or sizes.count(size) == 1:
            continue  # not a file, which reading refuses; or its content must be another one
        if (first := seen.setdefault((size, sha256_of(place)), file)) is not file:
            raise CaptureError(f"{file} and {first} have the same content: give each capture once")


def contents_of(file: Path, sidecar: Sidecar, taken: int) -> FileContents:
    """The arrays of a file, beside arrays of so many bytes that are in memory already.

    Raises
    ------
    CaptureError : it cannot be read.
    """
    if not file.is_file():
        raise CaptureError(f"{file} {'is a folder' if file.is_dir() else 'does not exist'}")
    if sidecar.binary is None and file.suffix.lower() not in ENDINGS:
        ending = f"the ending {file.suffix}" if file.suffix else "no ending"
        raise CaptureError(
            f"{file} has {ending}: captures are read from {', '.join(ENDINGS)} files, and from others by the "
            "table binary of the sidecar, which says how their numbers lie"
        )
    try:
        return read_contents(file, sidecar.wanted, layout_of(file, sidecar), taken=taken)
    except RefusedError as error:
        raise CaptureError(str(error)) from None


def layout_of(file: Path, sidecar: Sidecar) -> BinaryLayout | None:
    """How numbers lie in a file without a format of its own."""
    if sidecar.binary is None or file.suffix.lower() in ENDINGS:
        return None
    return BinaryLayout(sidecar.binary.fields, sidecar.binary.shape, sidecar.binary.header)


class FileGroup:
    """Files that together hold some frequencies and steps; later files hold further frames.

    Attributes
    ----------
    sensor : width and height of the images before they are cut to the window, pixels; known after `read`.
    """

    def __init__(
        self, files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar, sizes: Mapping[str, int]
    ) -> None:
        """`sizes` are those of the axes of one array, as far as they are known."""
        self.files, self.sidecar, self.sizes = files, sidecar, sizes
        self.sensor = (0, 0)

    @property
    def source(self) -> str:
        """The first file."""
        return str(self.files[0][0])

    def read(self, names: tuple[str, ...], axes: tuple[str, ...], along: str | None) -> Numbers:
        """The arrays of these names or formulas as one, side by side on the axis `along`.

        Raises
        ------
        CaptureError : an array is missing, or is not as the sidecar says.
        """
        of_files = [
            [self._view(file, contents, name, axes) for name in names] for file, contents in self.files
        ]
        of_names = list(zip(*of_files, strict=True))
        for name, found in zip(names, of_names, strict=True):
            if all(view is None for view in found):
                raise self._missing(name)
        # Arrays that are frames come file by file, as the exposure times do.
        groups = of_files if along == "frame" else of_names
        given = [[view for view in group if view is not None] for group in groups]
        return stacked([stacked(group, "frame", self.source) for group in given if group], along, self.source)

    def _view(self, file: Path, contents: FileContents, name: str, axes: tuple[str, ...]) -> Numbers | None:
        """An array of a file with six axes, cut to the window; None if the file does not have it."""
        what = f"{file}: {name}"
        values = _value(file, contents, name)
        if values is None:
            return None
        if not self.sidecar.takes_complex(name):
            _refuse_complex(values, what)
        if BIN in axes:
            values, axes = _phasors_of_bins(values, axes, self.sidecar, what)
        view = ordered(values, axes, self.sizes, what)
        self.sensor = (view.shape[-1], view.shape[-2])
        view = _cut(view, self.sidecar.window, what)
        _refuse_values(view, self.sidecar.most_nan, what)
        return view

    def numbers(self, name: str) -> Numbers:
        """All values of a list."""
        read = [(file, _value(file, contents, name)) for file, contents in self.files]
        found = [(file, values) for file, values in read if values is not None]
        if not found:
            raise self._missing(name)
        for file, values in found:
            _refuse_complex(values, f"{file}: {name}")
        return np.concatenate([values.reshape(-1) for _, values in found])

    def has(self, name: str) -> bool:
        """Whether a file has all arrays of a name or formula."""
        return any(set(names_in(name)) <= set(contents.arrays) for _, contents in self.files)

    def _missing(self, text: str) -> CaptureError:
        where = ", ".join(str(file) for file, _ in self.files[:FEW])
        there = ", ".join([name for _, contents in self.files for name in contents.names][:_MOST_NAMES])
        held = {name for _, contents in self.files for name in contents.arrays}
        missing = [name for name in names_in(text) if name not in held] or [text]
        return CaptureError(
            f"{where} has no array {missing[0]}; it holds {there or 'nothing'}: correct the sidecar"
        )


def _value(file: Path, contents: FileContents, text: str) -> Numbers | None:
    """The array that a name or formula means; None if the file does not have it."""
    names = names_in(text)
    if not set(names) <= set(contents.arrays):
        return None
    only = contents.arrays[names[0]] if len(names) == 1 else None
    if only is not None and only.dtype.kind in "iu" and only.dtype.itemsize == 1:  # two can make one number
        raise CaptureError(f"{file}: {names[0]}: {TOO_COARSE}")
    try:
        return value_of(text, contents.arrays)
    except ValueError as error:
        raise CaptureError(f"{file}: {error}") from None


def _phasors_of_bins(
    histograms: Numbers, axes: tuple[str, ...], sidecar: Sidecar, what: str
) -> tuple[Numbers, tuple[str, ...]]:
    """Phasors of histograms, with frequencies on the last axis instead of bins, and their axes."""
    if histograms.ndim != len(axes):
        raise CaptureError(f"{what} has the shape {histograms.shape}, not {len(axes)} axes: correct axes")
    width_m = SPEED_OF_LIGHT * (sidecar.bin_width_s or 0.0)  # of the path of the light
    last = np.moveaxis(histograms, axes.index(BIN), -1).astype(np.float64)
    try:
        z = phasors(last, sidecar.frequencies_hz, width_m)
    except ValueError as error:
        raise CaptureError(f"{what}: {error}") from None
    return z, (*(axis for axis in axes if axis != BIN), "frequency")


def _cut(view: Numbers, window: tuple[int, int, int, int] | None, what: str) -> Numbers:
    """The part of an image that lies in the window."""
    if window is None or view.shape[-2:] == (1, 1):
        return view
    left, top, width, height = window
    if left + width > view.shape[-1] or top + height > view.shape[-2]:
        raise CaptureError(
            f"{what}: a window of {width}x{height} pixels at column {left} and row {top} does not fit images "
            f"of {view.shape[-1]}x{view.shape[-2]}: correct window"
        )
    return view[..., top : top + height, left : left + width]


def _refuse_values(values: Numbers, most_nan: float, what: str) -> None:
    if not values.size:
        raise CaptureError(f"{what} is empty: capture again")
    ends = np.abs(values) if values.dtype.kind == "c" else values
    if values.dtype.kind in "fc" and (bad := int(np.count_nonzero(~np.isfinite(values)))):
        if bad > most_nan * values.size:
            raise CaptureError(
                f"{what} holds {bad} values that are NaN or infinite ({100 * bad / values.size:.2g} %): if "
                f"they are dead pixels, give a larger most_nan than {most_nan:g}, or a window without them"
            )
        ends = np.where(np.isfinite(ends), ends, 0)
    largest = max(abs(float(ends.max())), abs(float(ends.min())))
    if 0 < largest < SMALLEST:
        raise CaptureError(f"{what} holds at most {largest:g}, which is too small: write it in another unit")
    if largest > LARGEST:
        raise CaptureError(f"{what} holds {largest:g}, and {LARGEST:g} is the most: write it in another unit")


def _refuse_complex(values: Numbers, what: str) -> None:
    if values.dtype.kind == "c":
        raise CaptureError(
            f"{what} must hold real numbers, got {values.dtype}: is it another array, or the layout phasors?"
        )
