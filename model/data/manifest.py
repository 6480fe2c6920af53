"""What the shards hold and what they were made from: ``manifest.json``, and ``piece.json`` of every piece."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Final, Literal

from numpy.typing import DTypeLike
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from disk import write_text
from disk.contract import STRICT
from disk.plain_file import MOST_LIST_BYTES, read_plain
from disk.quantities import FieldOfView, WholeCount
from model.data.rows import RowLayout
from scenegen import SceneEntry
from scenegen.preset import Preset

SHARD_SCHEMA: Final = 3
MANIFEST_FILE = "manifest.json"
RECORD_FILE = "piece.json"


@dataclass(frozen=True, config=STRICT)
class PieceContents:
    """Sources of a piece; they determine its arrays.

    Attributes
    ----------
    scenes : n scene ids in the order of the rows; the first is the piece's name.
    width, height : image size, pixels.
    frequencies_hz : F modulation frequencies, Hz.
    sources : SHA-256 of every render by its path within the dataset.
    """

    scenes: Annotated[tuple[str, ...], Field(min_length=1)]
    width: WholeCount
    height: WholeCount
    frequencies_hz: tuple[float, ...]
    sources: dict[str, str]

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.scenes[0]

    @property
    def layout(self) -> RowLayout:
        """Shape of a row."""
        return RowLayout(self.width, self.height, len(self.frequencies_hz))

    @property
    def arrays(self) -> dict[str, tuple[DTypeLike, tuple[int, ...]]]:
        """Number type and shape of each array."""
        rows = len(self.scenes)
        return {name: (dtype, (rows, *shape)) for name, (dtype, shape) in self.layout.arrays.items()}


@dataclass(frozen=True, config=STRICT)
class PieceRecord:
    """Contents of ``piece.json``: sources of the piece, and SHA-256 of its files by name."""

    contents: PieceContents
    files: dict[str, str]


@dataclass(frozen=True, config=STRICT)
class ShardManifest:
    """Contents of ``manifest.json``.

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    width, height : image size, pixels.
    preset_sha256 : hash of the dataset's resolved preset; its camera and wall determine the direct return.
    scenes : id, class and split of the scene in each row.
    scenes_per_piece : rows of a piece; the last piece may have fewer.
    pieces : records of the pieces, in the order of the rows.
    reference_sha256 : hash of ``reference.npy``.
    fields_of_view_deg : full horizontal field of view of the scene in each row, degrees; empty if all have
        that of the preset.
    """

    frequencies_hz: tuple[float, ...]
    width: WholeCount
    height: WholeCount
    preset_sha256: str
    scenes: tuple[SceneEntry, ...]
    scenes_per_piece: WholeCount
    pieces: tuple[PieceRecord, ...]
    reference_sha256: str
    schema_version: Literal[3] = SHARD_SCHEMA
    fields_of_view_deg: Annotated[tuple[FieldOfView, ...], Field(exclude_if=lambda value: not value)] = ()

    def __post_init__(self) -> None:
        if len(self.fields_of_view_deg) not in (0, len(self.scenes)):
            raise ValueError(f"{len(self.scenes)} scenes have {len(self.fields_of_view_deg)} fields of view")

    @property
    def layout(self) -> RowLayout:
        """Shape of a row."""
        return RowLayout(self.width, self.height, len(self.frequencies_hz))

    @property
    def data_sha256(self) -> str:
        """One hash of everything that training reads: scenes, splits, preset and renders."""
        sources = sorted(item for piece in self.pieces for item in piece.contents.sources.items())
        seen = (self.preset_sha256, self.scenes, sources)
        return hashlib.sha256(repr(seen).encode()).hexdigest()


def preset_sha256(preset: Preset) -> str:
    """SHA-256 of a resolved preset."""
    return hashlib.sha256(TypeAdapter(Preset).dump_json(preset)).hexdigest()


def read_manifest(folder: Path) -> ShardManifest | None:
    """Manifest of a shard folder; None if it is missing or unreadable."""
    file = folder / MANIFEST_FILE
    try:
        return TypeAdapter(ShardManifest).validate_json(read_plain(file, MOST_LIST_BYTES))
    except (OSError, ValidationError):
        return None


def write_manifest(folder: Path, manifest: ShardManifest) -> None:
    """Write ``manifest.json``."""
    text = TypeAdapter(ShardManifest).dump_json(manifest, indent=1).decode()
    write_text(folder / MANIFEST_FILE, text + "\n")


def read_piece_record(folder: Path) -> PieceRecord | None:
    """Record of a piece; None if it is missing or unreadable. Its arrays are not looked at."""
    file = folder / RECORD_FILE
    try:
        return TypeAdapter(PieceRecord).validate_json(read_plain(file, MOST_LIST_BYTES))
    except (OSError, ValidationError):
        return None
