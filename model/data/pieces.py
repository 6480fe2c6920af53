"""A piece of the shards: a folder with the arrays of consecutive scenes, small enough to read in one go.

``phasors.npy`` (n, 2F, H, W: F real parts, then F imaginary parts), ``target.npy`` (n, 2, H, W),
``radial_depth_m.npy`` (n, H, W), ``mask.npy`` (n, H, W, uint8), and ``piece.json``, which knows the SHA-256
of the renders they were made of and of the arrays. Half floats would destroy the hidden 0.1-0.3 % of the
signal (docs/design.md, Number types), so phasors are float32.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from itof import split_components
from model.data.renders import RenderedScene, ShardError, read_render
from model.data.rows import ARRAYS, RowBlock, RowLayout
from scenegen import Dataset, FileHashes, whole_folder
from scenegen.contract import STRICT, WholeCount

PIECE_BYTES = 128 * 2**20  # at most, unless one scene takes more
RECORD_FILE = "piece.json"


@dataclass(frozen=True, config=STRICT)
class PieceContents:
    """What a piece is made of; equal contents, equal arrays.

    Attributes
    ----------
    scenes : n ids in the order of the rows; the first is the piece's name.
    width, height : image size, pixels.
    frequencies_hz : F modulation frequencies, Hz.
    sources : SHA-256 of every render, by its path in the dataset.
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


@dataclass(frozen=True, config=STRICT)
class PieceRecord:
    """Contents of ``piece.json``: what a piece is made of, and the SHA-256 of its files by name."""

    contents: PieceContents
    files: dict[str, str]


def scenes_per_piece(layout: RowLayout) -> int:
    """How many scenes a piece takes: one digit and zeros, which keeps the pieces' names readable."""
    count = max(1, PIECE_BYTES // layout.row_bytes)
    unit = 10 ** (len(str(count)) - 1)
    return int(count // unit * unit)


def read_piece_record(folder: Path) -> PieceRecord | None:
    """Record of a piece; None when there is none, or none that can be read."""
    try:
        return TypeAdapter(PieceRecord).validate_json((folder / RECORD_FILE).read_bytes())
    except (OSError, ValidationError):
        return None


def why_stale(folder: Path, contents: PieceContents, hashes: FileHashes) -> str | None:
    """What keeps a piece on disk from being used, in words; None when nothing does."""
    record = read_piece_record(folder)
    if record is None:
        what = f"/{RECORD_FILE} cannot be used" if folder.exists() else " is not there yet"
        return folder.name + what
    before = record.contents
    if before.scenes != contents.scenes:
        return "the list of scenes changed"
    if before.frequencies_hz != contents.frequencies_hz or before.layout != contents.layout:
        return "image size or frequencies changed"
    changed = sorted(n for n, digest in contents.sources.items() if before.sources.get(n) != digest)
    if changed:
        return f"{len(changed)} renders changed, first {changed[0]}"
    damaged = [name for name in _files() if _damaged(folder / name, record.files.get(name), hashes)]
    return f"{folder.name}/{damaged[0]} is missing or damaged" if damaged else None


def write_piece(
    dataset: Dataset, folder: Path, contents: PieceContents, on_scene: Callable[[], None]
) -> None:
    """Write a piece, whole or not at all; memory stays that of one scene.

    Raises
    ------
    ShardError, ImageFileError : a render that cannot be used, or of another size than the piece's.
    """
    layout = contents.layout
    with whole_folder(folder) as partial:
        with ExitStack() as stack:
            files = {
                name: _ArrayFile(
                    stack.enter_context((partial / f"{name}.npy").open("wb")),
                    *(dtype, (len(contents.scenes), *shape)),
                )
                for name, (dtype, shape) in layout.arrays.items()
            }
            for rendered in _rendered(dataset, contents):
                files["phasors"].append(np.moveaxis(split_components(rendered.phasor), -1, 0))
                truth = rendered.truth
                files["target"].append(np.stack([truth.phasor.real, truth.phasor.imag]))
                files["radial_depth_m"].append(truth.radial_depth_m)
                files["mask"].append(truth.mask)
                on_scene()
        record = PieceRecord(contents, {f"{name}.npy": file.sha256() for name, file in files.items()})
        (partial / RECORD_FILE).write_bytes(TypeAdapter(PieceRecord).dump_json(record, indent=1) + b"\n")


def read_rows(
    folder: Path, contents: PieceContents, block: RowBlock, rows: Sequence[tuple[int, int]]
) -> None:
    """Fill places of `block` with rows of a piece, given as pairs (place, row of the piece).

    A piece that is wanted by half or more is read as a whole; of others the rows alone, front to back.

    Raises
    ------
    ShardError : the piece is not the one that was opened any more.
    """
    ordered = sorted(rows, key=lambda pair: pair[1])
    changed = ShardError(
        f"{folder} changed while it was in use: something else renewed the shards; start again"
    )
    try:
        for name in ARRAYS:
            file, array = folder / f"{name}.npy", getattr(block, name)
            if 2 * len(ordered) >= len(contents.scenes):  # 2: half of them
                whole = np.load(file, allow_pickle=False)
                for place, row in ordered:
                    array[place] = whole[row]
                del whole  # before the next array comes
            else:
                _read_single_rows(file, array, ordered)
    except (EOFError, FileNotFoundError, IndexError, ValueError):
        raise changed from None
    record = read_piece_record(folder)
    if record is None or record.contents != contents:
        raise changed


def _read_single_rows(file: Path, array: NDArray[np.generic], rows: Sequence[tuple[int, int]]) -> None:
    with file.open("rb") as stream:
        np.lib.format.read_magic(stream)
        np.lib.format.read_array_header_1_0(stream)
        start = stream.tell()
        for place, row in rows:
            target = memoryview(array[place]).cast("B")
            stream.seek(start + row * len(target))
            if stream.readinto(target) != len(target):
                raise EOFError(file)


def _rendered(dataset: Dataset, contents: PieceContents) -> Iterator[RenderedScene]:
    """The scenes of a piece, one at a time, all of its size."""
    for scene in contents.scenes:
        rendered = read_render(dataset, scene)
        if rendered.truth.mask.shape != (contents.height, contents.width):
            raise ShardError(
                f"wrong resolution between stages: scene {scene} was rendered at {rendered.size} pixels, "
                f"scene {dataset.ids()[0]} at {contents.width}x{contents.height}; render them all at one "
                "resolution"
            )
        yield rendered


def _files() -> list[str]:
    return [f"{name}.npy" for name in ARRAYS]


def _damaged(file: Path, digest: str | None, hashes: FileHashes) -> bool:
    try:
        return hashes.sha256(file) != digest
    except OSError:
        return True


class _ArrayFile:
    """A ``.npy`` file that grows row by row, and its hash."""

    def __init__(self, stream: BinaryIO, dtype: DTypeLike, shape: tuple[int, ...]) -> None:
        self._stream, self._dtype, self._hash = stream, np.dtype(dtype), hashlib.sha256()
        header = io.BytesIO()
        description = np.lib.format.dtype_to_descr(self._dtype)
        np.lib.format.write_array_header_1_0(
            header, {"descr": description, "fortran_order": False, "shape": shape}
        )
        self._write(header.getvalue())

    def append(self, row: NDArray[np.generic]) -> None:
        self._write(np.ascontiguousarray(row, self._dtype).tobytes())

    def sha256(self) -> str:
        return self._hash.hexdigest()

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._hash.update(data)
