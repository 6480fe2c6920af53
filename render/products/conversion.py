"""From time-resolved files to phasors: other frequencies, and the small product in place of the large one.

The reverse is impossible: a few phasors are sums over all time bins, and no transient can be had from them.
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
    """A rendered scene that cannot be turned into what was asked for."""


def open_transient(dataset: Dataset, scene_id: str) -> TransientReader:
    """Reader of a scene's ``transient.exr``; use as a context manager.

    Raises
    ------
    DatasetError : there is no such scene.
    ExportError : the scene was rendered without transients, or not at all.
    ImageFileError : the file is damaged.
    """
    dataset.entry(scene_id)
    file = dataset.render_folder(scene_id) / TRANSIENT_FILE
    if not file.is_file():
        raise ExportError(
            f"scene {scene_id} of {dataset.root} has no {TRANSIENT_FILE}: "
            "render it with night-render --product transient or both"
        )
    return TransientReader(file)


@contextmanager
def exported_file(out: Path) -> Iterator[Path]:
    """`scenegen.whole_file` with one sentence (`ExportError`) where `out` cannot be written."""
    try:
        with whole_file(out) as partial:
            yield partial
    except OSError as error:
        raise ExportError(f"cannot write {out}: {error.strerror or error}") from None


def convert_to_itof(
    dataset: Dataset, scene_id: str, folder: Path, frequencies_hz: Sequence[float] | None = None
) -> Path:
    """Write ``<folder>/<scene id>_itof.exr``: phasors at any frequencies from a scene's transient.

    The file is like ``itof.exr``, but has no direct and hidden parts, which bins do not tell apart, and no
    ``night.hidden_error``, which is of the frequencies that were rendered. ``night.phasors_from`` says that
    the phasors are sums over bins; they are within 1 % of the hidden part of exact ones (docs/rendering.md).

    Parameters
    ----------
    folder : where to; made if need be.
    frequencies_hz : modulation frequencies, Hz; the preset's by default.

    Returns
    -------
    The file that was written.

    Raises
    ------
    ExportError : no transient, frequencies that its bins cannot resolve, or a file that cannot be written.
    """
    wanted_hz = sorted(set(dataset.preset.itof.frequencies_hz if frequencies_hz is None else frequencies_hz))
    out = folder / f"{scene_id}_itof.exr"
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
    """Make the small product (``itof``) of a scene rendered to ``transient`` or ``both``.

    Transients are deleted once the images beside them are proved whole. The record loses them first, so an
    interruption leaves files too many, which the next call deletes, and never a record of files that are
    gone. Only rendering brings the transients back.

    Returns
    -------
    Bytes freed; 0 for a scene that has no transients.

    Raises
    ------
    ExportError : the scene is not rendered, or its images are not whole; nothing is deleted then.
    """
    dataset.entry(scene_id)
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    if record is None:
        raise ExportError(f"scene {scene_id} of {dataset.root} is not rendered: nothing to shrink")
    for name in IMAGE_FILES:
        file = folder / name
        expected = record.files.get(name)
        if expected is None or not file.is_file() or sha256_of(file) != expected.sha256:
            raise ExportError(
                f"scene {scene_id}: {name} is missing or not what was rendered, so its transients stay: "
                "render it again"
            )
        if not all(np.isfinite(values).all() for values in read_image(file).channels.values()):
            raise ExportError(f"scene {scene_id}: {name} holds NaN, so its transients stay: render it again")
    files = [folder / name for name in TRANSIENT_FILES if (folder / name).is_file()]
    freed = sum(file.stat().st_size for file in files)
    kept = {name: entry for name, entry in record.files.items() if name not in TRANSIENT_FILES}
    if kept != record.files:
        write_record(folder, replace(record, files=kept))
    for file in files:
        file.unlink()
    return freed


def shrink_dataset(dataset: Dataset, scenes: Iterable[str]) -> int:
    """`shrink_to_itof` of scenes; where these are all, the dataset's product becomes ``itof`` first.

    Returns
    -------
    Bytes freed.
    """
    wanted = list(scenes)
    bare = [scene_id for scene_id in wanted if read_record(dataset.render_folder(scene_id)) is None]
    if bare:
        raise ExportError(f"{len(bare)} scenes (first {bare[0]}) are not rendered: nothing was deleted")
    with joined_run(dataset.renders, "conversion to itof"):
        return _shrink(dataset, wanted)


def _shrink(dataset: Dataset, wanted: list[str]) -> int:
    with noting(dataset.renders):
        rendering = dataset.rendering
        if rendering is not None and set(wanted) == set(dataset.ids()):
            write_rendering_record(dataset.renders, replace(rendering, product="itof"))
    return sum(shrink_to_itof(dataset, scene_id) for scene_id in wanted)
