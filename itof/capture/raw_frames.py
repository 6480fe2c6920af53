"""The raw frames of a capture in its files, read in a process of their own, with all axes in one order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from disk import OutsideError, inside, sha256_of
from disk.counted import counted
from itof.arrays import Numbers
from itof.capture.frame_axes import ordered, stacked
from itof.capture.sidecar import TOO_COARSE, CaptureError, Sidecar
from itof.files.array_claims import RefusedError
from itof.files.measurement_process import FileContents, read_contents

ENDINGS: Final = (".npz", ".h5", ".hdf5", ".exr", ".mat")
SMALLEST: Final = 1e-30  # largest number of an array, whose square is not 0
LARGEST: Final = 1e30  # number whose square can be summed
_MOST_NAMES = 20  # of arrays in a sentence
_SHORTEST_S, _LONGEST_S = 1e-12, 1e6  # of an exposure
_FEW = 3  # files in a sentence


@dataclass(frozen=True)
class RawFrames:
    """Frames of a capture; arrays have the axes (frame, frequency, step, tap, row, column).

    Attributes
    ----------
    values : N frames of taps, differences, phasors (or their real parts), phases or depths.
    partner : amplitudes or imaginary parts of the same shape; None if the layout has none.
    dark : dark frames, with the size 1 on axes that they lack; None if there are none.
    exposures_s : (N, F) exposure times, seconds; all 1 if they are not given.
    source : the files, for messages.
    """

    values: Numbers
    partner: Numbers | None
    dark: Numbers | None
    exposures_s: NDArray[np.float64]
    source: str


def read_frames(files: Sequence[Path], sidecar: Sidecar, folder: Path) -> RawFrames:
    """Read the frames of a capture.

    Parameters
    ----------
    files : files of the capture. With ``files = "frequencies"``, as many for each frequency, in their order.
        Files that hold the same array hold further frames.
    folder : that of the sidecar, where the file of the dark frames is.

    Raises
    ------
    CaptureError : a file cannot be read, an array is missing or has not the axes that the sidecar says, or
        its values are not finite, of 8 bits, or complex where real numbers are meant.
    """
    read: list[tuple[Path, FileContents]] = []
    for file in files:
        read.append((file, _contents(file, sidecar.wanted, _bytes_of(read))))
    return frames_of(read, sidecar, folder)


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


def frames_of(files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar, folder: Path) -> RawFrames:
    """The frames in the arrays of files; `CaptureError` if they are not as the sidecar says."""
    names = [str(file) for file, _ in files]
    source = ", ".join(names[:_FEW]) + (", ..." if len(names) > _FEW else "")
    count = len(sidecar.frequencies_hz) if sidecar.files == "frequencies" else 1
    if not files or len(files) % count:
        raise CaptureError(
            f"{len(files)} files were given, and the sidecar says that each holds one of {count} "
            "frequencies: give as many files for each frequency, in the order of frequencies_hz"
        )
    each = len(files) // count
    parts = [_Group(files[at : at + each], sidecar) for at in range(0, len(files), each)]
    arrays = [part.read(sidecar.arrays) for part in parts]
    for part, whole in zip(parts, arrays, strict=True):
        _refuse_sizes(sidecar, whole, str(part.files[0][0]))
    values = _joined(arrays, source)
    others = sidecar.amplitude_arrays or sidecar.imaginary_arrays
    partner = _joined([part.read(others) for part in parts], source) if others else None
    _refuse_other_shape(values, partner, source)
    exposures = _exposures(sidecar, parts, values.shape[0], source)
    dark = _dark(sidecar, parts, folder, values.shape, source)
    return RawFrames(values, partner, dark, exposures, source)


class _Group:
    """Files that together hold some frequencies."""

    def __init__(self, files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar) -> None:
        self.files, self.sidecar = files, sidecar

    def read(self, names: tuple[str, ...], axes: tuple[str, ...] = ()) -> Numbers:
        """The arrays of these names as one; those of several files are further frames."""
        axes, along, source = axes or self.sidecar.axes, self.sidecar.stacked_along, str(self.files[0][0])
        of_files = [
            [self._view(file, contents, name, axes) for name in names] for file, contents in self.files
        ]
        of_names = list(zip(*of_files, strict=True))
        for name, found in zip(names, of_names, strict=True):
            if all(view is None for view in found):
                raise _missing(name, self.files)
        # Arrays that are frames come file by file, as the exposure times do.
        groups = of_files if along == "frame" else of_names
        given = [[view for view in group if view is not None] for group in groups]
        return stacked([stacked(group, "frame", source) for group in given if group], along, source)

    def _view(self, file: Path, contents: FileContents, name: str, axes: tuple[str, ...]) -> Numbers | None:
        """An array of a file with six axes; None if the file does not have it."""
        values = contents.arrays.get(name)
        if values is None:
            return None
        what = f"{file}: {name}"
        _refuse_values(values, what)
        if not self.sidecar.takes_complex(name):
            _refuse_complex(values, what)
        return ordered(values, axes, _sizes(self.sidecar), what)

    def numbers(self, name: str) -> Numbers:
        """All values of a list."""
        found = [(file, contents.arrays[name]) for file, contents in self.files if name in contents.arrays]
        if not found:
            raise _missing(name, self.files)
        for file, values in found:
            _refuse_complex(values, f"{file}: {name}")
        return np.concatenate([values.reshape(-1) for _, values in found])

    def has(self, name: str) -> bool:
        """Whether a file has an array of this name."""
        return any(name in contents.arrays for _, contents in self.files)


def _bytes_of(files: Sequence[tuple[Path, FileContents]]) -> int:
    return sum(values.nbytes for _, contents in files for values in contents.arrays.values())


def _contents(file: Path, wanted: tuple[str, ...], taken: int) -> FileContents:
    """The arrays of a file, beside arrays of so many bytes that are in memory already."""
    if not file.is_file():
        raise CaptureError(f"{file} {'is a folder' if file.is_dir() else 'does not exist'}")
    if file.suffix.lower() not in ENDINGS:
        ending = f"the ending {file.suffix}" if file.suffix else "no ending"
        raise CaptureError(f"{file} has {ending}: captures are read from {', '.join(ENDINGS)} files")
    try:
        return read_contents(file, wanted, taken=taken)
    except RefusedError as error:
        raise CaptureError(str(error)) from None


def _missing(name: str, files: Sequence[tuple[Path, FileContents]]) -> CaptureError:
    where = ", ".join(str(file) for file, _ in files[:_FEW])
    there = ", ".join([name for _, contents in files for name in contents.names][:_MOST_NAMES])
    return CaptureError(f"{where} has no array {name}; it holds {there or 'nothing'}: correct the sidecar")


def _sizes(sidecar: Sidecar) -> dict[str, int]:
    """Sizes of the axes of one array."""
    sizes = {
        "frequency": 1 if sidecar.files == "frequencies" else len(sidecar.frequencies_hz),
        "step": len(sidecar.steps) if sidecar.is_raw else 1,
        "tap": len(sidecar.taps) if sidecar.layout == "taps" else 1,
    }
    if sidecar.stacked_along in sizes:
        sizes[sidecar.stacked_along] = 1
    return sizes


def _refuse_sizes(sidecar: Sidecar, values: Numbers, source: str) -> None:
    """Refuse frames without an axis that they need."""
    names = ", ".join(sidecar.arrays[:_FEW]) + (", ..." if len(sidecar.arrays) > _FEW else "")
    what = f"the array {names} has" if len(sidecar.arrays) == 1 else f"the arrays {names} together have"
    wanted = {**_sizes(sidecar), "step": len(sidecar.steps), "tap": len(sidecar.taps)}
    if sidecar.files == "together":
        wanted["frequency"] = len(sidecar.frequencies_hz)
    for place, axis in ((1, "frequency"), (2, "step"), (3, "tap")):
        if values.shape[place] != wanted[axis]:
            raise CaptureError(
                f"{source}: {what} the size {values.shape[place]} on the axis {axis}, not {wanted[axis]}: a "
                "missing frequency, step or tap, or wrong axes?"
            )


def _refuse_values(values: Numbers, what: str) -> None:
    if values.dtype.kind in "iu" and values.dtype.itemsize == 1:
        raise CaptureError(f"{what}: {TOO_COARSE}")
    if not values.size:
        raise CaptureError(f"{what} is empty: capture again")
    if values.dtype.kind in "fc" and (bad := int(np.count_nonzero(~np.isfinite(values)))):
        raise CaptureError(
            f"{what} holds {bad} values that are NaN or infinite: write 0 for pixels without a value, and "
            "for their amplitudes if there are any"
        )
    ends = np.abs(values) if values.dtype.kind == "c" else values
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


def _joined(parts: list[Numbers], source: str) -> Numbers:
    """Arrays of single frequencies as one."""
    frames = {part.shape[0] for part in parts}
    if len(frames) > 1:
        raise CaptureError(
            f"{source}: the frequencies have {', '.join(map(str, sorted(frames)))} frames: give as many for "
            "each"
        )
    return stacked(parts, "frequency", source)


def _refuse_other_shape(values: Numbers, partner: Numbers | None, source: str) -> None:
    """Refuse amplitudes or imaginary parts of another shape than what they belong to."""
    if partner is not None and values.shape != partner.shape:
        raise CaptureError(
            f"{source}: arrays that belong together have the shapes {values.shape} and {partner.shape} in "
            "frames, frequencies, steps, taps, rows and columns"
        )


def _exposures(sidecar: Sidecar, parts: list[_Group], count: int, source: str) -> NDArray[np.float64]:
    """(N, F) exposure times; files of single frequencies may have their own."""
    name = sidecar.exposure_array
    if name is not None:
        own = parts if any(part.has(name) for part in parts[1:]) else parts[:1]
        times = [part.numbers(name).astype(np.float64) for part in own]
    else:
        times = [np.array(sidecar.exposures_s or (1.0,) * count)]
    for each in times:
        if each.shape != (count,) or not ((each >= _SHORTEST_S) & (each <= _LONGEST_S)).all():
            raise CaptureError(
                f"{source} holds {counted(count, 'frame')}, and {len(each)} exposure times are given: give "
                "one positive number of seconds for each frame"
            )
    frequencies = len(sidecar.frequencies_hz)
    return np.stack(times * (frequencies // len(times)), axis=1)


def _dark(
    sidecar: Sidecar, parts: list[_Group], folder: Path, shape: tuple[int, ...], source: str
) -> Numbers | None:
    if not sidecar.dark_arrays:
        return None
    axes = sidecar.dark_axes or sidecar.axes
    if sidecar.dark_file is not None:
        try:
            file = inside(folder, sidecar.dark_file)
            taken = sum(_bytes_of(part.files) for part in parts)
            parts = [_Group([(file, _contents(file, sidecar.dark_arrays, taken))], sidecar)]
        except (OutsideError, CaptureError) as error:
            raise CaptureError(f"dark_file of the sidecar for {source}: {error}") from None
    dark = _joined([part.read(sidecar.dark_arrays, axes) for part in parts], str(parts[0].files[0][0]))
    fits = all(size in (1, wanted) for size, wanted in zip(dark.shape[1:], shape[1:], strict=True))
    if not fits:
        raise CaptureError(
            f"dark frames of the shape {dark.shape[1:]} do not fit frames of {shape[1:]} in frequencies, "
            "steps, taps, rows and columns"
        )
    return dark
