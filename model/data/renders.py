"""What training needs of one scene's renders, read and checked before it can spoil anything."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from itof import DepthMap, Image, ImageFileError, read_image
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, Dataset, FileHashes, NightError, read_record


class ShardError(NightError):
    """Renders that cannot become training data: missing, damaged, not finite or of another size."""


@dataclass(frozen=True)
class RenderedScene:
    """Measurement and ground truth of one scene.

    Attributes
    ----------
    phasor : (H, W, F) complex64, what the camera measures at every frequency.
    truth : (H, W) ground truth, at the first frequency.
    """

    phasor: NDArray[np.complex64]
    truth: DepthMap

    @property
    def size(self) -> str:
        """Width x height, as people write it."""
        height, width = self.truth.mask.shape
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
            if record is None and dataset.rendering is not None:
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
    truth = _ground_truth(scene, truth_file, frequencies_hz[0])
    if phasor.shape[:2] != truth.mask.shape:
        height, width = truth.mask.shape
        raise ShardError(
            f"wrong resolution between stages: scene {scene} has a measurement of "
            f"{phasor.shape[1]}x{phasor.shape[0]} pixels and a ground truth of {width}x{height}; "
            f"run night-render {dataset.root} again"
        )
    return RenderedScene(phasor, truth)


def _ground_truth(scene: str, file: Path, frequency_hz: float) -> DepthMap:
    image = read_image(file)
    try:
        truth = DepthMap.of_image(image)
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {file} {error}: delete it and render again") from None
    _refuse_other_frequencies(scene, file, (truth.frequency_hz,), (frequency_hz,))
    return truth


def _phasors(
    scene: str, file: Path, image: Image, frequencies_hz: tuple[float, ...]
) -> NDArray[np.complex64]:
    try:
        phasor, found_hz = image.phasors("itof")  # (H, W, F)
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {file} holds no phasors ({error})") from None
    _refuse_other_frequencies(scene, file, found_hz, frequencies_hz)
    _refuse_not_finite(scene, file, phasor)
    return phasor


def _refuse_other_frequencies(
    scene: str, file: Path, found_hz: tuple[float, ...], frequencies_hz: tuple[float, ...]
) -> None:
    if found_hz != frequencies_hz:
        raise ShardError(
            f"scene {scene}: {file} was rendered at {_megahertz(found_hz)}, the dataset asks for "
            f"{_megahertz(frequencies_hz)}: render it again"
        )


def _refuse_not_finite(scene: str, file: Path, phasor: NDArray[np.complex64]) -> None:
    bad = int(np.count_nonzero(~np.isfinite(phasor)))
    if bad:
        raise ShardError(
            f"scene {scene}: {file} holds {bad} values that are NaN or infinite: delete it and render again"
        )


def _megahertz(frequencies_hz: tuple[float, ...]) -> str:
    return ", ".join(f"{frequency_hz / 1e6:g}" for frequency_hz in frequencies_hz) + " MHz"
