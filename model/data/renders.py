"""What training needs of one scene's renders, read and checked before it can spoil anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from itof import Image, ImageFileError, read_image
from scenegen import Dataset, FileHashes, NightError, read_record

MEASUREMENT_FILE = "itof.exr"
GROUND_TRUTH_FILE = "mirrored.exr"


class ShardError(NightError):
    """Renders that cannot become training data: missing, damaged, not finite or of another size."""


@dataclass(frozen=True)
class RenderedScene:
    """Measurement and ground truth of one scene.

    Attributes
    ----------
    phasor : (H, W, F) complex64, what the camera measures at every frequency.
    target : (2, H, W) float32, Re and Im of the mirrored scene at the first frequency, amplitude 1 or 0.
    radial_depth_m : (H, W) float32, along the ray, 0 on background.
    mask : (H, W) uint8, 1 on the hidden object.
    """

    phasor: NDArray[np.complex64]
    target: NDArray[np.float32]
    radial_depth_m: NDArray[np.float32]
    mask: NDArray[np.uint8]

    @property
    def size(self) -> str:
        """Width x height, as people write it."""
        height, width = self.mask.shape
        return f"{width}x{height}"


def source_files(dataset: Dataset) -> dict[str, Path]:
    """The files that shards are made of, by their path within the dataset, in scene order.

    Raises
    ------
    ShardError : a scene that has not been rendered.
    """
    scenes = dataset.ids()
    files = {
        f"renders/{scene}/{name}": dataset.render_folder(scene) / name
        for scene in scenes
        for name in (MEASUREMENT_FILE, GROUND_TRUTH_FILE)
    }
    missing = [path for path in files.values() if not path.is_file()]
    if missing:
        unrendered = sorted({path.parent.name for path in missing})
        others = f" (and {len(unrendered) - 1} more of {len(scenes)} scenes)" if len(unrendered) > 1 else ""
        raise ShardError(
            f"scene {missing[0].parent.name}{others} has no {missing[0].name}: "
            f"run night-render {dataset.root}"
        )
    return files


def source_hashes(dataset: Dataset, hashes: FileHashes) -> dict[str, dict[str, str]]:
    """SHA-256 of the files that shards are made of, by scene and by their path within the dataset.

    Raises
    ------
    ShardError : a scene that has not been rendered, or a file that is not the one its record is of.
    ImageFileError : such a file that is truncated or no EXR.
    """
    found: dict[str, dict[str, str]] = {scene: {} for scene in dataset.ids()}
    recorded: dict[str, str] = {}
    for name, path in source_files(dataset).items():
        scene = path.parent.name
        if not found[scene]:
            record = read_record(path.parent)  # None of captures that night-render did not make
            if record is None and dataset.index.rendering is not None:
                read_render(dataset, scene)  # may know better what is wrong
                raise ShardError(
                    f"scene {scene}: its renders are unfinished or were found bad (there is no render.json): "
                    f"run night-render {dataset.root} again"
                )
            recorded = {file: entry.sha256 for file, entry in record.files.items()} if record else {}
        digest = found[scene][name] = hashes.sha256(path)
        if recorded.get(path.name, digest) != digest:
            read_render(dataset, scene)  # may know better what is wrong
            raise ShardError(
                f"scene {scene}: {path} is not the file that night-render wrote (its SHA-256 differs from "
                f"the one in render.json): run night-render {dataset.root} again, which repairs it"
            )
    return found


def read_render(dataset: Dataset, scene: str) -> RenderedScene:
    """Measurement and ground truth of a scene.

    Raises
    ------
    ImageFileError : a file that is missing, truncated or no EXR.
    ShardError : a channel that is missing, values that are not finite, other frequencies than the
        dataset's, or measurement and ground truth of different sizes.
    """
    frequencies_hz = dataset.preset.itof.frequencies_hz
    measured_file = dataset.render_folder(scene) / MEASUREMENT_FILE
    truth_file = dataset.render_folder(scene) / GROUND_TRUTH_FILE
    phasor = _phasors(scene, measured_file, read_image(measured_file), frequencies_hz)
    truth = read_image(truth_file)
    mirrored = _phasors(scene, truth_file, truth, frequencies_hz[:1])[..., 0]  # (H, W)
    try:
        radial_depth_m, mask = truth.channel("depth.R"), truth.channel("mask.M")
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {truth_file} is no ground truth ({error})") from None
    _refuse_not_finite(scene, truth_file, radial_depth_m, mask)
    if not np.isin(mask, (0.0, 1.0)).all() or (radial_depth_m < 0).any():
        raise ShardError(
            f"scene {scene}: {truth_file} needs mask.M of 0 and 1 and depth.R from 0 m: render it again"
        )
    if phasor.shape[:2] != mask.shape:
        height, width = mask.shape
        raise ShardError(
            f"wrong resolution between stages: scene {scene} has a measurement of "
            f"{phasor.shape[1]}x{phasor.shape[0]} pixels and a ground truth of {width}x{height}; "
            f"run night-render {dataset.root} again"
        )
    target = np.stack([mirrored.real, mirrored.imag])  # (2, H, W)
    return RenderedScene(phasor, target, radial_depth_m, mask.astype(np.uint8))


def _phasors(
    scene: str, file: Path, image: Image, frequencies_hz: tuple[float, ...]
) -> NDArray[np.complex64]:
    try:
        phasor, found_hz = image.phasors("itof")  # (H, W, F)
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {file} holds no phasors ({error})") from None
    if found_hz != frequencies_hz:
        raise ShardError(
            f"scene {scene}: {file} was rendered at {_megahertz(found_hz)}, the dataset asks for "
            f"{_megahertz(frequencies_hz)}: render it again"
        )
    _refuse_not_finite(scene, file, phasor)
    return phasor


def _refuse_not_finite(scene: str, file: Path, *arrays: NDArray[np.generic]) -> None:
    bad = sum(int(np.count_nonzero(~np.isfinite(array))) for array in arrays)
    if bad:
        raise ShardError(
            f"scene {scene}: {file} holds {bad} values that are NaN or infinite: delete it and render again"
        )


def _megahertz(frequencies_hz: tuple[float, ...]) -> str:
    return ", ".join(f"{frequency_hz / 1e6:g}" for frequency_hz in frequencies_hz) + " MHz"
