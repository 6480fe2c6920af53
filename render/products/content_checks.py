"""Checks of the files of one rendered scene. Every check yields its problems as sentences.

Nothing here uses Mitsuba; `render.products.geometry` traces the sample rays of the ground truth in numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import OutsideError, inside
from disk.frequency_text import megahertz
from itof import (
    DepthMap,
    Image,
    ImageFileError,
    TransientLayout,
    TransientReader,
    phase_per_metre,
    pixel_types,
    splat_residue,
)
from render.products.geometry import traced_depth_m
from scenegen import (
    GROUND_TRUTH_FILE,
    IMAGE_FILES,
    MEASUREMENT_FILE,
    RECORD_FILE,
    TRANSIENT_FILE,
    Dataset,
    RenderRecord,
)
from scenegen.render_folder import difference

# Phasors of bins may differ from exact ones by this share of the hidden part, because the two sum over
# different nodes in the pixels, and bins over merged arrivals. Twice the 1 % of docs/science/renderer.md.
QUADRATURE_SHARE = 0.02
_STEADY_HZ = 1.0  # nothing turns: the phasor is the energy
# Eight roundings of float32, relative to the largest value. This is 0.02 % of a hidden part of 0.2 %.
_FLOAT_ROUNDING = 8 * 2.0**-24
_SAMPLE_RAYS = 64
_DEPTH_TOLERANCE_M = 1e-4  # float32 rays and meshes over a few metres have errors of about 1e-6 m


def changed_files(folder: Path, record: RenderRecord) -> Iterator[str]:
    """Files that are missing or differ from the record, and images that the record does not name."""
    for name in IMAGE_FILES:
        if name not in record.files:
            yield f"{name} is not in {RECORD_FILE}"
    for name, expected in record.files.items():
        try:
            problem = difference(inside(folder, name), expected)
        except OutsideError as error:
            problem = f"is not inside the render: {error}"
        if problem:
            yield f"{name} {problem}"


def wrong_storage(folder: Path, record: RenderRecord) -> Iterator[str]:
    """Files with channels that are not float32."""
    for name in record.files:
        halves = [c for c, kind in pixel_types(folder / name).items() if kind != "FLOAT"]
        if halves:
            yield f"{name} stores {halves[0]} as another type than float32"


def wrong_pixels(name: str, image: Image, shape: tuple[int, int]) -> Iterator[str]:
    """Channels of another size than `shape` (height, width), or with NaN or infinite pixels."""
    for channel, values in image.channels.items():
        if values.shape != shape:
            yield f"{name} has {values.shape[1]}x{values.shape[0]} pixels instead of {shape[1]}x{shape[0]}"
            return
        if not np.isfinite(values).all():
            yield f"{name}: {channel} holds NaN or infinity"


def wrong_phasors(image: Image, frequencies_hz: tuple[float, ...]) -> Iterator[str]:
    """Phasors at other frequencies, or with parts that do not add up to the whole."""
    total, found_hz = image.phasors()
    if found_hz != frequencies_hz:
        yield f"{MEASUREMENT_FILE} has phasors at {found_hz} Hz instead of {frequencies_hz}"
    elif has_part(image, "hidden"):
        names = [name for name in ("direct", "hidden", "room") if has_part(image, name)]
        parts = sum(image.phasors(name)[0] for name in names)
        if np.abs(total - parts).max() > _FLOAT_ROUNDING * np.abs(total).max():
            yield f"{MEASUREMENT_FILE}: {' and '.join(names)} part do not add up to the total"


def has_part(image: Image, prefix: str) -> bool:
    """Whether an image has phasors with this prefix, such as ``hidden``."""
    try:
        image.phasors(prefix)
    except ImageFileError:
        return False
    return True


def wrong_truth(dataset: Dataset, scene_id: str, image: Image) -> Iterator[str]:
    """Ground truth that contradicts itself or the geometry of the scene."""
    truth = DepthMap.of_image(image)
    depth_m, mask = truth.radial_depth_m, truth.mask
    if ((depth_m > 0) != mask).any():
        yield f"{GROUND_TRUTH_FILE}: depth and mask do not fit each other"
        return
    expected = DepthMap.of_object(depth_m, mask, truth.frequency_hz).phasor
    phase_rad = 2 * depth_m * phase_per_metre(truth.frequency_hz)  # the optical path is twice the depth
    if (np.abs(truth.phasor - expected) > _FLOAT_ROUNDING * (1 + phase_rad)).any():
        yield f"{GROUND_TRUTH_FILE}: phasor and depth do not fit each other"
    rows, columns = _sample_pixels(mask)
    traced_m = traced_depth_m(dataset, scene_id, mask.shape, rows, columns)
    off = np.abs(traced_m - depth_m[rows, columns]) > _DEPTH_TOLERANCE_M
    if off.any():
        row, column, expected_m = next(zip(rows[off], columns[off], traced_m[off], strict=True))
        yield (
            f"{GROUND_TRUTH_FILE}: the depth of {off.sum()} of {len(off)} sampled pixels is not that of the "
            f"geometry (row {row}, column {column}: {depth_m[row, column]:.4f} m instead of "
            f"{expected_m:.4f} m)"
        )


def wrong_transient(file: Path, image: Image, shape: tuple[int, int]) -> Iterator[str]:
    """A transient of another size, with NaN or infinity, or that does not fit the measurement `image`.

    Each frequency is judged by itself. With ‖·‖ over the image, its phasors may differ by

        `QUADRATURE_SHARE` ‖hidden‖ + (`itof.splat_residue` + rounding) ‖all light‖,

    or by half the reported error of a render with few lights, whose phasors and bins are interpolated apart.

    Where bins are so wide that the residue exceeds the hidden part, only the bound of the bins is left.
    """
    exact, frequencies_hz = image.phasors()
    with TransientReader(file) as reader:
        axis, splat = reader.layout, reader.splat
        if (axis.height, axis.width) != shape:
            yield f"{file.name} has {axis.width}x{axis.height} pixels"
            return
        # reads every row and sums every bin, so a NaN anywhere is found
        binned = reader.phasors((_STEADY_HZ, *frequencies_hz))
    if not np.isfinite(binned).all():
        yield f"{file.name} holds NaN or infinity"
    elif file.name == TRANSIENT_FILE:
        energy, difference = _norm(binned[..., 0]), _norm(binned[..., 1:] - exact)
        allowed = _FLOAT_ROUNDING * _norm(exact)  # (F,) without parts, `exact` is the sum over these bins
        if has_part(image, "hidden"):
            parts = splat_residue(frequencies_hz, axis.bin_width_m, splat) + _rounding(frequencies_hz, axis)
            share = max(QUADRATURE_SHARE, _reported_error(image) / 2)
            allowed = share * _norm(image.phasors("hidden")[0]) + parts * energy
        off = difference > allowed
        if off.any():
            at = megahertz(*np.array(frequencies_hz)[off])
            times = (difference[off] / np.maximum(allowed[off], np.finfo(float).tiny)).max()
            yield (
                f"{file.name}: its phasors at {at} are not those of {MEASUREMENT_FILE} (they differ by "
                f"{times:.3g} times what bins, quadrature and rounding explain)"
            )


def _norm(z: NDArray[np.complexfloating]) -> NDArray[np.float64]:
    """Norm over the image, of each frequency if `z` has them."""
    return np.asarray(np.sqrt((np.abs(z).astype(np.float64) ** 2).sum(axis=(0, 1))))


def _rounding(frequencies_hz: tuple[float, ...], axis: TransientLayout) -> NDArray[np.float64]:
    """(F,) error of phasors by float32, relative to the light: in sums, and in an OPL as long as the axis."""
    end_m = abs(axis.start_opl_m) + axis.bin_count * axis.bin_width_m
    return _FLOAT_ROUNDING + 2.0**-24 * phase_per_metre(frequencies_hz) * end_m


def _reported_error(image: Image) -> float:
    """The error of the hidden part that the file reports; 0 if it reports none."""
    try:
        return float(image.attributes.get("hidden_error", "0"))
    except ValueError:
        return 0.0


def _sample_pixels(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of sample pixels on object and background, none next to an edge of the mask."""
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
