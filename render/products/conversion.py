"""Conversion of transients to phasors, and deletion of transients.

Phasors cannot be converted back: each is a sum over all time bins, and a few sums do not determine the bins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from itof import TransientReader, phasor_channels, read_image, write_image
from render.farm.claims import joined_run, noting
from scenegen import (
    IMAGE_FILES,
    MEASUREMENT_FILE,
    TRANSIENT_FILE,
    TRANSIENT_FILES,
    Dataset,
    NightError,
    read_record,
    sha256_of,
    whole_file,
    write_record,
    write_rendering_record,
)


class ExportError(NightError):
    """A rendered scene cannot be converted or exported as requested."""


def open_transient(dataset: Dataset, scene_id: str) -> TransientReader:
    """Reader of the ``transient.exr`` of a scene, for use in a ``with`` statement.

    Raises
    ------
    DatasetError : the dataset has no such scene.
    ExportError : the scene is not rendered, or was rendered without transients.
    ImageFileError : the file is damaged.
    """
    dataset.entry(scene_id)
    file = dataset.render_folder(scene_id) / TRANSIENT_FILE
    if not file.is_file():
        raise ExportError(
            f"scene {scene_id} of {dataset.root} has no {TRANSIENT_FILE}: "
            "render it with night-render DATASET --product both"
        )
    return TransientReader(file)


@contextmanager
def exported_file(out: Path) -> Iterator[Path]:
    """`scenegen.whole_file` that raises `ExportError` if `out` cannot be written."""
    try:
        with whole_file(out) as partial:
            yield partial
    except OSError as error:
        raise ExportError(f"cannot write {out}: {error.strerror or error}") from None


def convert_to_itof(
    dataset: Dataset, scene_id: str, folder: Path, frequencies_hz: Sequence[float] | None = None
) -> Path:
    """Write ``<folder>/<scene id>_itof.exr``: phasors of a scene at any frequencies, from its transient.

    The file is like ``itof.exr``, with three differences. It has no direct and hidden parts, because they
    share the bins. It has no ``night.hidden_error``, which is for the rendered frequencies. The attribute
    ``night.phasors_from`` says that the phasors are sums over bins; their error is below 1 % of the hidden
    part (docs/rendering.md).

    Parameters
    ----------
    folder : folder of the new file; it is made if it does not exist.
    frequencies_hz : modulation frequencies, Hz; None takes those of the preset.

    Returns
    -------
    Path of the new file.

    Raises
    ------
    ExportError : the scene has no transient, its bins cannot resolve a frequency, or the file cannot be
        written.
    """
    wanted_hz = sorted(set(dataset.preset.itof.frequencies_hz if frequencies_hz is None else frequencies_hz))
    out = folder / f"{scene_id}_{MEASUREMENT_FILE}"
    with open_transient(dataset, scene_id) as reader:
        try:
            phasor = reader.phasors(wanted_hz)  # (H, W, F)
        except ValueError as error:
            raise ExportError(f"scene {scene_id}: {error}") from None
        attributes = {
            name: text
            for name, text in reader.attributes.items()
            if name not in ("bin_count", "start_opl_m", "hidden_error")
        }
    if not np.isfinite(phasor).all():
        raise ExportError(f"scene {scene_id}: {reader.path} holds NaN or infinity: render it again")
    attributes["frequencies_hz"] = repr(wanted_hz)
    attributes["phasors_from"] = f"bins of {TRANSIENT_FILE}"
    with exported_file(out) as partial:
        write_image(partial, phasor_channels(phasor, wanted_hz), attributes)
    return out


def shrink_to_itof(dataset: Dataset, scene_id: str) -> int:
    """Delete the transients of a rendered scene and keep its phasors and ground truth (product ``itof``).

    The images are checked before the transients are deleted. The record is changed first: an interruption can
    leave transients without a record, which the next call deletes, but not a record without its files. Only
    rendering makes the transients again.

    Returns
    -------
    Bytes freed; 0 for a scene without transients.

    Raises
    ------
    ExportError : the scene is not rendered, or its images are damaged; then nothing is deleted.
    """
    dataset.entry(scene_id)
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    if record is None:
        raise ExportError(
            f"scene {scene_id} of {dataset.root} is not rendered: it has no transients to delete"
        )
    for name in IMAGE_FILES:
        file = folder / name
        expected = record.files.get(name)
        if expected is None or not file.is_file() or sha256_of(file) != expected.sha256:
            raise ExportError(
                f"scene {scene_id}: {name} is missing or not what was rendered, so the transients are not "
                "deleted: render the scene again"
            )
        if not all(np.isfinite(values).all() for values in read_image(file).channels.values()):
            raise ExportError(
                f"scene {scene_id}: {name} holds NaN, so the transients are not deleted: "
                "render the scene again"
            )
    files = [folder / name for name in TRANSIENT_FILES if (folder / name).is_file()]
    freed = sum(file.stat().st_size for file in files)
    kept = {name: entry for name, entry in record.files.items() if name not in TRANSIENT_FILES}
    if kept != record.files:
        write_record(folder, replace(record, files=kept))
    for file in files:
        file.unlink()
    return freed


def shrink_dataset(dataset: Dataset, scenes: Iterable[str]) -> int:
    """Delete the transients of several scenes (`shrink_to_itof`).

    If these are all scenes of the dataset, ``rendering.json`` first gets the product ``itof``.

    Returns
    -------
    Bytes freed.

    Raises
    ------
    ExportError : a scene is not rendered, or its images are damaged.
    OtherRunError : a run of ``night-render`` renders the dataset now.
    """
    wanted = list(scenes)
    bare = [scene_id for scene_id in wanted if read_record(dataset.render_folder(scene_id)) is None]
    if bare:
        raise ExportError(f"{len(bare)} scenes (first {bare[0]}) are not rendered: nothing was deleted")
    with joined_run(dataset.renders, "drop-transients"):
        return _shrink(dataset, wanted)


def _shrink(dataset: Dataset, wanted: list[str]) -> int:
    with noting(dataset.renders):
        rendering = dataset.rendering
        if rendering is not None and set(wanted) == set(dataset.ids()):
            write_rendering_record(dataset.renders, replace(rendering, product="itof"))
    return sum(shrink_to_itof(dataset, scene_id) for scene_id in wanted)
