"""The folder ``renders/<id>/``: names of its files, and the record of a render or of a failure.

``render.json`` is written last: a scene without it is not rendered. It contains nothing that differs between
two runs of the same work (no time, no host): the same scene and the same settings give the same bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from scenegen.contract import STRICT, ContractError, checked
from scenegen.files.whole_files import write_text

MEASUREMENT_FILE, GROUND_TRUTH_FILE = "itof.exr", "mirrored.exr"
TRANSIENT_FILE, MIRRORED_TRANSIENT_FILE = "transient.exr", "mirrored_transient.exr"
IMAGE_FILES = (MEASUREMENT_FILE, GROUND_TRUTH_FILE)
TRANSIENT_FILES = (TRANSIENT_FILE, MIRRORED_TRANSIENT_FILE)
RECORD_FILE, FAILURE_FILE, FAILURE_LOG = "render.json", "failure.json", "failure.log"
Contents = TypeVar("Contents")
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


@dataclass(frozen=True, config=STRICT)
class FileRecord:
    """Size in bytes and SHA-256 of one rendered file."""

    bytes: Annotated[int, Field(ge=0)]
    sha256: Sha256


@dataclass(frozen=True, config=STRICT)
class RenderRecord:
    """Contents of ``render.json``.

    Attributes
    ----------
    recipe : everything that the pixels depend on, as JSON text. Equal recipes give equal pixels, except for
        rounding on another device or in another version.
    attributes : provenance of the measurement, text by name, as in the header of ``itof.exr``.
    files : the scene's files, by name.
    """

    recipe: str
    attributes: dict[str, str]
    files: dict[str, FileRecord]
    schema_version: Literal[1] = 1


@dataclass(frozen=True, config=STRICT)
class FailureRecord:
    """Contents of ``failure.json``, for a scene that could not be rendered.

    Attributes
    ----------
    recipe : the recipe that was tried, as in `RenderRecord`.
    attempts : number of attempts.
    reason : the last error, as a sentence.
    """

    recipe: str
    attempts: Annotated[int, Field(ge=1)]
    reason: str
    schema_version: Literal[1] = 1


def read_record(folder: Path) -> RenderRecord | None:
    """Record of a render folder; None when it is missing or damaged."""
    return _read(TypeAdapter(RenderRecord), folder / RECORD_FILE)


def write_record(folder: Path, record: RenderRecord) -> None:
    """Write ``render.json``, complete or not at all."""
    write_text(folder / RECORD_FILE, TypeAdapter(RenderRecord).dump_json(record, indent=1).decode() + "\n")


def read_failure(folder: Path) -> FailureRecord | None:
    """Failure record of a render folder; None when it is missing or damaged."""
    return _read(TypeAdapter(FailureRecord), folder / FAILURE_FILE)


def write_failure(folder: Path, failure: FailureRecord, log: str) -> None:
    """Write ``failure.log`` and ``failure.json``, each complete or not at all."""
    write_text(folder / FAILURE_LOG, log)
    write_text(folder / FAILURE_FILE, TypeAdapter(FailureRecord).dump_json(failure, indent=1).decode() + "\n")


def remove_failure(folder: Path) -> None:
    """Remove the failure record and its log, if there are any."""
    for name in (FAILURE_FILE, FAILURE_LOG):
        (folder / name).unlink(missing_ok=True)


def _read(adapter: TypeAdapter[Contents], file: Path) -> Contents | None:
    try:
        contents: Contents = checked(adapter, file.read_bytes(), str(file))
    except (OSError, ContractError):
        return None
    return contents
