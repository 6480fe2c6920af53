"""The raw frames of a capture in its files, read in a process of their own, with all axes in one order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import OutsideError, inside
from disk.counted import counted
from itof.arrays import Numbers
from itof.capture.capture_files import FEW, FileGroup, contents_of
from itof.capture.frame_axes import stacked
from itof.capture.sidecar import CaptureError, Sidecar
from itof.files.measurement_process import FileContents

_SHORTEST_S, _LONGEST_S = 1e-12, 1e6  # of an exposure
_OF_PIXELS = ("frequency", "row", "column")  # axes of phase offsets


@dataclass(frozen=True)
class RawFrames:
    """Frames of a capture; arrays have the axes (frame, frequency, step, tap, row, column).

    Attributes
    ----------
    values : N frames of taps, differences, phasors (or their real parts), phases or depths.
    partner : amplitudes or imaginary parts of the same shape; None if the layout has none.
    dark : dark frames, with the size 1 on axes that they lack; None if there are none.
    offsets_rad : phase offsets of the pixels, (F or 1, H, W); None if there are none.
    lost : (H, W) pixels that are NaN or infinite somewhere; the arrays hold 0 there.
    exposures_s : (N, F) exposure times, seconds; all 1 if they are not given.
    source : the files, for messages.
    sensor : width and height of the sensor, of which H and W are the window, pixels.
    """

    values: Numbers
    partner: Numbers | None
    dark: Numbers | None
    offsets_rad: Numbers | None
    lost: NDArray[np.bool_]
    exposures_s: NDArray[np.float64]
    source: str
    sensor: tuple[int, int]

    def without_lost(self) -> RawFrames:
        """The same with 0 in lost pixels."""
        partner, dark, offsets = (
            None if each is None else np.where(self.lost, 0, each)
            for each in (self.partner, self.dark, self.offsets_rad)
        )
        values = np.where(self.lost, 0, self.values)
        return replace(self, values=values, partner=partner, dark=dark, offsets_rad=offsets)


def read_frames(files: Sequence[Path], sidecar: Sidecar, folder: Path) -> RawFrames:
    """Read the frames of a capture.

    Parameters
    ----------
    files : files of the capture, in the order that ``files`` of the sidecar says. Files that hold the same
        array hold further frames.
    folder : that of the sidecar, where the calibration file is.

    Raises
    ------
    CaptureError : a file cannot be read, an array is missing or has not the axes that the sidecar says, or
        its values are not finite, of 8 bits, or complex where real numbers are meant.
    """
    read: list[tuple[Path, FileContents]] = []
    for file in files:
        read.append((file, contents_of(file, sidecar, _bytes_of(read))))
    return frames_of(read, sidecar, folder)


def frames_of(files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar, folder: Path) -> RawFrames:
    """The frames in the arrays of files; `CaptureError` if they are not as the sidecar says."""
    names = [str(file) for file, _ in files]
    source = ", ".join(names[:FEW]) + (", ..." if len(names) > FEW else "")
    calibration = _calibration(files, sidecar, folder, source)
    if calibration is not None:  # formulas may use its arrays
        known = calibration.files[0][1].arrays
        files = [(file, FileContents(known | each.arrays, each.names)) for file, each in files]
    parts = _groups(files, sidecar)
    values = _joined(parts, sidecar.arrays, sidecar, source)
    sensor = parts[0].sensor
    _refuse_sizes(sidecar, values, source)
    others = sidecar.amplitude_arrays or sidecar.imaginary_arrays
    partner = _joined(parts, others, sidecar, source) if others else None
    _refuse_other_shape(values, partner, source)
    exposures = _exposures(sidecar, parts, values.shape[0], source)
    dark = _dark(sidecar, parts, calibration, values.shape)
    offsets = _offsets(sidecar, parts, calibration, values.shape)
    lost = np.zeros(values.shape[-2:], np.bool_)
    for each in (values, partner, dark, offsets):
        if each is not None and each.dtype.kind in "fc":
            lost |= ~np.isfinite(each).all(axis=tuple(range(each.ndim - 2)))
    raw = RawFrames(values, partner, dark, offsets, lost, exposures, source, sensor)
    return raw if not lost.any() else raw.without_lost()


def _groups(files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar) -> list[FileGroup]:
    """The files of each frequency, or of each step of each frequency, or all of them."""
    frequencies, steps = len(sidecar.frequencies_hz), len(sidecar.steps)
    count = {"together": 1, "frequencies": frequencies, "steps": frequencies * steps}[sidecar.files]
    if not files or len(files) % count:
        what = "frequencies" if sidecar.files == "frequencies" else f"frequencies and {steps} steps"
        raise CaptureError(
            f"{len(files)} files were given, and the sidecar says that each holds one of {frequencies} "
            f"{what}: give as many files for each, in the order of frequencies_hz"
        )
    each = len(files) // count
    sizes = _sizes(sidecar)
    return [FileGroup(files[at : at + each], sidecar, sizes) for at in range(0, len(files), each)]


def _sizes(sidecar: Sidecar) -> dict[str, int]:
    """Sizes of the axes of one array."""
    wanted = _whole_sizes(sidecar)
    alone = {"together": (), "frequencies": ("frequency",), "steps": ("frequency", "step")}[sidecar.files]
    return {axis: 1 if axis in (*alone, sidecar.stacked_along) else size for axis, size in wanted.items()}


def _whole_sizes(sidecar: Sidecar) -> dict[str, int]:
    """Sizes of the axes of all frames together."""
    return {
        "frequency": 1 if sidecar.layout == "depth" else len(sidecar.frequencies_hz),
        "step": len(sidecar.steps) if sidecar.is_raw else 1,
        "tap": len(sidecar.taps) if sidecar.layout == "taps" else 1,
    }


def _calibration(
    files: Sequence[tuple[Path, FileContents]], sidecar: Sidecar, folder: Path, source: str
) -> FileGroup | None:
    """The calibration file, whose arrays may have one frequency or all."""
    if sidecar.calibration_file is None:
        return None
    try:
        file = inside(folder, sidecar.calibration_file)
        contents = contents_of(file, sidecar, _bytes_of(files))
    except (OutsideError, CaptureError) as error:
        raise CaptureError(f"calibration_file of the sidecar for {source}: {error}") from None
    sizes = {axis: size for axis, size in _sizes(sidecar).items() if axis != "frequency"}
    return FileGroup([(file, contents)], sidecar, sizes)


def _bytes_of(files: Sequence[tuple[Path, FileContents]]) -> int:
    return sum(values.nbytes for _, contents in files for values in contents.arrays.values())


def _joined(
    parts: list[FileGroup], names: tuple[str, ...], sidecar: Sidecar, source: str, axes: tuple[str, ...] = ()
) -> Numbers:
    """Arrays of the files of single frequencies and steps as one."""
    along = sidecar.stacked_along
    read = [part.read(names, axes or sidecar.axes, along) for part in parts]
    frames = {each.shape[0] for each in read}
    if len(frames) > 1:
        raise CaptureError(
            f"{source}: the frequencies have {', '.join(map(str, sorted(frames)))} frames: give as many for "
            "each"
        )
    if sidecar.files == "steps" and len(read) > 1:
        steps = len(sidecar.steps)
        read = [stacked(read[at : at + steps], "step", source) for at in range(0, len(read), steps)]
    return stacked(read, "frequency", source)


def _refuse_sizes(sidecar: Sidecar, values: Numbers, source: str) -> None:
    """Refuse frames without an axis that they need."""
    names = ", ".join(sidecar.arrays[:FEW]) + (", ..." if len(sidecar.arrays) > FEW else "")
    what = f"the array {names} has" if len(sidecar.arrays) == 1 else f"the arrays {names} together have"
    wanted = _whole_sizes(sidecar)
    for place, axis in ((1, "frequency"), (2, "step"), (3, "tap")):
        if values.shape[place] != wanted[axis]:
            raise CaptureError(
                f"{source}: {what} the size {values.shape[place]} on the axis {axis}, not {wanted[axis]}: a "
                "missing frequency, step or tap, or wrong axes?"
            )


def _refuse_other_shape(values: Numbers, partner: Numbers | None, source: str) -> None:
    """Refuse amplitudes or imaginary parts of another shape than what they belong to."""
    if partner is not None and values.shape != partner.shape:
        raise CaptureError(
            f"{source}: arrays that belong together have the shapes {values.shape} and {partner.shape} in "
            "frames, frequencies, steps, taps, rows and columns"
        )


def _exposures(sidecar: Sidecar, parts: list[FileGroup], count: int, source: str) -> NDArray[np.float64]:
    """(N, F) exposure times; files of single frequencies may have their own."""
    name, frequencies = sidecar.exposure_array, len(sidecar.frequencies_hz)
    parts = parts[:: len(parts) // frequencies or 1]  # one for each frequency, or one
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
    return np.stack(times * (frequencies // len(times)), axis=1)


def _dark(
    sidecar: Sidecar, parts: list[FileGroup], calibration: FileGroup | None, shape: tuple[int, ...]
) -> Numbers | None:
    if not sidecar.dark_arrays:
        return None
    axes = sidecar.dark_axes or sidecar.axes
    if calibration is not None and calibration.has(sidecar.dark_arrays[0]):
        dark = calibration.read(sidecar.dark_arrays, axes, sidecar.stacked_along)
    else:
        dark = _joined(parts, sidecar.dark_arrays, sidecar, parts[0].source, axes)
    if not _fits(dark.shape[1:], shape[1:]):
        raise CaptureError(
            f"dark frames of the shape {dark.shape[1:]} do not fit frames of {shape[1:]} in frequencies, "
            "steps, taps, rows and columns"
        )
    return dark


def _offsets(
    sidecar: Sidecar, parts: list[FileGroup], calibration: FileGroup | None, shape: tuple[int, ...]
) -> Numbers | None:
    """(F or 1, H, W) phase offsets of the pixels; several arrays are those of the frequencies."""
    names = sidecar.phase_offset_arrays
    if not names:
        return None
    kept = _OF_PIXELS if len(names) == 1 else _OF_PIXELS[1:]
    inner = ["*".join(part for part in axis.split("*") if part in kept) for axis in sidecar.axes]
    axes, along = tuple(axis for axis in inner if axis), None if len(names) == 1 else "frequency"
    each = (
        parts[:: len(sidecar.steps)] if sidecar.files == "steps" else parts
    )  # those of a frequency are the same
    groups = [calibration] if calibration is not None and calibration.has(names[0]) else each
    found = stacked([group.read(names, axes, along) for group in groups], "frequency", parts[0].source)
    if found.shape[0] != 1 or not _fits(found.shape[1:2], shape[1:2]) or found.shape[-2:] != shape[-2:]:
        raise CaptureError(
            f"phase offsets of the shape {found.shape[1:2] + found.shape[-2:]} do not fit frames of "
            f"{shape[1:2] + shape[-2:]} in frequencies, rows and columns"
        )
    return found[0, :, 0, 0]


def _fits(sizes: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return all(size in (1, whole) for size, whole in zip(sizes, wanted, strict=True))
