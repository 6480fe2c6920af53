"""The folder ``renders/<id>/``: names of its files, and the record of a render or of a failure.

``render.json`` is written last: a scene without it is not rendered. It contains nothing that differs between
two runs of the same work (no time, no host): the same scene and the same settings give the same bytes.

``bad.json`` remembers a render that ``night-render verify`` found wrong, though its files are as they were
written. If the next render of the scene has the same bytes, the fault is in the program.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from disk.contract import STRICT, ContractError, checked
from disk.file_hashes import sha256_of
from disk.path_like import PathLike
from disk.plain_file import read_plain
from disk.whole_writing import write_text

MEASUREMENT_FILE, GROUND_TRUTH_FILE = "itof.exr", "mirrored.exr"
TRANSIENT_FILE, MIRRORED_TRANSIENT_FILE = "transient.exr", "mirrored_transient.exr"
IMAGE_FILES = (MEASUREMENT_FILE, GROUND_TRUTH_FILE)
TRANSIENT_FILES = (TRANSIENT_FILE, MIRRORED_TRANSIENT_FILE)
RECORD_FILE, FAILURE_FILE, FAILURE_LOG = "render.json", "failure.json", "failure.log"
BAD_FILE = "bad.json"
Contents = TypeVar("Contents")
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
# The name of a file in a record becomes part of a path, so it must be one of the names above.
RenderFileName = Annotated[str, Field(pattern=r"^(mirrored_)?transient\.exr$|^(itof|mirrored)\.exr$")]


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
    files: dict[RenderFileName, FileRecord]
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


@dataclass(frozen=True, config=STRICT)
class BadRender:
    """Contents of ``bad.json``: a render that is wrong though its files are as they were written.

    Attributes
    ----------
    recipe, files : as in its `RenderRecord`, which was deleted so that the scene is rendered again.
    problems : what was found wrong, as sentences.
    """

    recipe: str
    files: dict[RenderFileName, FileRecord]
    problems: tuple[str, ...]
    schema_version: Literal[1] = 1

    def is_again(self, record: RenderRecord) -> bool:
        """Whether a render has the same bytes: then rendering once more does not help."""
        return (self.recipe, self.files) == (record.recipe, record.files)


_RECORD, _FAILURE = TypeAdapter(RenderRecord), TypeAdapter(FailureRecord)
_BAD = TypeAdapter(BadRender)


def read_recipe(recipe: str) -> dict[str, Any]:
    """Contents of a recipe; an empty dictionary if the text is not a recipe."""
    try:
        content = json.loads(recipe)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def read_record(folder: PathLike) -> RenderRecord | None:
    """Record of a render folder; None when it is missing or damaged."""
    return _read(_RECORD, Path(folder, RECORD_FILE))


def record_text(record: RenderRecord) -> str:
    """Contents of ``render.json``."""
    return _text(_RECORD, record)


def write_record(folder: PathLike, record: RenderRecord) -> None:
    """Write ``render.json``, complete or not at all."""
    write_text(Path(folder, RECORD_FILE), _text(_RECORD, record))


def difference(file: Path, expected: FileRecord) -> str | None:
    """How a file differs from its record, as a predicate; None if it is the recorded one.

    Raises
    ------
    OSError : the file cannot be read.
    """
    if not file.is_file():
        return "is missing"
    if file.stat().st_size != expected.bytes:
        return f"has {file.stat().st_size} bytes instead of {expected.bytes}"
    if sha256_of(file) != expected.sha256:
        return "is not what was written (its SHA-256 differs)"
    return None


def read_failure(folder: PathLike) -> FailureRecord | None:
    """Failure record of a render folder; None when it is missing or damaged."""
    return _read(_FAILURE, Path(folder, FAILURE_FILE))


def write_failure(folder: PathLike, failure: FailureRecord, log: str) -> None:
    """Write ``failure.log`` and ``failure.json``, each complete or not at all."""
    write_text(Path(folder, FAILURE_LOG), log)
    write_text(Path(folder, FAILURE_FILE), _text(_FAILURE, failure))


def remove_failure(folder: PathLike) -> None:
    """Remove the failure record and its log, if there are any."""
    for name in (FAILURE_FILE, FAILURE_LOG):
        Path(folder, name).unlink(missing_ok=True)


def read_bad_render(folder: PathLike) -> BadRender | None:
    """The bad render that a render folder remembers; None when ``bad.json`` is missing or damaged."""
    return _read(_BAD, Path(folder, BAD_FILE))


def write_bad_render(folder: PathLike, bad: BadRender) -> None:
    """Write ``bad.json``, complete or not at all."""
    write_text(Path(folder, BAD_FILE), _text(_BAD, bad))


def forget_bad_render(folder: PathLike, record: RenderRecord) -> None:
    """Remove ``bad.json``, unless `record` is a render with the same bytes."""
    bad = read_bad_render(folder)
    if bad is None or not bad.is_again(record):
        Path(folder, BAD_FILE).unlink(missing_ok=True)


def _read(adapter: TypeAdapter[Contents], file: Path) -> Contents | None:
    try:
        contents: Contents = checked(adapter, read_plain(file), str(file))
    except (OSError, ContractError):
        return None
    return contents


def _text(adapter: TypeAdapter[Contents], contents: Contents) -> str:
    return adapter.dump_json(contents, indent=1).decode() + "\n"
