"""Conversion of transients to phasors.

Phasors cannot be converted back: each is a sum over all time bins, and a few sums do not determine the bins.

Bins carry a frequency if the residue of their splat, which is relative to all light, is at most a share of a
faint hidden part: `itof.splat_residue` <= share · `FAINT_HIDDEN`. The share is 1 %. For files with the splat
``tent`` or ``point``, which this version does not write, it is 5 %: with 1 %, the 60 MHz of the paper would
be refused in tents of 1 cm, whose residue is 4.4 % of a faint hidden part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from disk import NightError, PathLike, whole_file, whole_folder
from disk.frequency_text import megahertz
from itof import Splat, TransientReader, highest_frequency_hz, phasor_channels, write_image
from scenegen import MEASUREMENT_FILE, RENDER_AGAIN, TRANSIENT_FILE, Dataset, recorded_file

FAINT_HIDDEN = 3e-4  # hidden part of a faint scene of the paper, relative to the direct return
_SHARE: dict[Splat, float] = {"quadratic": 0.01, "tent": 0.05, "point": 0.05}


class ExportError(NightError):
    """A rendered scene cannot be converted or exported as requested."""


def open_transient(dataset: Dataset, scene_id: str) -> TransientReader:
    """Reader of the ``transient.exr`` of a scene, for use in a ``with`` statement.

    Raises
    ------
    DatasetError : the dataset has no such scene.
    ExportError : the scene is not rendered, or was rendered without transients.
    RenderFileError : the file differs from its record; it is not opened then.
    ImageFileError : a file without a record is damaged.
    """
    dataset.entry(scene_id)
    file = dataset.render_folder(scene_id) / TRANSIENT_FILE
    if not file.is_file():
        raise ExportError(
            f"scene {scene_id} of {dataset.root} has no {TRANSIENT_FILE}: "
            "render it with night-render DATASET --product both"
        )
    return TransientReader(recorded_file(dataset, scene_id, TRANSIENT_FILE), advice=RENDER_AGAIN)


@contextmanager
def exported_file(out: PathLike) -> Iterator[Path]:
    """`disk.whole_file` that raises `ExportError` if `out` cannot be written."""
    with _refusing(out), whole_file(out) as partial:
        yield partial


@contextmanager
def exported_folder(out: PathLike) -> Iterator[Path]:
    """`disk.whole_folder` that raises `ExportError` if `out` cannot be written."""
    with _refusing(out), whole_folder(out) as partial:
        yield partial


@contextmanager
def _refusing(out: PathLike) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ExportError(f"cannot write {out}: {error.strerror or error}") from None


def convert_to_itof(
    dataset: Dataset, scene_id: str, folder: PathLike, frequencies_hz: Sequence[float] | None = None
) -> Path:
    """Write ``<folder>/<scene id>_itof.exr``: phasors of a scene at any frequencies, from its transient.

    The file is like ``itof.exr``, with three differences. It has no direct and hidden parts, because they
    share the bins. It has no ``night.hidden_error``, which is for the rendered frequencies. The attribute
    ``night.phasors_from`` says that the phasors are sums over bins. Bins change them by at most 1 % of a
    faint hidden part (docs/science/renderer.md); in files of earlier versions by at most 5 %.

    Parameters
    ----------
    folder : folder of the new file; it is made if it does not exist.
    frequencies_hz : modulation frequencies, Hz; None takes those of the preset.

    Returns
    -------
    Path of the new file.

    Raises
    ------
    ExportError : the scene has no transient, its bins do not carry a frequency, or the file cannot be
        written.
    """
    wanted_hz = sorted(set(dataset.preset.itof.frequencies_hz if frequencies_hz is None else frequencies_hz))
    out = Path(folder, f"{scene_id}_{MEASUREMENT_FILE}")
    with open_transient(dataset, scene_id) as reader:
        _refuse_not_carried(reader, scene_id, wanted_hz)
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


def _refuse_not_carried(reader: TransientReader, scene_id: str, frequencies_hz: Sequence[float]) -> None:
    width_m, splat = reader.layout.bin_width_m, reader.splat
    limit_hz = highest_frequency_hz(width_m, splat, _SHARE[splat] * FAINT_HIDDEN)
    too_fast = [f for f in frequencies_hz if f > limit_hz]
    if too_fast:
        finer = "render with finer bins (transient.bin_width_m of the preset)"
        again = "render the transients again (night-render drop-transients, then night-render --product both)"
        raise ExportError(
            f"scene {scene_id}: bins of {width_m} m with the splat {splat} cannot carry a hidden signal at "
            f"{megahertz(too_fast[0])}: use frequencies up to {megahertz(_rounded_down(limit_hz))}, or "
            f"{finer if splat == 'quadratic' else again}"
        )


def _rounded_down(value: float) -> float:
    """A positive number with three digits, not above `value`."""
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / step) * step
