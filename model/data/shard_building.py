"""Building shards: compares them with the renders and writes the parts that are missing or out of date."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from numpy.typing import DTypeLike

from disk import FileHashes, inside, whole_file
from disk.own_files import other_files
from disk.partials import remove_leftovers
from model.data.array_files import ArrayFile, is_array_file
from model.data.corner import wall_view
from model.data.manifest import (
    MANIFEST_FILE,
    PieceContents,
    PieceRecord,
    ShardManifest,
    preset_sha256,
    read_manifest,
    read_piece_record,
    write_manifest,
)
from model.data.pieces import PIECE_FILES, has_its_arrays, scenes_per_piece, why_stale, write_piece
from model.data.renders import ShardError, read_render, source_hashes
from model.data.rows import RowLayout
from model.settings.run import GroundTruth
from processes.progress import showing_progress
from scenegen import Dataset

REFERENCE_FILE = "reference.npy"
_log = logging.getLogger(__name__)


def shard_folder(dataset: Dataset, ground_truth: GroundTruth) -> Path:
    """The folder of the shards with this ground truth."""
    folder = dataset.shard_folder
    return folder if ground_truth == "geometry" else inside(folder, ground_truth)


def update_shards(
    dataset: Dataset, hashes: FileHashes, progress: bool, ground_truth: GroundTruth = "geometry"
) -> ShardManifest:
    """Bring pieces, reference and manifest up to date, in this order.

    Raises
    ------
    ShardError, ImageFileError : renders are missing, damaged, not finite or differ in size, or the folder of
        a piece holds other files.
    OSError : the disk is full.
    """
    folder = shard_folder(dataset, ground_truth)
    sources = source_hashes(dataset, hashes, ground_truth)
    layout = _layout(dataset, sources, ground_truth)
    pieces = _pieces(dataset, layout, sources)
    before = read_manifest(folder)
    _refuse_other_files(folder)
    _remove_surplus(folder, {piece.name for piece in pieces})
    rebuilt = _update_pieces(dataset, pieces, hashes, progress, ground_truth)
    manifest = ShardManifest(
        frequencies_hz=dataset.preset.itof.frequencies_hz,
        width=layout.width,
        height=layout.height,
        preset_sha256=preset_sha256(dataset.preset),
        scenes=tuple(replace(entry, sha256=None) for entry in dataset.index.scenes),
        scenes_per_piece=scenes_per_piece(layout),
        pieces=tuple(_record(folder / piece.name) for piece in pieces),
        reference_sha256=_update_reference(dataset, folder, layout, before, hashes),
        fields_of_view_deg=_fields_of_view_deg(dataset),
    )
    if rebuilt or manifest != before:
        write_manifest(folder, manifest)
    return manifest


def _layout(
    dataset: Dataset, sources: Mapping[str, Mapping[str, str]], ground_truth: GroundTruth
) -> RowLayout:
    """Shape of a row, from the first scene; its images are read only if its piece is out of date."""
    first = dataset.ids()[0]
    frequencies_hz = dataset.preset.itof.frequencies_hz
    folder = shard_folder(dataset, ground_truth) / first
    record = read_piece_record(folder)
    is_current = record is not None and sources[first].items() <= record.contents.sources.items()
    if record and is_current and has_its_arrays(folder, record.contents):
        return RowLayout(record.contents.width, record.contents.height, len(frequencies_hz))
    height, width = read_render(dataset, first, ground_truth).truth.mask.shape
    return RowLayout(width, height, len(frequencies_hz))


def _pieces(
    dataset: Dataset, layout: RowLayout, sources: Mapping[str, Mapping[str, str]]
) -> list[PieceContents]:
    """Contents that each piece must have."""
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


def _update_pieces(
    dataset: Dataset,
    pieces: Sequence[PieceContents],
    hashes: FileHashes,
    progress: bool,
    ground_truth: GroundTruth,
) -> bool:
    """Rebuild the pieces that are out of date; whether there were any."""
    folder = shard_folder(dataset, ground_truth)
    reasons = {piece.name: why_stale(folder / piece.name, piece, hashes) for piece in pieces}
    stale = [piece for piece in pieces if reasons[piece.name]]
    if not stale:
        return False
    reason = reasons[stale[0].name]
    _log.info("building %d of %d pieces of %s: %s", len(stale), len(pieces), folder, reason)
    (folder / MANIFEST_FILE).unlink(missing_ok=True)
    scene_count = sum(len(piece.scenes) for piece in stale)
    with showing_progress(scene_count, "scene", "shards", show=progress) as bar:
        for piece in stale:
            if why_stale(folder / piece.name, piece, hashes):
                write_piece(dataset, folder / piece.name, piece, bar.update, ground_truth)
            else:  # another process has built it in the meantime
                bar.update(len(piece.scenes))
    for piece in stale:
        why_stale(folder / piece.name, piece, hashes)  # hashes the new files while the disk cache has them
    return True


def _fields_of_view_deg(dataset: Dataset) -> tuple[float, ...]:
    """Of every scene, if they differ."""
    if not dataset.preset.camera_spread.horizontal_fov_deg:
        return ()
    return tuple(dataset.scene(scene).camera.horizontal_fov_deg for scene in dataset.ids())


def _record(piece: Path) -> PieceRecord:
    record = read_piece_record(piece)
    if record is None:
        raise ShardError(f"{piece} disappeared: another process is rebuilding the shards; start again")
    return record


def _update_reference(
    dataset: Dataset, folder: Path, layout: RowLayout, before: ShardManifest | None, hashes: FileHashes
) -> str:
    """SHA-256 of ``reference.npy``, which is written first if it is missing or out of date."""
    file = folder / REFERENCE_FILE
    asked = (preset_sha256(dataset.preset), layout)
    if before and (before.preset_sha256, before.layout) == asked:
        if not is_array_file(file, *reference_array(layout)):
            _log.info("%s is missing or damaged", file)
        elif hashes.sha256(file) == before.reference_sha256:
            return before.reference_sha256
    reference = wall_view(dataset).direct_phasors(
        layout.width, layout.height, dataset.preset.itof.frequencies_hz
    )
    with whole_file(file) as partial, partial.open("wb") as stream:
        ArrayFile(stream, *reference_array(layout)).append(reference)
    return hashes.sha256(file)


def reference_array(layout: RowLayout) -> tuple[DTypeLike, tuple[int, ...]]:
    """Number type and shape of the array in ``reference.npy``: those of the phasors of a row."""
    return layout.arrays["phasors"]


def _refuse_other_files(folder: Path) -> None:
    """Refuse files of others in the folders of pieces, which are removed or replaced as a whole."""
    pieces = sorted(entry for entry in folder.glob("*") if entry.name.isdigit() and entry.is_dir())
    for piece in pieces:
        for name in other_files(piece, dict.fromkeys(PIECE_FILES)):
            raise ShardError(
                f"{piece / name} is none of the shards' files, and its folder may be replaced: move it "
                "elsewhere"
            )


def _remove_surplus(folder: Path, pieces: set[str]) -> None:
    """Remove pieces of another layout and files of killed processes."""
    if not folder.is_dir():
        return
    remove_leftovers(folder)
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name.isdigit() and entry.name not in pieces:
            entry.unlink() if entry.is_symlink() else shutil.rmtree(entry)
