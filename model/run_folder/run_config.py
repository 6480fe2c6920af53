"""``run.json`` of a run folder: settings, input channels, geometry and data of a training.

Its last key, ``sha256``, is the checksum of the whole file (`disk.checksums`).
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import torch
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from disk import NightError, PathLike, whole_file
from disk.checksums import ZEROS, has_right_checksum, with_checksum
from disk.contract import STRICT, checked
from disk.plain_file import read_plain
from disk.quantities import FieldOfView, Frequency, Positive
from itof.wall.wall_view import WallView
from model.network.bounce_images import BounceImages
from model.network.channels import InputSpec
from model.network.mask_and_depth import MaskAndDepth
from model.network.readout import Readout
from model.network.unet import UNet
from model.run_folder.shipped import run_folder, shipped_runs
from model.settings.fresh import FreshScenes
from model.settings.input import averaged_over
from model.settings.target import ComponentsTarget, MaskAndDepthTarget
from model.settings.train_settings import MAY_CHANGE_ON_RESUME, TrainSettings, flat_settings, plain_settings

RUN_SCHEMA: Final = 4
CONFIG_FILE: Final = "run.json"
_MARK: Final = ',\n  "sha256": "'
_END: Final = '"\n}\n'
_REPAIR: Final = "take the file from a copy of the run, or train again"
Pixels = Annotated[int, Field(ge=1, le=2**16)]
Metres = Annotated[float, Field(gt=0, le=1000)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


# Of the pixels in a row or column of the training: more than fields of view change their size.
_LEAST_SEEN = 0.8


class RunError(NightError):
    """The run folder is missing, damaged, in use, or not a run of this schema version."""


@dataclass(frozen=True, config=STRICT)
class StartingWeights:
    """The trained network whose weights a run started from.

    Attributes
    ----------
    run : name of its run folder, for people: the folder may be elsewhere by now, or gone.
    run_id : id of that run.
    sha256 : SHA-256 of its ``best.safetensors``.
    """

    run: Annotated[str, Field(max_length=255)]
    run_id: Sha256
    sha256: Sha256


@dataclass(frozen=True, config=STRICT)
class RunConfig:
    """Contents of ``run.json``.

    Attributes
    ----------
    settings : settings of the training.
    inputs : input channels and their constants, which were fitted to the training scenes.
    output_frequency_hz : modulation frequency of the predicted phasor, Hz; the first of the dataset, or a
        whole part of it where its phase does not represent every depth.
    geometry : camera and relay wall, from which the direct return is computed.
    image_width, image_height : size of the training images, pixels.
    preset_sha256 : hash of the dataset's resolved preset.
    data_sha256 : hash of the scenes, splits and renders of the dataset.
    night_version : version of the program that trained the network.
    run_id : `run_id_of` the run when it began, which weights and checkpoint repeat.
    background_per_object : background pixels per object pixel of the training scenes, a constant of the loss;
        None if `settings.target` does not need it.
    object_depth_m : mean and standard deviation of the object's radial depth in the training scenes, metres,
        constants of the output for the target ``mask+depth``; None otherwise.
    started_from : the network that the training started from; None if from random weights.
    fresh : the stream of scenes that the network was trained on; None if on those of the dataset.
    fields_of_view_deg : smallest and largest horizontal field of view of the scenes, degrees; None if all
        have that of `geometry`.

    Raises
    ------
    ValueError : `background_per_object` or `object_depth_m` is missing although the settings need it, or
        `settings.network.block` is 0.
    """

    settings: TrainSettings
    inputs: InputSpec
    output_frequency_hz: Frequency
    geometry: WallView
    image_width: Pixels
    image_height: Pixels
    preset_sha256: str
    data_sha256: str
    night_version: str
    run_id: Sha256
    schema_version: Literal[4] = RUN_SCHEMA
    background_per_object: Annotated[Positive | None, Field(exclude_if=lambda value: value is None)] = None
    object_depth_m: Annotated[tuple[Metres, Metres] | None, Field(exclude_if=lambda value: value is None)] = (
        None
    )
    started_from: Annotated[StartingWeights | None, Field(exclude_if=lambda value: value is None)] = None
    fresh: Annotated[FreshScenes | None, Field(exclude_if=lambda value: value is None)] = None
    fields_of_view_deg: Annotated[
        tuple[FieldOfView, FieldOfView] | None, Field(exclude_if=lambda value: value is None)
    ] = None

    def __post_init__(self) -> None:
        if self.settings.balances_dataset and self.background_per_object is None:
            raise ValueError("the balance dataset needs background_per_object")
        if self.settings.predicts_probability and self.object_depth_m is None:
            raise ValueError("the target mask+depth needs object_depth_m")
        if self.settings.network.block == 0:
            raise ValueError("block 0 stands for a number that depends on the image; a run has that number")

    @property
    def trained_views_deg(self) -> tuple[float, float]:
        """Smallest and largest horizontal field of view of the training, degrees."""
        one_deg = self.geometry.horizontal_fov_deg
        return self.fields_of_view_deg or (one_deg, one_deg)

    @property
    def saw_captures(self) -> bool:
        """Whether a camera measured the training scenes, and the empty corner, too."""
        camera = self.settings.augmentation.camera
        return camera is not None and camera.empty_corner

    def reads(self, width: int, height: int) -> bool:
        """Whether the network can see images of so many pixels.

        One that knows rays sees means of blocks, whose numbers in a row and in a column must be about those
        of the training.
        """
        own = self.image_width, self.image_height
        if not self.inputs.shows_rays:
            return (width, height) == own
        seen, trained = (
            [side // averaged_over(sides[0]) for side in sides] for sides in ((width, height), own)
        )
        return all(
            _LEAST_SEEN * theirs <= ours <= theirs / _LEAST_SEEN
            for ours, theirs in zip(seen, trained, strict=True)
        )

    @property
    def readout(self) -> Readout:
        """Reads mask and depth from the output of this run's network."""
        target, frequency_hz = self.settings.target, self.output_frequency_hz
        if isinstance(target, MaskAndDepthTarget):
            mean_m, spread_m = self.object_depth_m or (0.0, 1.0)  # `__post_init__` refuses None
            return MaskAndDepth(
                frequency_hz,
                target.mask_threshold,
                mask_from="amplitude",
                depth_mean_m=mean_m,
                depth_spread_m=spread_m,
                has_uncertainty=target.uncertainty,
            )
        if isinstance(target, ComponentsTarget):
            return Readout(
                *(frequency_hz, target.mask_threshold, target.dead_zone, target.mask_from),
                mask_depth_m=target.mask_depth_m,
                mask_gradient=target.mask_gradient,
            )
        return Readout(
            frequency_hz,
            dead_zone=target.dead_zone,
            mask_from="depth",
            mask_depth_m=target.mask_depth_m,
            target=target.kind,
        )

    def network(self, generator: torch.Generator | None = None) -> UNet:
        """A network of this run's architecture with initial weights.

        The images of the three bounces are black: the corner decides them
        (`model.refinement.light.inverse`), and they are saved with the weights.
        """
        sizes, image = self.settings.network, (self.image_width, self.image_height)
        has_images = self.settings.input.bounce_images
        images = BounceImages(*self.inputs.residual_channels, *image) if has_images else None
        return UNet(
            self.inputs.channel_count,
            sizes.width,
            levels=sizes.levels,
            negative_slope=sizes.negative_slope,
            output_channels=self.readout.output_channels,
            block=sizes.block,
            uncertainty=self.settings.predicts_uncertainty,
            images=images,
            rays=self.inputs.shows_rays,
            generator=generator,
        )


