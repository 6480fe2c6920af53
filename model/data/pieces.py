"""A piece of the shards: a folder with the arrays of consecutive scenes, small enough to read as a whole.

======================  ====================================================================================
``phasors.npy``         (n, 2F, H, W) float32, F real parts, then F imaginary parts
``target.npy``          (n, 2, H, W) float32, Re and Im of the mirrored scene
``radial_depth_m.npy``  (n, H, W) float32, metres, 0 on background
``mask.npy``            (n, H, W) uint8, 0 or 1
``piece.json``          SHA-256 of these arrays and of the renders from which they were made
======================  ====================================================================================

Phasors are float32: half floats cannot represent the hidden 0.2 % of the signal (docs/science/design.md,
Number types).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from numpy.typing import DTypeLike
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from model.data.array_files import is_array_file
from model.data.rows import ARRAYS, RowLayout
from storage import FileHashes
from storage.contract import STRICT
from storage.plain_file import read_plain
from storage.quantities import WholeCount

PIECE_BYTES = 128 * 2**20  # upper limit, unless one scene takes more
RECORD_FILE = "piece.json"
_MOST_BYTES = 2**28  # of a record
PIECE_FILES = (*(f"{name}.npy" for name in ARRAYS), RECORD_FILE)


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


def scenes_per_piece(layout: RowLayout) -> int:
    """Scenes in a piece: a digit followed by zeros, which keeps the names of the pieces readable."""
    count = max(1, PIECE_BYTES // layout.row_bytes)
    unit = 10 ** (len(str(count)) - 1)
    return int(count // unit * unit)


def read_piece_record(folder: Path) -> PieceRecord | None:
    """Record of a piece; None if it is missing or unreadable. Its arrays are not looked at."""
    file = folder / RECORD_FILE
    try:
        return TypeAdapter(PieceRecord).validate_json(read_plain(file, _MOST_BYTES))
    except (OSError, ValidationError):
        return None


def has_its_arrays(folder: Path, contents: PieceContents) -> bool:
    """Whether the arrays of a piece have the number types and sizes that `contents` says."""
    return all(
        is_array_file(folder / f"{name}.npy", dtype, shape)
        for name, (dtype, shape) in contents.arrays.items()
    )


def why_stale(folder: Path, contents: PieceContents, hashes: FileHashes) -> str | None:
    """Reason for which a piece on disk must be rebuilt, in words; None if it can be used."""
    record = read_piece_record(folder)
    if record is None and not folder.exists():
        return f"{folder.name} does not exist yet"
    if record is None:
        return f"{folder.name}/{RECORD_FILE} is missing or damaged"
    before = record.contents
    if before.scenes != contents.scenes:
        return "the list of scenes changed"
    if before.frequencies_hz != contents.frequencies_hz or before.layout != contents.layout:
        return "image size or frequencies changed"
    changed = sorted(n for n, digest in contents.sources.items() if before.sources.get(n) != digest)
    if changed:
        return f"{len(changed)} renders changed, first {changed[0]}"
    if before != contents:
        return f"{folder.name}/{RECORD_FILE} names other renders"
    for array, (dtype, shape) in contents.arrays.items():
        name = f"{array}.npy"
        is_whole = is_array_file(folder / name, dtype, shape)
        if not is_whole or hashes.sha256(folder / name) != record.files.get(name):
            return f"{folder.name}/{name} is missing or damaged"
    return None
