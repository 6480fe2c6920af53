"""The record of an import: a JSON file beside the measurement file, with where it comes from."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Literal

from pydantic import AliasChoices, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk import NightError, sha256_of
from disk.contract import STRICT, checked
from disk.plain_file import read_plain
from itof.capture.facts import CaptureFacts
from itof.capture.sidecar import CaptureError, Sidecar


@dataclass(frozen=True, config=STRICT)
class ImportRecord:
    """Where a measurement file comes from.

    Attributes
    ----------
    schema_version : 1.
    measurement_sha256 : of the measurement file that this record is about.
    inputs, empty_inputs : the captured files and their SHA-256.
    calibration_inputs : the same for the calibration file, if the sidecar names one.
    sidecar : what the frames meant, with all keys.
    facts : of the capture; reference_facts : of that of the empty corner, if there is one.
    generator : the program and its version.
    """

    schema_version: Literal[1]
    measurement_sha256: str
    inputs: dict[str, str]
    empty_inputs: dict[str, str]
    sidecar: Sidecar
    facts: CaptureFacts
    reference_facts: CaptureFacts | None
    generator: str
    calibration_inputs: dict[str, str] = Field(
        default_factory=dict, validation_alias=AliasChoices("calibration_inputs", "dark_inputs")
    )

    def __post_init__(self) -> None:
        count = len(self.sidecar.frequencies_hz)
        for facts in (self.facts, self.reference_facts):
            if facts is not None and {len(facts.drift_rad), len(facts.noise_rad or facts.drift_rad)} != {
                count
            }:
                raise ValueError(f"noise_rad and drift_rad must have {count} values, one for each frequency")


def record_path(measurement: Path) -> Path:
    """Path of the record of a measurement file."""
    return measurement.with_name(f"{measurement.name}.json")


def write_import_record(partial: Path, record: ImportRecord) -> None:
    """Write the record to a temporary file."""
    partial.write_text(json.dumps(asdict(record), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_import_record(measurement: Path) -> ImportRecord | None:
    """The record beside a measurement file; None if there is none, or if it is that of another file."""
    record = _parsed(record_path(measurement))
    return record if record is not None and record.measurement_sha256 == sha256_of(measurement) else None


def _parsed(path: Path) -> ImportRecord | None:
    """The record in a file; None if there is none."""
    try:
        text = read_plain(path)
        record: ImportRecord = checked(TypeAdapter(ImportRecord), text, str(path), CaptureError)
    except (OSError, NightError):
        return None
    return record


def imported_fov_deg(measurement: Path) -> float | None:
    """Horizontal field of view of the images in a measurement file, degrees; None without file or record."""
    record = read_import_record(measurement) if measurement.is_file() else None
    return None if record is None else record.facts.horizontal_fov_deg


def refuse_foreign(measurement: Path) -> None:
    """Refuse to replace files that no import has written.

    Raises
    ------
    CaptureError : there is a measurement file without its record, or another file where the record goes.
    """
    there = [path for path in (measurement, record_path(measurement)) if path.exists() or path.is_symlink()]
    if measurement.is_file():
        ours = read_import_record(measurement)
    else:  # a killed import leaves the record of a measurement that is not there
        ours = _parsed(record_path(measurement)) if there == [record_path(measurement)] else None
    if there and ours is None:
        raise CaptureError(
            f"{there[0]} is there and is not what an import wrote: give another name to --out, or move it "
            "away"
        )
