"""Conditions under which a training cannot start or continue."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from errno import EDQUOT, EFBIG, ENOSPC
from pathlib import Path
from typing import Final

from disk import NightError, is_partial
from disk.frequency_text import megahertz
from itof import unambiguous_range_m
from model.data.sensor_draws import view_problem
from model.data.shards import Shards
from model.device import plain_memory_errors
from model.refinement.light.corner_light import CornerLight
from model.run_folder.history import HISTORY_FILE, read_history
from model.run_folder.run_config import CONFIG_FILE, RunConfig, RunError, read_config
from model.settings.fresh import FreshScenes
from model.settings.target import ComponentsTarget
from model.settings.train_settings import TrainSettings
from model.training.checkpoint import CHECKPOINT_FILE
from model.training.lock import LOCK_FILE
from scenegen import Dataset, Preset, sample_scene
from scenegen.depth_range import largest_mirrored_depth_m, turns_of_first_phase
from scenegen.shapes import MESH_PREFIX, Shape
from scenegen.unit_meshes import UnitMesh

_BOUNCES: Final = 3  # of the batched engine
RESUME: Final = "go on with night-train --resume"
GO_ON: Final = f"{RESUME}; the run keeps its last checkpoint"


class TrainingError(NightError):
    """Training is impossible: the dataset lacks a split, a loss is bad, or memory is too small."""


def refuse_start(dataset: Dataset, out: Path, resume: bool) -> None:
    """Refuse an unsuitable `out` and a dataset that lacks a split, before any slow work.

    Raises
    ------
    RunError : `out` contains other files, or a run and `resume` is False, or no run and `resume` is True.
    TrainingError : there are no training or no validation scenes.
    """
    refuse_other_run(out, resume)
    for split in ("train", "validation"):
        if not dataset.ids(split):
            if dataset.preset.is_sequence:
                raise TrainingError(f"{dataset.root} is a sequence, to judge by: train on other scenes")
            raise TrainingError(
                f"{dataset.root} has no {split} scenes ({len(dataset.ids())} scenes in all): make more "
                "scenes, or change dataset.test_fraction and dataset.validation_fraction of the preset"
            )


def refuse_other_run(out: Path, resume: bool) -> None:
    """Refuse an unsuitable `out`, as `refuse_start`."""
    if resume:
        read_config(out)
    elif out.exists() and not _is_free(out):
        if not out.is_dir():
            raise RunError(f"{out} is a file: choose another folder for the run")
        if (out / CONFIG_FILE).is_file():
            raise RunError(f"{out} exists already: resume it (--resume) or choose another folder")
        raise RunError(f"{out} is not empty and holds no run: choose another folder")


def refuse_images_of_many_corners(dataset: Dataset, settings: TrainSettings) -> None:
    """`TrainingError` for images of the three bounces where they would be right for one scene only."""
    if settings.input.bounce_images and not dataset.preset.is_one_corner:
        raise TrainingError(
            f"each scene of {dataset.root} has its camera elsewhere (camera_spread), and bounce_images are "
            "for one corner: take --channels residual+wall+rays, or --set "
            "input.channels.bounce_images=false"
        )


def refuse_without_engine(settings: TrainSettings, fresh: FreshScenes | None) -> None:
    """A `NightError` for fresh scenes or images of the three bounces where no light can be computed."""
    if fresh is not None:
        CornerLight(())
    if settings.input.bounce_images:
        try:
            CornerLight(())
        except NightError as error:
            raise TrainingError(
                f"{error}, or train without images of the three bounces: --set "
                "input.channels.bounce_images=false"
            ) from None


def output_frequency_hz(dataset: Dataset, settings: TrainSettings, fresh: FreshScenes | None) -> float:
    """Frequency of the predicted phasors: the first of the dataset, or a whole part of it, Hz.

    A part is needed where the phase at the first one turns more than once over the depths of the scenes.

    Raises
    ------
    TrainingError : then, if the target is the phasor at the first frequency itself.
    """
    presets = [dataset.preset, *([fresh.preset] if fresh else [])]
    first_hz = dataset.preset.itof.frequencies_hz[0]
    output_hz = represented_frequency_hz(first_hz, presets)
    if output_hz < first_hz and isinstance(settings.target, ComponentsTarget):
        raise TrainingError(
            f"target.kind components is the phasor at the first frequency of {dataset.root}, "
            f"{megahertz(first_hz)}, whose phase represents depths below "
            f"{float(unambiguous_range_m(first_hz)):.4g} m, and mirrored hidden objects can be up to "
            f"{max(map(largest_mirrored_depth_m, presets)):.4g} m from the camera: take mask+depth or depth"
        )
    return output_hz


def represented_frequency_hz(first_hz: float, presets: Sequence[Preset]) -> float:
    """The first frequency, Hz, or a whole part of it: its phase turns once over the depths of the scenes."""
    turns = max(map(turns_of_first_phase, presets))
    return first_hz if turns == 1 else float(first_hz // turns)


def refuse_other_view(shards: Shards, dataset: Dataset, settings: TrainSettings) -> None:
    """`TrainingError` if the camera of the settings cannot measure the images of the dataset."""
    camera = settings.augmentation.camera
    if camera is not None:
        found = shards.manifest
        frequencies_hz = settings.input.frequencies_hz or found.frequencies_hz
        size = found.width, found.height
        problem = view_problem(camera.sensor, dataset.preset, dataset.root, *size, frequencies_hz)
        if problem:
            raise TrainingError(problem)


def refuse_preset(
    fresh: FreshScenes, source: object, settings: TrainSettings, meshes: Mapping[Shape, UnitMesh]
) -> None:
    """`TrainingError` if no network can be trained on fresh scenes of a preset, before there is a dataset."""
    preset, problem = fresh.preset, _fresh_problem(fresh, settings, meshes)
    camera, lens = settings.augmentation.camera, preset.camera
    if problem is None and not sample_scene(preset, 0).has_flash:
        problem = f"{source} has a projector of its own: networks know only a flash at the camera"
    if problem is None and sample_scene(preset, 0).room_reflects:
        problem = f"{source} has a [room] that reflects, which fresh scenes have not: render a dataset of it"
    if problem is None and settings.input.bounce_images and not preset.is_one_corner:
        problem = f"{source} is of many corners (camera_spread): take --channels residual+wall+rays"
    if problem is None and camera is not None:
        frequencies_hz = settings.input.frequencies_hz or preset.itof.frequencies_hz
        size = lens.width, lens.height
        problem = view_problem(camera.sensor, preset, source, *size, frequencies_hz)
    if problem:
        raise TrainingError(problem)


def refuse_other_corner(
    fresh: FreshScenes,
    dataset: Dataset,
    shards: Shards,
    settings: TrainSettings,
    meshes: Mapping[Shape, UnitMesh],
) -> None:
    """`TrainingError` if fresh scenes do not fit a dataset, or cannot be made for a training."""
    problem = _corner_problem(fresh.preset, dataset, shards) or _fresh_problem(fresh, settings, meshes)
    if problem:
        raise TrainingError(problem)


def _corner_problem(preset: Preset, dataset: Dataset, shards: Shards) -> str | None:
    """Why a dataset cannot scale and judge a training on fresh scenes of a preset."""
    root, judged, found, camera = dataset.root, dataset.preset, shards.manifest, preset.camera
    if dataset.is_measured:
        return f"{root} holds captures, which fresh scenes do not resemble"
    if not preset.is_one_corner and judged.is_one_corner:
        return f"fresh scenes have their cameras elsewhere (camera_spread), and those of {root} do not"
    if preset.projector != judged.projector:
        return f"the projector of fresh scenes must be that of {root}"
    if _corner(preset) != _corner(judged):
        return f"camera and relay wall of fresh scenes must be those of {root}, which judges them"
    size = f"{found.width}x{found.height} pixels"
    if found.width * camera.height != found.height * camera.width:
        return f"images of {root} have {size}, fresh ones have the shape {camera.width}x{camera.height}"
    if preset.itof.frequencies_hz != found.frequencies_hz:
        known, other = megahertz(*found.frequencies_hz), megahertz(*preset.itof.frequencies_hz)
        return f"fresh scenes have {other}, and {root} has {known}"
    return None


def _fresh_problem(
    fresh: FreshScenes, settings: TrainSettings, meshes: Mapping[Shape, UnitMesh]
) -> str | None:
    """Why fresh scenes cannot be made for a training."""
    named = {shape for shape in fresh.preset.shapes if shape.startswith(MESH_PREFIX)}
    bounces, paper = fresh.preset.transient.max_bounces, settings.augmentation.paper
    if settings.run.ground_truth != "geometry":
        return "fresh scenes have no simulated ground truth: take run.ground_truth=geometry"
    if bounces != _BOUNCES:
        return f"fresh scenes have {_BOUNCES} bounces, and the preset asks for {bounces}"
    if fresh.preset.is_sequence:
        return "the preset is of a sequence, which shows one motion: train without dataset.frame_rate_hz"
    if not named <= set(meshes):
        return "the mesh files of fresh scenes are not known: give --fresh PRESET, also with --resume"
    if paper is not None and paper.copies_per_change:
        return "fresh scenes are no set to enlarge once: take augmentation.paper.copies_per_change=0"
    return None


def _corner(preset: Preset) -> tuple[object, ...]:
    """Place of camera and relay wall, and the field of view."""
    camera, wall = preset.camera, preset.relay_wall
    lens = camera.horizontal_fov_deg
    return camera.location_m, camera.rotation_deg, lens, wall.location_m, wall.rotation_deg


def refuse_missing_scenes(shards: Shards, dataset: Dataset, wanted: int | None) -> None:
    """`TrainingError` if every scene of a split failed to render, or fewer than `wanted` are for training."""
    for split in ("train", "validation"):
        if not shards.rows(split):
            raise TrainingError(
                f"no {split} scene of {dataset.root} could be rendered: see night-render status"
            )
    count = len(shards.rows("train"))
    if wanted is not None and wanted > count:
        raise TrainingError(
            f"run.train_scenes is {wanted}, but {dataset.root} has {count} training scenes: make more "
            "scenes, or give a smaller number"
        )


def _is_free(out: Path) -> bool:
    """Whether `out` is a folder without files, except those of a process that was killed before any epoch."""
    if not out.is_dir():
        return False
    names = {entry.name for entry in out.iterdir() if not is_partial(entry.name)}
    if not names <= {LOCK_FILE, HISTORY_FILE, CHECKPOINT_FILE}:
        return False
    if not (out / HISTORY_FILE).is_file():
        return not names & {HISTORY_FILE, CHECKPOINT_FILE}
    try:  # a fine-tuning writes history and checkpoint before run.json
        return not any(read_history(out).values())
    except RunError:
        return False


@contextmanager
def naming_memory(config: RunConfig) -> Iterator[None]:
    """Turn the out-of-memory exceptions of PyTorch and numpy into a `TrainingError`."""
    try:
        with plain_memory_errors():
            yield
    except MemoryError:
        raise TrainingError(
            f"out of memory with batch size {config.settings.optimiser.batch_size} and width "
            f"{config.settings.network.width} "
            f"at {config.image_width}x{config.image_height} pixels: make the batch or the width smaller"
        ) from None


@contextmanager
def naming_disk(path: Path, then: str = GO_ON) -> Iterator[None]:
    """Turn the exceptions of a full or read-only disk into a `RunError`.

    Parameters
    ----------
    path : the file that is written.
    then : what to do when the disk has room again.
    """
    try:
        yield
    except OSError as error:
        cure = "free some space" if error.errno in (ENOSPC, EFBIG, EDQUOT) else "make it writable"
        reason = error.strerror or error
        raise RunError(f"{path} cannot be written ({reason}): {cure} and {then}") from None