def run_id_of(config: RunConfig) -> str:
    """SHA-256 of all that decides the weights and cannot change when the run is resumed.

    Two runs with the same settings on the same data have the same id; their weights are interchangeable.
    """
    content = TypeAdapter(RunConfig).dump_python(config, mode="json")
    for name in ("night_version", "run_id", "schema_version"):
        del content[name]
    if config.started_from:
        content["started_from"] = config.started_from.sha256
    for key in _may_change(config.settings):
        group, name = key.split(".")
        del content["settings"][group][name]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write_config(folder: Path, config: RunConfig) -> None:
    """Write ``run.json``."""
    text = TypeAdapter(RunConfig).dump_json(config, indent=2).decode().removesuffix("\n}")
    content = with_checksum(f"{text}{_MARK}{ZEROS}{_END}".encode(), _MARK)
    with whole_file(folder / CONFIG_FILE) as partial:
        partial.write_bytes(content)


def read_config(folder: Path) -> RunConfig:
    """Read ``run.json``.

    Raises
    ------
    RunError : the folder is missing or not a run, or ``run.json`` is damaged, invalid or of another schema
        version.
    """
    file = folder / CONFIG_FILE
    if folder.exists() and not folder.is_dir():
        raise RunError(f"{folder} is a file: give the folder of a run")
    if not folder.is_dir():
        others = f", or give one of {', '.join(shipped_runs())}" if shipped_runs() else ""
        raise RunError(f"there is no folder {folder}: train a network with night-train{others}")
    if not file.is_file():
        raise RunError(f"{folder} is no training run (it has no run.json): train one with night-train")
    try:
        content = read_plain(file)
    except OSError as error:
        raise RunError(f"{file} cannot be read: {error.strerror}") from None
    text = _without_checksum(content)
    if text is None and _MARK.encode() in content:
        raise RunError(f"{file} is damaged or was edited (wrong checksum): {_REPAIR}")
    schema = _schema_version(text or content, file)
    if schema != RUN_SCHEMA:
        raise RunError(
            f"{file} has schema version {schema}, this program reads version {RUN_SCHEMA}: "
            "train again, or use the version of NIGHT that made it"
        )
    if text is None:
        raise RunError(f"{file} is damaged or was edited (no checksum): {_REPAIR}")
    config: RunConfig = checked(TypeAdapter(RunConfig), text, str(file), RunError)
    return config


