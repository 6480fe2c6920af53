"""The images of a capture to be judged: raw frames with a sidecar, or a measurement file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import PathLike
from disk.quantities import FREQUENCY, fov_problem
from itof.arrays import Phasors
from itof.capture.capture import ImageShape, read_capture
from itof.capture.capture_files import refuse_repeated
from itof.capture.facts import CaptureFacts
from itof.capture.importing import paths
from itof.capture.record import read_import_record
from itof.capture.sidecar import MOST_FREQUENCIES, CaptureError, Sidecar
from itof.capture.sidecar_files import load_sidecar
from itof.files.measurement_files import read_measurement
from itof.light import OFFSET_STD_RAD


@dataclass(frozen=True)
class CapturedImages:
    """Images (N, H, W, F) of a capture, and what is known about them."""

    phasors: Phasors
    frequencies_hz: tuple[float, ...]
    reference: Phasors | None
    fov_deg: float
    facts: CaptureFacts | None = None
    reference_facts: CaptureFacts | None = None
    offset_std_rad: float | Sequence[float] = OFFSET_STD_RAD
    saturated_part: NDArray[np.float64] | None = None


def read_images(
    inputs: PathLike | Sequence[PathLike],
    sidecar: PathLike | None = None,
    *,
    shape: ImageShape,
    empty: PathLike | Sequence[PathLike] = (),
    changes: Sequence[str] = (),
    progress: bool = True,
) -> CapturedImages:
    """Read raw frames with a sidecar, or without one a measurement file; parameters as of `check_capture`.

    Raises
    ------
    CaptureError, MeasurementError : as `check_capture`.
    """
    files = paths(inputs)
    refuse_repeated([*files, *paths(empty)])
    if sidecar is not None:
        return _of_frames(files, paths(empty), load_sidecar(sidecar, changes), shape, progress)
    if len(files) != 1 or empty or changes or shape.bin_side or shape.size:
        raise CaptureError("a measurement file is checked alone: raw frames and their options need --sidecar")
    return _of_measurement(files[0], shape.horizontal_fov_deg)


def _of_frames(
    files: list[Path], empty: list[Path], sidecar: tuple[Sidecar, Path], shape: ImageShape, progress: bool
) -> CapturedImages:
    capture = read_capture(files, *sidecar, shape, progress=progress)
    reference = read_capture(empty, *sidecar, shape, progress=progress) if empty else None
    return CapturedImages(
        capture.phasor[None],
        capture.frequencies_hz,
        None if reference is None else reference.phasor,
        capture.facts.horizontal_fov_deg,
        capture.facts,
        None if reference is None else reference.facts,
        sidecar[0].offset_std_rad,
        capture.saturated_part,
    )


def _of_measurement(file: Path, fov_deg: float | None) -> CapturedImages:
    measured = read_measurement(file)
    count = len(measured.frequencies_hz)
    if count > MOST_FREQUENCIES:
        raise CaptureError(f"{file} has {count} frequencies, and {MOST_FREQUENCIES} are the most")
    for frequency_hz in measured.frequencies_hz:
        if problem := FREQUENCY.problem(frequency_hz):
            raise CaptureError(f"{file}: frequencies_hz {problem}")
    record = read_import_record(file)
    if record is not None and record.sidecar.frequencies_hz != measured.frequencies_hz:
        record = None  # somebody has edited it
    own_deg = set(measured.fields_of_view_deg)
    if fov_deg is None and len(own_deg) > 1:
        raise CaptureError(
            f"{file} has images with {len(own_deg)} fields of view: put those with the same into a file"
        )
    if fov_deg is None and own_deg:
        (fov_deg,) = own_deg
    if fov_deg is None and record is not None:
        fov_deg = record.facts.horizontal_fov_deg
    if fov_deg is None:
        raise CaptureError(
            f"{file} has no record of an import beside it, and no horizontal_fov_deg: give its field of view "
            "by --fov, or give the sidecar of the raw frames"
        )
    problem = fov_problem(fov_deg)
    if problem:
        raise CaptureError(problem)
    facts = None if record is None else record.facts
    reference_facts = None if record is None else record.reference_facts
    names = (measured.phasors, measured.frequencies_hz, measured.reference)
    known = OFFSET_STD_RAD if record is None else record.sidecar.offset_std_rad
    return CapturedImages(*names, fov_deg, facts, reference_facts, known)
