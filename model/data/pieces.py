"""A piece of the shards: a folder with the arrays of consecutive scenes, small enough to read as a whole.

======================  ====================================================================================
``phasors.npy``         (n, H, W, F) complex64
``target.npy``          (n, H, W) complex64, phasor of the mirrored scene at the first frequency
``radial_depth_m.npy``  (n, H, W) float32, metres, 0 on background
``mask.npy``            (n, H, W) uint8, 0 or 1
``piece.json``          SHA-256 of these arrays and of the renders from which they were made
======================  ====================================================================================

Phasors are complex64: half floats cannot represent the hidden 0.2 % of the signal (docs/science/design.md,
Number types).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import TypeAdapter

from disk import FileHashes, whole_folder
from disk.counted import counted
from model.data.array_files import ArrayFile, header_of, is_array_file, read_array
from model.data.manifest import RECORD_FILE, PieceContents, PieceRecord, read_piece_record
from model.data.renders import RenderedScene, ShardError, read_render
from model.data.rows import ARRAYS, RowBlock, RowLayout
from model.settings.run import GroundTruth
from scenegen import Dataset

PIECE_BYTES = 128 * 2**20  # upper limit, unless one scene takes more
PIECE_FILES = (*(f"{name}.npy" for name in ARRAYS), RECORD_FILE)


def scenes_per_piece(layout: RowLayout) -> int:
    """Scenes in a piece: a digit followed by zeros, which keeps the names of the pieces readable."""
    count = max(1, PIECE_BYTES // layout.row_bytes)
    unit = 10 ** (len(str(count)) - 1)
    return int(count // unit * unit)


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
        return f"{counted(len(changed), 'render')} changed, first {changed[0]}"
    if before != contents:
        return f"{folder.name}/{RECORD_FILE} names other renders"
    for array, (dtype, shape) in contents.arrays.items():
        name = f"{array}.npy"
        is_whole = is_array_file(folder / name, dtype, shape)
        if not is_whole or hashes.sha256(folder / name) != record.files.get(name):
            return f"{folder.name}/{name} is missing or damaged"
    return None


def write_piece(
    dataset: Dataset,
    folder: Path,
    contents: PieceContents,
    on_scene: Callable[[], None],
    ground_truth: GroundTruth,
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
            for name, (dtype, shape) in contents.arrays.items():
                stream = stack.enter_context((partial / f"{name}.npy").open("wb"))
                files[name] = ArrayFile(stream, dtype, shape)
            for rendered in _rendered(dataset, contents, ground_truth):
                truth = rendered.truth
                files["phasors"].append(rendered.phasor)
                files["target"].append(truth.phasor)
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
    ShardError : the piece changed after the shards were opened, or holds values that no render has.
    """
    ordered = sorted(rows, key=lambda pair: pair[1])
    changed = ShardError(
        f"{folder} changed while it was in use: another process rebuilt the shards; start again"
    )
    try:
        for name, (dtype, shape) in contents.arrays.items():
            file, array = folder / f"{name}.npy", getattr(block, name)
            if 2 * len(ordered) >= len(contents.scenes):
                whole = read_array(file, dtype, shape)
                for place, row in ordered:
                    array[place] = whole[row]
                del whole  # frees it before the next array is read
            else:
                _read_single_rows(file, dtype, shape, array, ordered)
    except (EOFError, FileNotFoundError, IndexError, ValueError):
        raise changed from None
    record = read_piece_record(folder)
    if record is None or record.contents != contents:
        raise changed
    for name in contents.arrays:
        if not all(_is_possible(name, getattr(block, name)[place]) for place, _ in ordered):
            raise ShardError(
                f"{folder / name}.npy holds NaN, infinite or impossible values, although its record vouches "
                f"for it: delete the folder {folder}, which is then built again"
            )


def _is_possible(name: str, row: NDArray[Any]) -> bool:
    """Whether a row of an array can come from a render: finite, a depth from 0 on, a mask of 0 and 1."""
    if name == "mask":
        return bool(row.max() <= 1)
    with np.errstate(over="ignore", invalid="ignore"):
        is_finite = bool(np.isfinite(row.sum()))  # one pass; NaN and infinity do not leave a sum
    return is_finite and not (name == "radial_depth_m" and row.min() < 0)


def _read_single_rows(
    file: Path,
    dtype: DTypeLike,
    shape: tuple[int, ...],
    array: NDArray[Any],
    rows: Sequence[tuple[int, int]],
) -> None:
    """Copy rows of a ``.npy`` file of this shape into `array`, without reading the other rows."""
    if not is_array_file(file, dtype, shape):
        raise ValueError(file)
    start = len(header_of(dtype, shape))
    with file.open("rb") as stream:
        for place, row in rows:
            target = array[place]
            stream.seek(start + row * target.nbytes)
            if stream.readinto(target) != target.nbytes:
                raise EOFError(file)


def _rendered(
    dataset: Dataset, contents: PieceContents, ground_truth: GroundTruth
) -> Iterator[RenderedScene]:
    """The scenes of a piece, one at a time; `ShardError` if a size is not the piece's."""
    for scene in contents.scenes:
        rendered = read_render(dataset, scene, ground_truth)
        if rendered.truth.mask.shape != (contents.height, contents.width):
            raise ShardError(
                f"wrong resolution between stages: scene {scene} was rendered at {rendered.size} pixels, "
                f"scene {dataset.ids()[0]} at {contents.width}x{contents.height}; render them all at one "
                "resolution"
            )
        yield rendered