def _without_checksum(content: bytes) -> bytes | None:
    """The text that a right checksum vouches for; None if there is no such checksum."""
    start = content.rfind(_MARK.encode())
    is_last = content.endswith(_END.encode()) and start + len(_MARK + ZEROS + _END) == len(content)
    return content[:start] + b"\n}" if is_last and has_right_checksum(content, _MARK) else None


def _schema_version(text: bytes, file: Path) -> Any:
    try:
        return TypeAdapter(dict[str, Any]).validate_json(text).get("schema_version")
    except ValidationError:
        raise RunError(f"{file} is not the JSON of a run: {_REPAIR}") from None


def run_settings(folder: PathLike) -> dict[str, Any]:
    """The settings of a run as plain data for `settings_from_dict`, with which the run can be resumed.

    Raises
    ------
    RunError : as in `read_config`.
    """
    return plain_settings(read_config(Path(folder)).settings)


def fine_tuning_settings(folder: PathLike) -> dict[str, Any]:
    """The settings that a training takes over if it starts from the weights of this run, as plain data.

    They are its input, network and kind of target, which must stay, and the rest of its target and its
    algorithm, which may be changed.

    Raises
    ------
    RunError : as in `read_config`.
    """
    config = read_config(run_folder(folder))
    settings = plain_settings(config.settings)
    return {
        "input": settings["input"] | {"frequencies_hz": list(config.inputs.frequencies_hz)},
        "network": settings["network"],
        "target": settings["target"],
        "optimiser": {"algorithm": settings["optimiser"]["algorithm"]},
    }


def changed_setting(before: RunConfig, now: RunConfig) -> str | None:
    """The first difference that prevents resuming `before` as `now`, in words; None if there is none."""
    may_change, old, new = (
        _may_change(before.settings),
        *map(flat_settings, (before.settings, now.settings)),
    )
    for key in {**old, **new}:
        if key not in may_change and old.get(key) != new.get(key):
            why = " (the learning rate's schedule ends with it)" if key == "run.max_epochs" else ""
            return f"{key} was {old.get(key)} and is now {new.get(key)}{why}"
    if before.data_sha256 != now.data_sha256:
        return "the dataset is not the one that the run began with"
    return None


def _may_change(settings: TrainSettings) -> frozenset[str]:
    """Keys of the settings that may be others when the run is resumed."""
    if settings.optimiser.schedule == "constant":
        return MAY_CHANGE_ON_RESUME
    return MAY_CHANGE_ON_RESUME - {"run.max_epochs"}  # the learning rate of every epoch depends on it
