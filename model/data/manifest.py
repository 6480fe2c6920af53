"""``manifest.json`` of the shards: their contents and the data from which they were made."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from model.data.pieces import PieceRecord
from model.data.rows import RowLayout
from scenegen import SceneEntry
from scenegen.preset import Preset
from storage import write_text
from storage.contract import STRICT
from storage.plain_file import read_plain
from storage.quantities import FieldOfView, WholeCount

SHARD_SCHEMA: Final = 2
MANIFEST_FILE = "manifest.json"
_MOST_BYTES: Final = 2**30  # a million scenes take 300 MB


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
    schema_version: Literal[2] = SHARD_SCHEMA
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
        return TypeAdapter(ShardManifest).validate_json(read_plain(file, _MOST_BYTES))
    except (OSError, ValidationError):
        return None


def write_manifest(folder: Path, manifest: ShardManifest) -> None:
    """Write ``manifest.json``."""
    text = TypeAdapter(ShardManifest).dump_json(manifest, indent=1).decode()
    write_text(folder / MANIFEST_FILE, text + "\n")
