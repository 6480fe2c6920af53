"""Reading and checking the renders of a scene that training uses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from disk import FileHashes, NightError
from disk.frequency_text import megahertz
from itof import (
    DepthMap,
    Image,
    ImageFileError,
    TransientReader,
    depth_from_phase,
    phase,
    read_image,
    unambiguous_range_m,
)
from model.settings.run import GroundTruth
from scenegen import (
    GROUND_TRUTH_FILE,
    MEASUREMENT_FILE,
    MIRRORED_TRANSIENT_FILE,
    RENDER_AGAIN,
    Dataset,
    RenderRecord,
    read_recipe,
    read_record,
    recorded_file,
)
from scenegen.depth_range import turns_of_first_phase
from scenegen.recorded_files import changed_file

TRUTH_FILES: dict[GroundTruth, str] = {"geometry": GROUND_TRUTH_FILE, "simulated": MIRRORED_TRANSIENT_FILE}


class ShardError(NightError):
    """Renders or shards cannot be used: they are missing, damaged, changed, not finite or differ in size."""


@dataclass(frozen=True)
class RenderedScene:
    """Measurement and ground truth of one scene, (H, W) pixels.

    Attributes
    ----------
    phasor : (H, W, F) complex64 measurement at every modulation frequency.
    truth : (H, W) ground truth; its phasor is at the first frequency.
    """

    phasor: NDArray[np.complex64]
    truth: DepthMap

    @property
    def size(self) -> str:
        """Width x height in pixels, as text."""
        height, width = self.truth.mask.shape
        return f"{width}x{height}"


def source_files(dataset: Dataset, ground_truth: GroundTruth) -> dict[str, Path]:
    """The files from which shards are made, by their path within the dataset, in scene order.

    Raises
    ------
    ShardError : a scene is not rendered, or the phase of the simulated ground truth may wrap.
    """
    if ground_truth == "simulated" and turns_of_first_phase(dataset.preset) > 1:
        first_hz = dataset.preset.itof.frequencies_hz[0]
        raise ShardError(
            f"{dataset.root} has no simulated ground truth: its depth is that of the phase at "
            f"{megahertz(first_hz)}, which repeats every {float(unambiguous_range_m(first_hz)):.4g} m, and "
            "mirrored hidden objects can be farther from the camera: take run.ground_truth=geometry"
        )
    scenes = dataset.ids()
    files = {
        f"renders/{scene}/{name}": dataset.render_folder(scene) / name
        for scene in scenes
        for name in (MEASUREMENT_FILE, TRUTH_FILES[ground_truth])
    }
    missing = [path for path in files.values() if not path.is_file()]
    if missing:
        unrendered = sorted({path.parent.name for path in missing})
        others = f" (and {len(unrendered) - 1} more of {len(scenes)} scenes)" if len(unrendered) > 1 else ""
        more = " --product both" if missing[0].name == MIRRORED_TRANSIENT_FILE else ""
        raise ShardError(
            f"scene {missing[0].parent.name}{others} has no {missing[0].name}: "
            f"run night-render {dataset.root}{more}"
        )
    return files


def source_hashes(
    dataset: Dataset, hashes: FileHashes, ground_truth: GroundTruth
) -> dict[str, dict[str, str]]:
    """SHA-256 of the files from which shards are made, by scene and by their path within the dataset.

    Raises
    ------
    ShardError : a scene is not rendered, or with another number of bounces than the others.
    RenderFileError : a scene has no record, or a file differs from the one in it.
    """
    found: dict[str, dict[str, str]] = {scene: {} for scene in dataset.ids()}
    record, bounces = None, _Bounces(dataset)
    for name, path in source_files(dataset, ground_truth).items():
        scene = path.parent.name
        if not found[scene]:
            record = read_record(path.parent)
            bounces.refuse_others(scene, record)
        if record is None or path.name not in record.files:
            recorded_file(dataset, scene, path.name)  # passes for measurements from another program
        digest = found[scene][name] = hashes.sha256(path)
        if record is not None and record.files[path.name].sha256 != digest:
            raise changed_file(dataset, scene, path)
    return found


class _Bounces:
    """Compares how many bounces of light the scenes of a dataset are rendered with."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.first: tuple[str, int] | None = None  # a scene and its number

    def refuse_others(self, scene: str, record: RenderRecord | None) -> None:
        """`ShardError` if the scene has another number than those before; a scene without record has none."""
        count = read_recipe(record.recipe).get("max_bounces") if record is not None else None
        if not isinstance(count, int):
            return
        self.first = self.first or (scene, count)
        if count != self.first[1]:
            root = self.dataset.root
            raise ShardError(
                f"scene {self.first[0]} of {root} is rendered with at most {self.first[1]} bounces and scene "
                f"{scene} with {count}: night-render {root} --again changed --max-bounces N renders all alike"
            )


