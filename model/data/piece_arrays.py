"""Writing and reading the arrays of a piece (`model.data.pieces`)."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import TypeAdapter

from itof import split_components
from model.data.pieces import RECORD_FILE, PieceContents, PieceRecord, read_piece_record
from model.data.renders import RenderedScene, ShardError, read_render
from model.data.rows import ARRAYS, RowBlock
from scenegen import Dataset, whole_folder


def write_piece(
    dataset: Dataset, folder: Path, contents: PieceContents, on_scene: Callable[[], None]
) -> None:
    """Write a piece, whole or not at all; memory holds one scene at a time.

    Parameters
    ----------
    on_scene : called after every scene.

    Raises
    ------
    ShardError, ImageFileError : a render cannot be used, or its size is not the piece's.
    """
    with whole_folder(folder) as partial:
        with ExitStack() as stack:
            files = {}
            for name, (dtype, shape) in contents.layout.arrays.items():
                stream = stack.enter_context((partial / f"{name}.npy").open("wb"))
                files[name] = _ArrayFile(stream, dtype, (len(contents.scenes), *shape))
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
    """Copy rows of a piece into `block`.

    If at least half of the piece is needed, it is read as a whole; otherwise only the rows, in file order.

    Parameters
    ----------
    rows : pairs (place in `block`, row of the piece).

    Raises
    ------
    ShardError : the piece changed after the shards were opened.
    """
    ordered = sorted(rows, key=lambda pair: pair[1])
    changed = ShardError(
        f"{folder} changed while it was in use: another process rebuilt the shards; start again"
    )
    try:
        for name in ARRAYS:
            file, array = folder / f"{name}.npy", getattr(block, name)
            if 2 * len(ordered) >= len(contents.scenes):
                whole = np.load(file, allow_pickle=False)
                for place, row in ordered:
                    array[place] = whole[row]
                del whole  # frees it before the next array is read
            else:
                _read_single_rows(file, array, ordered)
    except (EOFError, FileNotFoundError, IndexError, ValueError):
        raise changed from None
    record = read_piece_record(folder)
    if record is None or record.contents != contents:
        raise changed


def _read_single_rows(file: Path, array: NDArray[np.generic], rows: Sequence[tuple[int, int]]) -> None:
    """Copy rows of a ``.npy`` file into `array`, without reading the other rows."""
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
    """The scenes of a piece, one at a time; `ShardError` if a size is not the piece's."""
    for scene in contents.scenes:
        rendered = read_render(dataset, scene)
        if rendered.truth.mask.shape != (contents.height, contents.width):
            raise ShardError(
                f"wrong resolution between stages: scene {scene} was rendered at {rendered.size} pixels, "
                f"scene {dataset.ids()[0]} at {contents.width}x{contents.height}; render them all at one "
                "resolution"
            )
        yield rendered


class _ArrayFile:
    """A ``.npy`` file that is written row by row, and its SHA-256."""

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
