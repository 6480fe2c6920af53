"""Is what was rendered still what was rendered, and is it right? Every file anew, nothing remembered.

Nothing here uses Mitsuba; `render.products.geometry` traces the ground truth's sample rays in numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from itof import (
    DepthMap,
    Image,
    ImageFileError,
    TransientReader,
    phase_per_metre,
    pixel_types,
    read_image,
)
from render.farm.claims import claimed
from render.products.geometry import traced_depth_m
from render.settings import read_recipe, scene_sha256
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILE,
    TRANSIENT_FILES,
    Dataset,
    RenderRecord,
    open_dataset,
    read_record,
    sha256_of,
)

# Φ x against exact phasors, relative to the hidden part: twice the 1 % of docs/rendering.md.
BINNED_TOLERANCE = 0.02
# Eight roundings of float32, relative to the largest value: 0.02 % of a hidden part of 0.2 %.
_FLOAT_ROUNDING = 8 * 2.0**-24
_SAMPLE_RAYS = 64
_DEPTH_TOLERANCE_M = 1e-4  # float32 rays over a few metres are good to 1e-6 m; meshes are stored in float32


@dataclass(frozen=True)
class Verification:
    """What a check of scenes found.

    Attributes
    ----------
    checked : scenes that are rendered, and so were checked.
    problems : what is wrong with each bad one, as sentences.
    missing : scenes that are not rendered.
    """

    checked: int
    problems: dict[str, list[str]]
    missing: int = 0

    def sentences(self) -> list[str]:
        """The outcome for people to read."""
        bad = len(self.problems)
        return [
            *(f"bad: {scene_id}: {'; '.join(problems)}" for scene_id, problems in self.problems.items()),
            f"{self.checked} scenes checked: {self.checked - bad} good, {bad} bad; "
            f"{self.missing} not rendered",
        ]


def verify(
    dataset: Dataset,
    scenes: Sequence[str],
    *,
    workers: int = 1,
    on_scene: Callable[[], object] = lambda: None,
) -> Verification:
    """Check every file of rendered scenes.

    Scenes without a record are not rendered and are left out. The record of a bad scene is removed, so that
    the next run renders it again; not where somebody is rendering it now, or where nothing may be written.
    """
    rendered = [s for s in scenes if (dataset.render_folder(s) / RECORD_FILE).exists()]
    bad = {}
    for scene_id, problems in _checked(dataset, rendered, workers):
        on_scene()
        if problems and (still := _condemned(dataset, scene_id, problems)):
            bad[scene_id] = still
    return Verification(len(rendered), bad, missing=len(scenes) - len(rendered))


def _condemned(dataset: Dataset, scene_id: str, problems: list[str]) -> list[str]:
    """Remove the record of a bad scene, if it is bad still; what is wrong with it."""
    try:
        with claimed(dataset.renders, scene_id) as claim:
            if claim is None:
                return []  # it is being rendered again
            problems = verify_scene(dataset, scene_id)
            if problems:
                (dataset.render_folder(scene_id) / RECORD_FILE).unlink(missing_ok=True)
            claim.forget()
    except OSError as error:
        return [*problems, f"its record stays ({error.strerror})"]
    return problems


def verify_scene(dataset: Dataset, scene_id: str) -> list[str]:
    """What is wrong with a rendered scene; nothing when all is well."""
    folder = dataset.render_folder(scene_id)
    record = read_record(folder)
    if record is None:
        return [f"{RECORD_FILE} is damaged"]
    problems = list(_changed_files(folder, record))
    if problems:
        return problems  # contents of files that are not what was written tell nothing more
    recipe = read_recipe(record.recipe)
    try:
        if recipe.get("scene_sha256") != scene_sha256(dataset, scene_id):
            return ["the scene was changed after it was rendered"]
        width, height = recipe["size"]
        problems += _wrong_storage(folder, record)
        image, truth = read_image(folder / MEASUREMENT_FILE), read_image(folder / GROUND_TRUTH_FILE)
        problems += _wrong_pixels(MEASUREMENT_FILE, image, (height, width))
        problems += _wrong_pixels(GROUND_TRUTH_FILE, truth, (height, width))
        if problems:
            return problems
        problems += _wrong_phasors(image, dataset.preset.itof.frequencies_hz)
        problems += _wrong_truth(dataset, scene_id, truth)
        for name in TRANSIENT_FILES:
            if name in record.files:
                problems += _wrong_transient(folder / name, image, (height, width))
    except (ValueError, KeyError, TypeError, OSError) as error:
        problems.append(" ".join(str(error).split()) or type(error).__name__)
    return problems


def _checked(dataset: Dataset, scenes: Sequence[str], workers: int) -> Iterator[tuple[str, list[str]]]:
    if workers <= 1:
        for scene_id in scenes:
            yield scene_id, verify_scene(dataset, scene_id)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        answers = pool.map(_verify_in, repeat(str(dataset.root)), scenes, chunksize=4)
        yield from zip(scenes, answers, strict=True)


_opened: dict[str, Dataset] = {}  # of this worker process


def _verify_in(root: str, scene_id: str) -> list[str]:
    if root not in _opened:
        _opened[root] = open_dataset(Path(root))
    return verify_scene(_opened[root], scene_id)


def _changed_files(folder: Path, record: RenderRecord) -> Iterator[str]:
    for name, expected in record.files.items():
        file = folder / name
        if not file.is_file():
            yield f"{name} is missing"
        elif file.stat().st_size != expected.bytes:
            yield f"{name} has {file.stat().st_size} bytes instead of {expected.bytes}"
        elif sha256_of(file) != expected.sha256:
            yield f"{name} is not what was written (its SHA-256 differs)"


def _wrong_storage(folder: Path, record: RenderRecord) -> Iterator[str]:
    for name in record.files:
        halves = [c for c, kind in pixel_types(folder / name).items() if kind != "FLOAT"]
        if halves:
            yield f"{name} stores {halves[0]} as another type than float32"


def _wrong_pixels(name: str, image: Image, shape: tuple[int, int]) -> Iterator[str]:
    for channel, values in image.channels.items():
        if values.shape != shape:
            yield f"{name} has {values.shape[1]}x{values.shape[0]} pixels instead of {shape[1]}x{shape[0]}"
            return
        if not np.isfinite(values).all():
            yield f"{name}: {channel} holds NaN or infinity"


def _wrong_phasors(image: Image, frequencies_hz: tuple[float, ...]) -> Iterator[str]:
    total, found_hz = image.phasors()
    if found_hz != frequencies_hz:
        yield f"{MEASUREMENT_FILE} has phasors at {found_hz} Hz instead of {frequencies_hz}"
    elif _has(image, "hidden"):
        parts = image.phasors("direct")[0] + image.phasors("hidden")[0]
        if np.abs(total - parts).max() > _FLOAT_ROUNDING * np.abs(total).max():
            yield f"{MEASUREMENT_FILE}: direct and hidden part do not add up to the whole"


def _wrong_truth(dataset: Dataset, scene_id: str, image: Image) -> Iterator[str]:
    truth = DepthMap.of_image(image)
    depth_m, mask = truth.radial_depth_m, truth.mask
    if ((depth_m > 0) != mask).any():
        yield f"{GROUND_TRUTH_FILE}: depth and mask do not fit each other"
        return
    expected = DepthMap.of_object(depth_m, mask, truth.frequency_hz).phasor
    turns_rad = 2 * depth_m * phase_per_metre(truth.frequency_hz)  # the optical path is twice the depth
    if (np.abs(truth.phasor - expected) > _FLOAT_ROUNDING * (1 + turns_rad)).any():
        yield f"{GROUND_TRUTH_FILE}: phasor and depth do not fit each other"
    rows, columns = _sample_pixels(mask)
    traced_m = traced_depth_m(dataset, scene_id, mask.shape, rows, columns)
    off = np.abs(traced_m - depth_m[rows, columns]) > _DEPTH_TOLERANCE_M
    if off.any():
        row, column, expected_m = next(zip(rows[off], columns[off], traced_m[off], strict=True))
        yield (
            f"{GROUND_TRUTH_FILE}: depth of {off.sum()} of {len(off)} sampled pixels is not that of the "
            f"geometry (row {row}, column {column}: {depth_m[row, column]:.4f} m instead of "
            f"{expected_m:.4f} m)"
        )


def _wrong_transient(file: Path, image: Image, shape: tuple[int, int]) -> Iterator[str]:
    with TransientReader(file) as reader:
        if (reader.layout.height, reader.layout.width) != shape:
            yield f"{file.name} has {reader.layout.width}x{reader.layout.height} pixels"
            return
        # sums every bin, so a NaN anywhere shows, and reads every row
        binned = reader.phasors(image.phasors()[1])
    if not np.isfinite(binned).all():
        yield f"{file.name} holds NaN or infinity"
    elif file.name == TRANSIENT_FILE:
        exact = image.phasors()[0]
        scale = np.linalg.norm(image.phasors("hidden")[0]) if _has(image, "hidden") else 0.0
        allowed = max(BINNED_TOLERANCE * scale, _FLOAT_ROUNDING * np.linalg.norm(exact))
        if np.linalg.norm(binned - exact) > allowed:
            yield f"{file.name}: its phasors are not those of {MEASUREMENT_FILE}"


def _has(image: Image, prefix: str) -> bool:
    try:
        image.phasors(prefix)
    except ImageFileError:
        return False
    return True


def _sample_pixels(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of pixels spread over object and background, none beside an edge of the mask."""
    same = np.ones(mask.shape, bool)
    changes_down, changes_right = np.diff(mask, axis=0), np.diff(mask, axis=1)
    same[:-1] &= ~changes_down
    same[1:] &= ~changes_down
    same[:, :-1] &= ~changes_right
    same[:, 1:] &= ~changes_right
    rows, columns = [], []
    for wanted in (False, True):
        found = np.argwhere(same & (mask == wanted))
        chosen = found[np.linspace(0, len(found) - 1, min(len(found), _SAMPLE_RAYS // 2)).astype(int)]
        rows.append(chosen[:, 0])
        columns.append(chosen[:, 1])
    return np.concatenate(rows), np.concatenate(columns)