def read_render(dataset: Dataset, scene: str, ground_truth: GroundTruth = "geometry") -> RenderedScene:
    """Measurement and ground truth of a scene, from files that are compared with their record first.

    Raises
    ------
    RenderFileError : the scene has no record, or a file is not the recorded one.
    ImageFileError : a file without a record is missing, truncated or not an EXR file.
    ShardError : a channel is missing, a value is not finite, the frequencies are not those of the dataset,
        or measurement and ground truth differ in size.
    """
    frequencies_hz = dataset.preset.itof.frequencies_hz
    measured_file = recorded_file(dataset, scene, MEASUREMENT_FILE)
    image = read_image(measured_file, advice=RENDER_AGAIN)
    phasor = _phasors(scene, measured_file, image, frequencies_hz)
    read_truth = _simulated_truth if ground_truth == "simulated" else _ground_truth
    truth = read_truth(scene, recorded_file(dataset, scene, TRUTH_FILES[ground_truth]), frequencies_hz[0])
    if phasor.shape[:2] != truth.mask.shape:
        height, width = truth.mask.shape
        raise ShardError(
            f"wrong resolution between stages: scene {scene} has a measurement of "
            f"{phasor.shape[1]}x{phasor.shape[0]} pixels and a ground truth of {width}x{height}; "
            f"run night-render {dataset.root} again"
        )
    return RenderedScene(phasor, truth)


def _ground_truth(scene: str, file: Path, frequency_hz: float) -> DepthMap:
    image = read_image(file, advice=RENDER_AGAIN)
    try:
        truth = DepthMap.of_image(image)
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {file} {error}: {RENDER_AGAIN}") from None
    _refuse_other_frequencies(scene, file, (truth.frequency_hz,), (frequency_hz,))
    if ((truth.radial_depth_m > 0) != truth.mask).any():
        raise ShardError(
            f"scene {scene}: {file} needs a depth where its mask shows the object, and 0 elsewhere: "
            f"{RENDER_AGAIN}"
        )
    return truth


def _simulated_truth(scene: str, file: Path, frequency_hz: float) -> DepthMap:
    """The truth that the simulated camera measures of the mirrored scene: Φ x of its transient.

    The phasor is divided by its own amplitude, as the components of the network's input are, which gives the
    amplitude 1 of the paper's released code. A pixel shows the object if any light comes from it, so pixels
    at an edge belong to the object. The depth is that of the phase.

    Source: Caligiuri et al. 2024, sec. 4.1 (the same simulator as for the input); normalisation is ours.
    """
    try:
        with TransientReader(file, advice=RENDER_AGAIN) as reader:
            measured = reader.phasors([frequency_hz])[..., 0]  # (H, W)
    except ImageFileError:
        raise
    except ValueError as error:
        raise ShardError(f"scene {scene}: {file} gives no phasors ({error}): {RENDER_AGAIN}") from None
    with np.errstate(over="ignore"):  # the next line finds overflows
        _refuse_not_finite(scene, file, measured.astype(np.complex64))
    amplitude = np.abs(measured)
    mask = amplitude > 0
    unit = measured / np.where(mask, amplitude, 1)
    return DepthMap(
        radial_depth_m=np.where(mask, depth_from_phase(phase(measured), frequency_hz), 0),
        mask=mask,
        phasor=unit.astype(np.complex64),
        frequency_hz=frequency_hz,
    )


def _phasors(
    scene: str, file: Path, image: Image, frequencies_hz: tuple[float, ...]
) -> NDArray[np.complex64]:
    try:
        phasor, found_hz = image.phasors("itof")  # (H, W, F)
    except ImageFileError as error:
        raise ShardError(f"scene {scene}: {file} holds no phasors ({error}): {RENDER_AGAIN}") from None
    _refuse_other_frequencies(scene, file, found_hz, frequencies_hz)
    _refuse_not_finite(scene, file, phasor)
    return phasor


def _refuse_other_frequencies(
    scene: str, file: Path, found_hz: tuple[float, ...], frequencies_hz: tuple[float, ...]
) -> None:
    if found_hz != frequencies_hz:
        raise ShardError(
            f"scene {scene}: {file} was rendered at {megahertz(*found_hz)}, the dataset asks for "
            f"{megahertz(*frequencies_hz)}: render it again"
        )


def _refuse_not_finite(scene: str, file: Path, phasor: NDArray[np.complex64]) -> None:
    bad = int(np.count_nonzero(~np.isfinite(phasor)))
    if bad:
        raise ShardError(f"scene {scene}: {file} holds {bad} values that are NaN or infinite: {RENDER_AGAIN}")
