"""Shards: a dataset's renders as arrays that training reads, in pieces of at most 128 MiB.

The folder ``shards/`` of a dataset holds a folder for each piece (`model.data.pieces`), named after its first
scene; ``reference.npy`` (H, W, F) complex64, the direct return of the relay wall; and ``manifest.json``
(`model.data.manifest`), which is written last and lists the pieces. An update rewrites only the pieces whose
renders changed (`model.data.shard_building`).
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import FileHashes
from model.data.array_files import read_array
from model.data.manifest import MANIFEST_FILE, ShardManifest
from model.data.pieces import read_rows
from model.data.renders import TRUTH_FILES, ShardError
from model.data.rows import RowBlock
from model.data.shard_building import REFERENCE_FILE, reference_array, shard_folder, update_shards
from model.settings.run import GroundTruth
from scenegen import MEASUREMENT_FILE, Dataset, RenderRecord, Split, read_failure, read_record

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Shards:
    """Opened shards. Rows are numbered across all pieces and read on request.

    Attributes
    ----------
    folder : folder of the shards.
    manifest : their contents.
    reference : (H, W, F) complex64 direct return of the relay wall.
    """

    folder: Path
    manifest: ShardManifest
    reference: NDArray[np.complex64]

    def rows(self, split: Split) -> list[int]:
        """Rows of a split, in scene order."""
        return [row for row, scene in enumerate(self.manifest.scenes) if scene.split == split]

    def ids(self, rows: Iterable[int]) -> list[str]:
        """Scene ids of rows."""
        return [self.manifest.scenes[row].id for row in rows]

    def fields_of_view_deg(self, rows: Sequence[int]) -> list[float]:
        """Full horizontal fields of view of rows, degrees; empty if all scenes have that of the preset."""
        known = self.manifest.fields_of_view_deg
        return [known[row] for row in rows] if known else []

    def read(self, rows: Sequence[int]) -> RowBlock:
        """Read rows from disk, piece by piece, and each piece in file order.

        Raises
        ------
        ShardError : the shards changed after they were opened.
        """
        views_deg = self.fields_of_view_deg(rows)
        block = replace(
            self.manifest.layout.empty(rows), fields_of_view_deg=np.array(views_deg) if views_deg else None
        )
        wanted: dict[int, list[tuple[int, int]]] = {}
        for place, row in enumerate(rows):
            piece, row_of_piece = divmod(row, self.manifest.scenes_per_piece)
            wanted.setdefault(piece, []).append((place, row_of_piece))
        for piece, pairs in sorted(wanted.items()):
            contents = self.manifest.pieces[piece].contents
            read_rows(self.folder / contents.name, contents, block, pairs)
        return block


def open_shards(
    dataset: Dataset, *, ground_truth: GroundTruth = "geometry", progress: bool = False
) -> Shards:
    """Open the shards of a dataset; parts that are missing or out of date are built first.

    An interrupted build continues with the piece at which it stopped. Files that did not change since the
    last time are not read again. Scenes that night-render failed to render (they have a ``failure.json`` and
    no ``render.json``) are left out.

    Parameters
    ----------
    ground_truth : ``simulated`` has shards of its own, in the folder ``simulated`` of the others.

    Raises
    ------
    ShardError, RenderFileError, ImageFileError : renders are missing, damaged, not finite or differ in size.
    OSError : the disk is full.
    """
    hashes = FileHashes(dataset.root)
    try:
        manifest = update_shards(_without_failures(dataset, ground_truth), hashes, progress, ground_truth)
    finally:
        hashes.save()
    folder = shard_folder(dataset, ground_truth)
    file = folder / REFERENCE_FILE
    try:
        reference = read_array(file, *reference_array(manifest.layout))
    except (OSError, ValueError):
        raise ShardError(
            f"{file} changed while it was in use: another process rebuilt the shards; start again"
        ) from None
    if not np.isfinite(reference).all():
        raise ShardError(
            f"{file} holds NaN or infinite values, although {MANIFEST_FILE} vouches for it: delete it, and "
            "it is made again"
        )
    return Shards(folder, manifest, reference)


def _without_failures(dataset: Dataset, ground_truth: GroundTruth) -> Dataset:
    """The dataset without the scenes that could not be rendered, to the files that are wanted."""
    scenes = dataset.index.scenes
    folders = {scene.id: dataset.render_folder(scene.id) for scene in scenes}
    failed = {
        scene
        for scene, folder in folders.items()
        if read_failure(folder) is not None and not _has(read_record(folder), ground_truth)
    }
    if not failed:
        return dataset
    if len(failed) == len(scenes):
        raise ShardError(f"no scene of {dataset.root} could be rendered: see night-render status")
    _log.warning("scenes that could not be rendered are left out: %d, first %s", len(failed), min(failed))
    kept = tuple(scene for scene in scenes if scene.id not in failed)
    return Dataset(dataset.root, replace(dataset.index, scenes=kept))


def _has(record: RenderRecord | None, ground_truth: GroundTruth) -> bool:
    wanted = {MEASUREMENT_FILE, TRUTH_FILES[ground_truth]}
    return record is not None and wanted <= set(record.files)
