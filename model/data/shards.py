"""Shards: a dataset's renders as float32 arrays that training reads, in pieces of at most 128 MiB.

``shards/`` of a dataset holds a folder for every piece (`model.data.pieces`), named after its first scene,
``reference.npy`` (2F, H, W: the direct return of the bare relay wall) and ``manifest.json``, which comes
last and says which pieces belong together. Renewing them touches only pieces whose renders changed.
"""

from __future__ import annotations

import hashlib
import logging
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from itof import join_components, split_components
from model.data.pieces import (
    PieceContents,
    PieceRecord,
    read_piece_record,
    read_rows,
    scenes_per_piece,
    why_stale,
    write_piece,
)
from model.data.renders import ShardError, read_render, source_hashes
from model.data.rows import ARRAYS, RowBlock, RowLayout
from model.network.wall_view import wall_view
from scenegen import (
    Dataset,
    FileHashes,
    SceneEntry,
    Split,
    read_failure,
    whole_file,
    write_text,
)
from scenegen.contract import STRICT, WholeCount
from scenegen.files.whole_files import remove_leftovers
from scenegen.preset import Preset
from scenegen.progress import showing_progress

SHARD_SCHEMA: Final = 2
_log = logging.getLogger(__name__)


@dataclass(frozen=True, config=STRICT)
class ShardManifest:
    """Contents of ``manifest.json``: what the arrays hold and what they were made of.

    Attributes
    ----------
    frequencies_hz : F modulation frequencies, Hz.
    width, height : image size, pixels.
    preset_sha256 : of the dataset's resolved preset (camera and relay wall shape the reference).
    scenes : id, class and split of each row, through all pieces.
    scenes_per_piece : rows of a piece; the last may have fewer.
    pieces : records of the pieces, in the order of the rows.
    reference_sha256 : of ``reference.npy``.
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

    @property
    def layout(self) -> RowLayout:
        """Shape of a row."""
        return RowLayout(self.width, self.height, len(self.frequencies_hz))

    @property
    def data_sha256(self) -> str:
        """One hash for all that training could see: scenes, splits, preset and renders."""
        sources = sorted(item for piece in self.pieces for item in piece.contents.sources.items())
        seen = (self.preset_sha256, self.scenes, sources)
        return hashlib.sha256(repr(seen).encode()).hexdigest()


@plain_dataclass(frozen=True)
class Shards:
    """Opened shards; rows are numbered through all pieces and read when they are asked for.

    Attributes
    ----------
    folder : where they are.
    manifest : what they hold.
    reference : (H, W, F) complex, the direct return of the bare relay wall.
    """

    folder: Path
    manifest: ShardManifest
    reference: NDArray[np.complex128]

    def rows(self, split: Split) -> list[int]:
        """Rows that belong to a split, in scene order."""
        return [row for row, scene in enumerate(self.manifest.scenes) if scene.split == split]

    def ids(self, rows: Iterable[int]) -> list[str]:
        """Scene ids of rows."""
        return [self.manifest.scenes[row].id for row in rows]

    def read(self, rows: Sequence[int]) -> RowBlock:
        """Some rows, read from disk now, piece by piece and each from front to back.

        Raises
        ------
        ShardError : shards that were renewed since they were opened.
        """
        block = self.manifest.layout.empty(rows)
        wanted: dict[int, list[tuple[int, int]]] = {}
        for place, row in enumerate(rows):
            piece, row_of_piece = divmod(row, self.manifest.scenes_per_piece)
            wanted.setdefault(piece, []).append((place, row_of_piece))
        for piece, pairs in sorted(wanted.items()):
            contents = self.manifest.pieces[piece].contents
            read_rows(self.folder / contents.name, contents, block, pairs)
        return block

    def complex_phasors(self, rows: Sequence[int]) -> NDArray[np.complex128]:
        """(n, H, W, F) phasors of some rows, read from disk now."""
        return self.read(rows).complex_phasors()


def open_shards(dataset: Dataset, *, progress: bool = False) -> Shards:
    """Shards of a dataset; what is missing of them or does not fit its renders any more is built first.

    An interrupted build goes on with the piece it was at. Files that did not change since the last time
    are not read again. Scenes that night-render has given up (they have a ``failure.json``) are left out.

    Raises
    ------
    ShardError, ImageFileError : renders that are missing, damaged, not finite or of several sizes.
    OSError : the disk is full.
    """
    hashes = FileHashes(dataset.root)
    try:
        return _renew(_without_failures(dataset), hashes, progress)
    finally:
        hashes.save()


def _without_failures(dataset: Dataset) -> Dataset:
    """The dataset without the scenes that could not be rendered."""
    scenes = dataset.index.scenes
    failed = {scene.id for scene in scenes if read_failure(dataset.render_folder(scene.id)) is not None}
    if not failed:
        return dataset
    if len(failed) == len(scenes):
        raise ShardError(f"no scene of {dataset.root} could be rendered: see night-render --status")
    _log.warning("%d scenes that could not be rendered are left out, first %s", len(failed), min(failed))
    kept = tuple(scene for scene in scenes if scene.id not in failed)
    return Dataset(dataset.root, replace(dataset.index, scenes=kept))


def preset_sha256(preset: Preset) -> str:
    """SHA-256 of a resolved preset."""
    return hashlib.sha256(TypeAdapter(Preset).dump_json(preset)).hexdigest()


def _renew(dataset: Dataset, hashes: FileHashes, progress: bool) -> Shards:
    """Bring pieces, reference and manifest up to date, in this order, and open them."""
    folder = dataset.shard_folder
    sources = source_hashes(dataset, hashes)
    layout = _layout(dataset, sources)
    pieces = _pieces(dataset, layout, sources)
    reasons = {piece.name: why_stale(folder / piece.name, piece, hashes) for piece in pieces}
    stale = [piece for piece in pieces if reasons[piece.name]]
    before = _read_manifest(folder)
    _remove_surplus(folder, {piece.name for piece in pieces})
    if stale:
        reason = reasons[stale[0].name]
        _log.info("building %d of %d pieces of %s: %s", len(stale), len(pieces), folder, reason)
        (folder / "manifest.json").unlink(missing_ok=True)
        _write_pieces(dataset, stale, progress)
        for piece in stale:
            why_stale(folder / piece.name, piece, hashes)  # read while the disk's cache holds it: remembered
    manifest = ShardManifest(
        frequencies_hz=dataset.preset.itof.frequencies_hz,
        width=layout.width,
        height=layout.height,
        preset_sha256=preset_sha256(dataset.preset),
        scenes=dataset.index.scenes,
        scenes_per_piece=scenes_per_piece(layout),
        pieces=tuple(_record(folder / piece.name) for piece in pieces),
        reference_sha256=_renew_reference(dataset, layout, before, hashes),
    )
    if stale or manifest != before:
        text = TypeAdapter(ShardManifest).dump_json(manifest, indent=1).decode()
        write_text(folder / "manifest.json", text + "\n")
    reference = np.load(folder / "reference.npy", allow_pickle=False)  # (2F, H, W)
    return Shards(folder, manifest, join_components(np.moveaxis(reference, 0, -1)))


def _layout(dataset: Dataset, sources: Mapping[str, Mapping[str, str]]) -> RowLayout:
    """Shape of a row, by the first scene; its images are read only when no piece knows it."""
    first = dataset.ids()[0]
    frequencies_hz = dataset.preset.itof.frequencies_hz
    record = read_piece_record(dataset.shard_folder / first)
    if record and sources[first].items() <= record.contents.sources.items():
        return RowLayout(record.contents.width, record.contents.height, len(frequencies_hz))
    height, width = read_render(dataset, first).truth.mask.shape
    return RowLayout(width, height, len(frequencies_hz))


def _pieces(
    dataset: Dataset, layout: RowLayout, sources: Mapping[str, Mapping[str, str]]
) -> list[PieceContents]:
    """What each piece has to be made of."""
    scenes, count = dataset.ids(), scenes_per_piece(layout)
    return [
        PieceContents(
            scenes=tuple(chosen),
            width=layout.width,
            height=layout.height,
            frequencies_hz=dataset.preset.itof.frequencies_hz,
            sources={name: digest for scene in chosen for name, digest in sources[scene].items()},
        )
        for chosen in (scenes[start : start + count] for start in range(0, len(scenes), count))
    ]


def _write_pieces(dataset: Dataset, pieces: Sequence[PieceContents], progress: bool) -> None:
    count = sum(len(piece.scenes) for piece in pieces)
    with showing_progress(count, "scene", "shards", show=progress) as bar:
        for piece in pieces:
            write_piece(dataset, dataset.shard_folder / piece.name, piece, bar.update)


def _record(piece: Path) -> PieceRecord:
    record = read_piece_record(piece)
    if record is None:
        raise ShardError(f"{piece} is gone: something else is renewing the shards; start again")
    return record


def _renew_reference(
    dataset: Dataset, layout: RowLayout, before: ShardManifest | None, hashes: FileHashes
) -> str:
    """Write ``reference.npy`` unless the one there is right; its SHA-256."""
    file = dataset.shard_folder / "reference.npy"
    asked = (preset_sha256(dataset.preset), layout)
    if before and (before.preset_sha256, before.layout) == asked:
        try:
            if hashes.sha256(file) == before.reference_sha256:
                return before.reference_sha256
        except OSError:
            _log.info("%s is missing", file)
    reference = wall_view(dataset).direct_phasors(
        layout.width, layout.height, dataset.preset.itof.frequencies_hz
    )
    components = split_components(reference)  # (H, W, 2F)
    with whole_file(file) as partial, partial.open("wb") as stream:
        np.save(stream, np.moveaxis(components, -1, 0).astype(np.float32))
    return hashes.sha256(file)


def _read_manifest(folder: Path) -> ShardManifest | None:
    try:
        return TypeAdapter(ShardManifest).validate_json((folder / "manifest.json").read_bytes())
    except (OSError, ValidationError):
        return None


def _remove_surplus(folder: Path, pieces: set[str]) -> None:
    """Remove pieces of another layout, the arrays of schema version 1 and what killed processes left."""
    if not folder.is_dir():
        return
    remove_leftovers(folder)
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name.isdigit() and entry.name not in pieces:
            shutil.rmtree(entry)
        elif entry.name in {f"{name}.npy" for name in ARRAYS}:
            entry.unlink()
