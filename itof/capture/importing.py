"""Import of captures: raw frames of a camera become a measurement file that prediction reads."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from disk import PathLike, inside, remove_leftovers, sha256_of, whole_file, whole_files
from disk.told import Told
from itof.capture.capture import Capture, ImageShape, read_capture
from itof.capture.capture_files import refuse_repeated
from itof.capture.facts import milliradians
from itof.capture.record import ImportRecord, record_path, refuse_foreign, write_import_record
from itof.capture.sidecar import CaptureError
from itof.capture.sidecar_files import load_sidecar
from itof.files.measurement_files import measurement_of
from itof.files.measurement_process import FileContents
from itof.files.measurement_writing import ENDINGS, write_measurement
from itof.pinhole import pixel_rays
from itof.wall.finding import Finding
from itof.wall.image_defects import depth_defects, image_defects

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class ImportedCapture(Told):
    """Outcome of `import_capture`.

    Attributes
    ----------
    capture : the averaged capture.
    reference : that of the empty corner; None without one.
    out : the measurement file; record : the JSON file beside it.
    """

    capture: Capture
    reference: Capture | None
    out: Path
    record: Path

    @property
    def sentences(self) -> tuple[str, ...]:
        """The outcome as text."""
        told = list(self.capture.facts.sentences)
        if self.reference is not None:
            told += [f"empty corner: {sentence}" for sentence in self.reference.facts.sentences]
            told += _added(self.capture, self.reference)
        return (*told, f"measurement file {self.out}, its record {self.record}")

    def plot(self) -> Figure:
        """Amplitude and phase of the capture and of the empty corner, a column for each frequency."""
        from itof.pictures.plots import phasor_panels, plot_panels

        captures = {"": self.capture, "empty corner": self.reference}
        return plot_panels(
            [
                row
                for name, each in captures.items()
                if each is not None
                for row in phasor_panels(each.phasor, each.frequencies_hz, name)
            ]
        )


def import_capture(
    inputs: PathLike | Sequence[PathLike],
    sidecar: PathLike,
    out: PathLike,
    *,
    empty: PathLike | Sequence[PathLike] = (),
    changes: Sequence[str] = (),
    bin_side: int | None = None,
    size: tuple[int, int] | None = None,
    horizontal_fov_deg: float | None = None,
    progress: bool = True,
) -> ImportedCapture:
    """Make a measurement file of raw frames, and a record beside it.

    Parameters
    ----------
    inputs : files of the capture (`itof.capture.raw_frames.read_frames`).
    sidecar : TOML file that says what the frames mean, or the name of a known format.
    out : ``.npz``, ``.h5`` or ``.hdf5`` to write; only an earlier import is replaced.
    empty : files of a capture of the empty corner in the same format, stored as ``reference``.
    changes : keys of the sidecar that differ, each as a line of TOML.
    bin_side, size, horizontal_fov_deg : as in `itof.capture.capture.ImageShape`.

    Raises
    ------
    CaptureError : a file or the sidecar is wrong, a file is given twice, the frames cannot be used, or `out`
        is another file.
    PresetError : there is no such sidecar.
    """
    files, empty_files, out = paths(inputs), paths(empty), Path(out)
    refuse_repeated([*files, *empty_files])
    _refuse_out(out, [*files, *empty_files])
    meaning, folder = load_sidecar(sidecar, changes)
    shape = ImageShape(bin_side, size, horizontal_fov_deg)
    capture = read_capture(files, meaning, folder, shape, progress=progress)
    reference = None
    if empty_files:
        reference = read_capture(empty_files, meaning, folder, shape, progress=progress)
    for name, each in (("", capture), ("the empty corner: ", reference)):
        for finding in () if each is None else _defects(each):
            raise CaptureError(f"{name}{finding.sentence}")
    lit = (capture.phasor != 0).all(axis=-1)
    images = {"phasors": capture.phasor}
    if reference is not None:
        lit &= (reference.phasor != 0).all(axis=-1)
        images["reference"] = reference.phasor
    arrays = {name: np.where(lit[..., None], z, 0).astype(np.complex64) for name, z in images.items()}
    contents = FileContents(arrays | {"frequencies_hz": np.array(capture.frequencies_hz)}, [])
    measurement_of(out, contents)  # what prediction will say about it
    calibration = [] if meaning.calibration_file is None else [inside(folder, meaning.calibration_file)]
    sources = [
        {str(file.resolve()): sha256_of(file) for file in each} for each in (files, empty_files, calibration)
    ]
    record_file = record_path(out)
    if out.parent.is_dir():
        for name in (out.name, record_file.name):
            remove_leftovers(out.parent, name)  # of earlier versions
    with whole_files(out.parent, before=lambda: _put_record(stage / record_file.name, out)) as stage:
        with whole_file(stage / out.name) as partial:
            write_measurement(partial, contents.arrays)
        record = ImportRecord(
            schema_version=1,
            measurement_sha256=sha256_of(stage / out.name),
            inputs=sources[0],
            empty_inputs=sources[1],
            sidecar=meaning,
            facts=capture.facts,
            reference_facts=None if reference is None else reference.facts,
            generator=f"night-eval capture import {version('night-nlos')}",
            calibration_inputs=sources[2],
        )
        with whole_file(stage / record_file.name) as partial:
            write_import_record(partial, record)
    return ImportedCapture(capture, reference, out, record_file)


def _put_record(record: Path, out: Path) -> None:
    """Put the record in place, which knows the field of view of the measurement `out`, before that."""
    out.unlink(missing_ok=True)  # an earlier import, which would not fit the new record
    record.replace(record_path(out))


def _defects(capture: Capture) -> Iterator[Finding]:
    """What makes the light useless, whether it shows a wall or, as that of a mirror, none."""
    yield from image_defects(capture.phasor, capture.frequencies_hz)
    height, width, _ = capture.phasor.shape
    rays = pixel_rays(width, height, capture.facts.horizontal_fov_deg)
    yield from depth_defects(capture.phasor, capture.frequencies_hz, rays)


def paths(given: PathLike | Sequence[PathLike]) -> list[Path]:
    """One path or several, as a list."""
    if isinstance(given, (str, os.PathLike)):
        return [Path(given)]
    return [Path(each) for each in given]


def _refuse_out(out: Path, inputs: Sequence[Path]) -> None:
    if out.suffix.lower() not in ENDINGS:
        raise CaptureError(f"{out} must end in {', '.join(ENDINGS)}: prediction reads such files")
    if any(file.exists() and out.exists() and file.samefile(out) for file in inputs):
        raise CaptureError(f"{out} is one of the captured files: give another name to --out")
    refuse_foreign(out)


def _added(capture: Capture, reference: Capture) -> list[str]:
    """What the noise of the reference does: phases over those of the reference have both variances."""
    one, other = capture.facts.noise_rad, reference.facts.noise_rad
    if other is None:
        return ["the empty corner has one frame, so its noise is unknown: capture several"]
    told = f"the reference adds {milliradians(other)} of noise"
    if one is not None:
        both = tuple(float(np.hypot(a, b)) for a, b in zip(one, other, strict=True))
        told += f"; phases over those of the reference have {milliradians(both)}"
    return [told]
