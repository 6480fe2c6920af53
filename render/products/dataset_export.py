"""Export of a rendered dataset as one HDF5 file or Zarr folder, for others (docs/reference/files.md)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from disk import PathLike, sha256_of
from disk.byte_size import size
from disk.counted import counted
from disk.extras import need
from render.products.card import read_card
from render.products.conversion import ExportError, exported_file, exported_folder
from render.products.export_format import FORMAT, FORMAT_VERSION
from render.products.export_rows import Rows, new_rows
from render.products.export_scenes import RefusedSceneError, SceneSource
from render.products.zarr_copy import copy_to_zarr, digest_of_folder
from scenegen import Dataset

_ZARR = ".zarr"
_ENDINGS = (".h5", ".hdf5", _ZARR)
_LISTED = 10  # scenes that are named one by one on the terminal; the file names all


@dataclass(frozen=True)
class Export:
    """What was exported.

    Attributes
    ----------
    file : the new file or folder.
    bytes, sha256 : its size and its hash, to publish beside it; of a folder that of `digest_of_folder`.
    scenes : number of scenes of each split.
    left_out : sentence about each scene that is not in the file, by id.
    arrays : shape of each array that has a row for each scene, by name.
    """

    file: Path
    bytes: int
    sha256: str
    scenes: dict[str, int]
    left_out: dict[str, str]
    arrays: dict[str, tuple[int, ...]]

    def as_data(self) -> dict[str, Any]:
        """The result as plain data (docs/reference/files.md, results as JSON)."""
        return {**asdict(self), "file": str(self.file)}

    def sentences(self) -> list[str]:
        """The result as lines of text."""
        lines = [f"left out: {sentence}" for sentence in list(self.left_out.values())[:_LISTED]]
        if len(self.left_out) > _LISTED:
            lines.append(f"left out: {len(self.left_out) - _LISTED} more, which the file names")
        parts = ", ".join(f"{count} {split}" for split, count in self.scenes.items())
        total = counted(sum(self.scenes.values()), "scene")
        lines.append(f"{total} in {self.file}: {parts}; {size(self.bytes)}")
        return [*lines, f"SHA-256: {self.sha256}"]


def export_dataset(
    dataset: Dataset,
    out: PathLike,
    *,
    partial: bool = False,
    on_scene: Callable[[], object] = lambda: None,
) -> Export:
    """Write phasors, ground truth, parameters, splits and provenance of all scenes into one new file.

    docs/reference/files.md describes it. Rendered files are compared with their records before reading. One
    scene is in memory at a time. The same dataset gives the same bytes with the same versions of NIGHT, h5py
    and HDF5, or zarr and numcodecs.

    Parameters
    ----------
    out : the new HDF5 file, which ends in ``.h5`` or ``.hdf5``, or the new Zarr folder, which ends in
        ``.zarr``. The folder is copied from an HDF5 file that is written beside it and deleted.
    partial : leave out scenes that cannot be exported, and name them in the file.
    on_scene : called after each scene whose images were read.

    Raises
    ------
    ExportError : without `partial`, a scene is not rendered, given up, bad, damaged, or rendered with other
        settings than the dataset. No scene can be exported. The file exists, has another ending, or cannot
        be written.
    MissingPackageError : a Zarr folder is wanted, and the extra ``export`` is not installed.
    """
    file = Path(out)
    _check_name(file)
    source = SceneSource(dataset)
    left_out, wanted = _checked(dataset, source, partial)
    licence = read_card(dataset).licence
    write = _zarr_rows if file.suffix == _ZARR else _hdf5_rows
    with write(file, len(wanted)) as rows:
        for scene_id in wanted:
            try:
                rows.add(dataset.entry(scene_id), source.read(scene_id))
            except RefusedSceneError as refusal:
                if not partial:
                    raise _with_advice(refusal) from None
                left_out[scene_id] = refusal.without_frames()
            on_scene()
        left_out = dict(sorted(left_out.items()))
        if not rows.entries:
            raise ExportError(f"no scene of {dataset.root} can be exported: {next(iter(left_out.values()))}")
        documents = {
            "preset": asdict(dataset.preset),
            "provenance": _provenance(dataset, licence),
            "left_out": {scene_id: refusal.reason for scene_id, refusal in left_out.items()},
        }
        rows.finish(dataset.preset.itof.frequencies_hz, documents, licence)
    size, sha256 = digest_of_folder(file) if file.is_dir() else (file.stat().st_size, sha256_of(file))
    return Export(
        file=file,
        bytes=size,
        sha256=sha256,
        scenes=rows.split_counts,
        left_out={scene_id: str(refusal) for scene_id, refusal in left_out.items()},
        arrays=rows.shapes,
    )


@contextmanager
def _hdf5_rows(file: Path, most: int) -> Iterator[Rows]:
    """Rows of the new HDF5 file `file`."""
    with exported_file(file) as unfinished, new_rows(unfinished, most) as rows:
        yield rows


@contextmanager
def _zarr_rows(folder: Path, most: int) -> Iterator[Rows]:
    """Rows of an HDF5 file that becomes the new Zarr folder `folder`."""
    need("export", ("zarr",), "a Zarr folder")
    with exported_folder(folder) as unfinished:
        file = unfinished.with_suffix(".h5")  # in a folder that is removed at the end
        with new_rows(file, most) as rows:
            yield rows
        copy_to_zarr(file, unfinished)


def _check_name(file: Path) -> None:
    if file.suffix not in _ENDINGS:
        raise ExportError(
            f"{file}: the ending {file.suffix!r} is unknown: give a name that ends in .h5 or .zarr"
        )
    if os.path.lexists(file):
        raise ExportError(f"{file} exists already: give another name, or delete it")


def _checked(
    dataset: Dataset, source: SceneSource, partial: bool
) -> tuple[dict[str, RefusedSceneError], list[str]]:
    """Scenes whose records say that they cannot be exported, and the others."""
    refused: dict[str, RefusedSceneError] = {}
    for scene_id in dataset.ids():
        try:
            source.check(scene_id)
        except RefusedSceneError as refusal:
            refused[scene_id] = refusal
    if refused and not partial:
        raise _with_advice(next(iter(refused.values())), len(refused) - 1)
    return refused, [scene_id for scene_id in dataset.ids() if scene_id not in refused]


def _with_advice(refusal: RefusedSceneError, others: int = 0) -> ExportError:
    more = f" ({others} more scenes cannot be exported)" if others else ""
    return ExportError(f"{refusal}{more}, or leave out such scenes with --partial")


def _provenance(dataset: Dataset, licence: str | None) -> Mapping[str, Any]:
    """Programs, versions, seed, settings of the renders and licence; no path, time or name of a machine."""
    index, rendering = dataset.index, dataset.rendering
    return {
        "format": {"name": FORMAT, "version": FORMAT_VERSION, "night-nlos": version("night-nlos")},
        "scenes": {
            "generator": index.generator,
            "generator_version": index.generator_version,
            "blender_version": index.blender_version,
            "seed": index.seed,
            "packages": index.packages,
            "meshes": index.meshes,
        },
        "rendering": None if rendering is None else asdict(rendering),
        "frequencies_hz": list(dataset.preset.itof.frequencies_hz),
        "licence": licence,
    }
