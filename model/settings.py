"""Settings of a training run, as plain data: neither torch nor anything that the settings are for."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import log2
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from itof.sensor.cameras import load_sensor
from itof.sensor.settings import SensorSettings
from storage import NightError, PathLike, PresetError, inside, read_settings, shipped_file
from storage.contract import STRICT, checked_data
from storage.quantities import Positive, WholeCount

Channels = Literal["paper", "residual", "paper+residual", "residual+wall"]
AmplitudeDivisor = Literal["mean", "maximum"]
Reference = Literal["geometry", "capture", "self", "self+wiggling"]
LossName = Literal["mae", "mse", "mae+iou", "mse+iou", "mae+lovasz", "bce+iou+depth"]
Balance = Literal["image", "dataset", "class-means"]
Target = Literal["components", "depth", "mask+depth"]
GroundTruth = Literal["geometry", "simulated"]
LossTarget = Literal["components", "depth"]
MaskSource = Literal["amplitude", "depth"]
MaskGradient = Literal["amplitude", "depth"]
Freeze = Literal["none", "encoder", "all-but-head", "all-but-uncertainty"]
DeviceName = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "float32", "bfloat16", "float16"]
Schedule = Literal["constant", "cosine"]
Optimiser = Literal["adam", "muon"]
MAY_CHANGE_ON_RESUME = frozenset({"max_epochs", "device", "progress", "checkpoint_minutes", "compile"})
# A run that starts from the weights of another one has its network and input, and by default its readout, the
# loss that goes with it, and its optimiser: dead units that Adam left make Muon unstable.
NETWORK_SETTINGS = (
    "channels",
    "reference",
    "amplitude_divisor",
    "frequencies_hz",
    "width",
    "levels",
    "negative_slope",
    "block",
    "target",
    "uncertainty",
    "bounce_images",
)
READOUT_SETTINGS = (
    *("loss", "smooth_l1_beta"),
    *("mask_from", "mask_gradient", "mask_threshold", "mask_depth_m", "dead_zone"),
)
STARTING_SETTINGS = (*NETWORK_SETTINGS, *READOUT_SETTINGS, "optimiser")
MOST_MULTIPLE = 1024  # pixels: the U-Net enlarges images to a multiple of blocks, halved at every level
NotNegative = Annotated[float, Field(ge=0)]


@dataclass(frozen=True, config={**STRICT, "use_attribute_docstrings": True})
class TrainSettings:
    """Everything that decides a training run.

    docs/science/paper.md says which defaults are the paper's; the preset ``paper`` has all of its values.
    Options of ``night-train`` are made of these fields: the text below a field is its description there.
    """

    frequencies_hz: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Modulation frequencies that the network sees; by default all of the dataset's."""
    channels: Channels = "paper+residual"
    """Network input. With paper alone it learns slowly (notebook/results.md). residual+wall also says
    where the wall of each image is, for datasets of many corners; it needs reference self."""
    reference: Reference = "geometry"
    """Direct return in the residual channels: computed from camera and wall, or a capture of the empty corner
    that predictions then need, or moved to the wall and phases that each measurement shows (self), which may
    have the four-cycle error of a square-wave camera (self+wiggling)."""
    amplitude_divisor: AmplitudeDivisor = "mean"
    """The amplitude channel is divided by this amplitude of the training scenes; the paper: to [0, 1]."""
    width: Annotated[int, Field(ge=1, le=1_000_000)] = 32
    """Channels of the U-Net's first level; each level has twice as many as the one before."""
    levels: Annotated[int, Field(ge=1, le=8)] = 5
    """Levels of the U-Net's encoder; the paper: 5."""
    negative_slope: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Slope of the ReLUs below 0. With 0, as in the paper, a long training leaves dead units
    (notebook/experiments.md)."""
    block: Annotated[int, Field(ge=0, le=64)] = 1
    """Pixels per side of a position of the U-Net; the paper: 1. 0: the power of two, at most 8, with which an
    image is about 20 positions wide."""
    target: Target = "components"
    """What the network predicts: Re and Im of the mirrored scene, its depth in metres directly, or the
    probability and the depth of an object pixel. With depth, error and mask are those of the depth, whatever
    loss_on and mask_from say. mask+depth goes with the loss bce+iou+depth."""
    uncertainty: bool = False
    """With target mask+depth: a second head predicts the error of the depth; it changes nothing else."""
    bounce_images: bool = False
    """The network also sees images of the hidden scene, which a linear inverse of the three bounces makes
    from its residual channels. For datasets of one corner."""
    ground_truth: GroundTruth = "geometry"
    """Truth from the shape of the mirrored object, or from the simulator's transient of the mirrored scene,
    as in the paper; simulated needs transients."""
    loss: LossName = "mae+iou"
    """Terms of the loss: error of the output (mae or mse), and overlap of the masks (iou or lovasz). For
    target mask+depth: cross entropy and overlap of the mask, and error of the depth (bce+iou+depth)."""
    smooth_l1_beta: NotNegative = 1.0
    """With loss bce+iou+depth: the error of the depth counts squared up to this many standard deviations of
    the objects' depth (about 20 cm each), and linearly above."""
    loss_on: LossTarget = "components"
    """What the error is taken on: Re and Im of the output, or the depth in metres."""
    alpha: NotNegative = 1 / 7
    """Weight of object pixels in the error; with balance image, 1 balances object and background."""
    balance: Balance = "image"
    """Weight of object pixels by the numbers of pixels of the image, or of the whole training set (released
    code), or mean error of either class (text of the paper)."""
    mask_from: MaskSource = "amplitude"
    """What of the output says whether a pixel shows the object; depth as in the paper."""
    mask_gradient: MaskGradient = "amplitude"
    """With mask_from depth and a loss with iou: what moves the mask in the training. With depth, as in the
    released code, the training ends at no object (notebook/results.md)."""
    mask_threshold: Positive = 0.5
    """Amplitude of the output from which on a pixel shows the object."""
    mask_depth_m: NotNegative = 0.0
    """With mask_from depth: radial depth in metres above which a pixel shows the object."""
    dead_zone: NotNegative = 0.05
    """Components of the output below this become 0 before mask and depth are taken."""
    optimiser: Optimiser = "adam"
    """Adam, as in the paper; or Muon for the inner convolutions and Adam for the other weights, which has a
    smaller error after the same training (notebook/experiments.md)."""
    learning_rate: Positive = 1e-4
    """Step size of the optimiser. With both, the root mean square of a weight's step is about a fifth of it;
    the first steps of Adam are as large as it."""
    train_scenes: WholeCount | None = None
    """Train on the first so many training scenes only, for learning curves; by default on all."""
    batch_size: WholeCount = 32
    """Scenes of one training step, shared by all processes of a run."""
    schedule: Schedule = "constant"
    """Learning rate: constant, or down to 0 along half a cosine by the last epoch."""
    warm_up_epochs: NotNegative = 0.0
    """Epochs in which the learning rate grows from 0; may be a fraction."""
    clip_norm: NotNegative = 0.0
    """Largest norm of the gradient; a longer one is scaled down to it. 0: no limit."""
    ema_decay: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Decay per step of the average of the weights that is validated and kept; 0: no average."""
    max_epochs: WholeCount = 1500
    """Training ends after so many epochs at the latest."""
    patience: WholeCount = 150
    """Training ends after so many epochs without a better validation loss."""
    min_delta: NotNegative = 0.0
    """For patience, a validation loss is better only if it is lower by more than this."""
    freeze: Freeze = "none"
    """Layers that keep the weights of the run that this one starts from (--from)."""
    revive: bool = False
    """Begin with new random weights for those units of the run that this one starts from that are 0 on all
    of 256 training images as rendered: they would learn nothing. The predictions of these images stay."""
    flip_rows: bool = True
    """Flip half of the images top to bottom: an exact symmetry of the scene."""
    flip_columns: bool = False
    """Flip half of the images left to right, as the paper does; no symmetry of the scene."""
    rotation_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    """Turn images at random by up to so many degrees; the paper: 180."""
    translation: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Shift images at random by up to this fraction of their size; the paper: 0.2."""
    amplitude_spread: NotNegative = 0.0
    """Change the exposure at random by a factor of up to 1 + this."""
    least_reflectance: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Darken hidden objects at random, at most to this part of their reflectance; residual channels only."""
    noise_sigma: NotNegative = 1e-4
    """Noise on each component, as a fraction of the amplitude at the first frequency."""
    sensor: SensorSettings | None = None
    """Measure every image with a camera like this one: a name in data/sensors, or a .toml file. Each image
    is measured by another camera of this type, with its own noise; amplitude_spread is the exposure's."""
    sensor_capture: bool = False
    """With sensor: divide by what it makes of the empty corner, for predictions that have such a capture."""
    channel_noise_sigma: NotNegative = 0.0
    """Noise on each normalised input channel. The paper has noise of 1; the released code adds it here."""
    channel_noise_fraction: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Part of the images that get the noise on the channels; the released code: about 1/7."""
    change_fraction: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Part of the images that get each of five changes, and no other: flips, rotation, shift, channel noise;
    0: an image may get several. The paper's enlarged set has about 1/7 of each."""
    copies_per_change: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Enlarge the training set once: so many changed copies of scenes for each change that is switched on, of
    flips, rotation, shift and channel noise. An epoch has the scenes without these changes, and all copies.
    0: change every image anew. The released code: 403."""
    precision: Precision = "float32"
    """Number type of the convolutions; auto: bfloat16 where the processor computes in it."""
    channels_last: bool = True
    """Keep images in channels-last memory order, which is faster on most processors."""
    compile: bool = False
    """Compile the network with torch.compile: needs a C++ compiler, and a minute at the start."""
    checkpoint_minutes: NotNegative = 10.0
    """Minutes between two checkpoints; 0: one after every batch."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of the weights, of the order of scenes and of the augmentation."""
    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU if there is one."""
    average_flip: bool = False
    """Predict every image and its mirror image top to bottom, and average both outputs."""
    progress: bool = True
    """Show the progress on stderr: a bar in a terminal, a line now and then elsewhere."""

    @property
    def predicts_probability(self) -> bool:
        """Whether the amplitude of a predicted phasor is the probability of an object pixel."""
        return self.target == "mask+depth"

    def for_images(self, width: int) -> TrainSettings:
        """These settings with the number for which a block of 0 stands, for images of so many pixels.

        It is 2 for 40 pixels and 4 for 80. It is at most 8, because a position knows the details of its
        pixels from few features.
        """
        return replace(self, block=self.block or 2 ** min(3, max(0, round(log2(width / 20)))))

    def __post_init__(self) -> None:
        if self.change_fraction > 0 and self.channel_noise_fraction != 1:
            raise ValueError(
                "change_fraction says how many images get channel noise: leave channel_noise_fraction at 1"
            )
        if self.copies_per_change > 0:
            if self.change_fraction > 0 or self.channel_noise_fraction != 1:
                raise ValueError(
                    "copies_per_change says how many images get each change: leave change_fraction at 0 and "
                    "channel_noise_fraction at 1, or set copies_per_change to 0 (the preset paper has 403; a "
                    "resumed run needs no preset)"
                )
            switches = (self.flip_rows, self.flip_columns, self.rotation_deg, self.translation)
            if not any((*switches, self.channel_noise_sigma)):
                raise ValueError("copies_per_change needs a change to make: switch one on, such as flip_rows")
        if self.frequencies_hz is not None and list(self.frequencies_hz) != sorted(set(self.frequencies_hz)):
            raise ValueError("frequencies_hz must ascend, each once")
        if self.least_reflectance < 1 and "residual" not in self.channels:
            raise ValueError("least_reflectance needs residual channels, which tell hidden from direct light")
        if self.sensor is not None and self.reference == "capture" and "residual" in self.channels:
            raise ValueError(
                "reference capture needs a capture with every scene, and sensor makes none: take reference "
                "self, with sensor_capture if predictions have one"
            )
        if self.sensor_capture and self.sensor is None:
            raise ValueError(
                "sensor_capture is a capture of the empty corner by the sensor: name one (--sensor)"
            )
        multiple = self.block * 2 ** (self.levels - 1)
        if multiple > MOST_MULTIPLE:
            raise ValueError(
                f"{self.levels} levels and blocks of {self.block} pixels enlarge images to multiples of "
                f"{multiple} pixels, more than {MOST_MULTIPLE}: take fewer levels or a smaller block"
            )
        if "wall" in self.channels and not self.reference.startswith("self"):
            raise ValueError(f"channels {self.channels} show the wall that a fit finds: take reference self")
        if self.bounce_images and "residual" not in self.channels:
            raise ValueError(
                f"bounce_images are made from residual channels, and channels are {self.channels}: set it to "
                "false (--no-bounce-images)"
            )
        if self.mask_gradient == "depth" and self.mask_from != "depth":
            raise ValueError("mask_gradient depth needs mask_from depth: or take mask_gradient amplitude")
        if self.target == "depth" and self.loss.endswith("+lovasz"):
            raise ValueError(f"loss {self.loss} needs an amplitude, which target depth has not: take mae+iou")
        if self.uncertainty and not self.predicts_probability:
            raise ValueError(
                "uncertainty is that of an object pixel's depth, which only target mask+depth has: set it to "
                "false (--no-uncertainty)"
            )
        if self.freeze == "all-but-uncertainty" and not self.uncertainty:
            raise ValueError("freeze all-but-uncertainty would train nothing: it needs uncertainty")
        if self.predicts_probability != (self.loss == "bce+iou+depth"):
            raise ValueError(
                f"target {self.target} does not go with loss {self.loss}: target mask+depth and loss "
                "bce+iou+depth go together; the presets known-wall and paper have target components"
            )


def training_fields() -> dict[str, FieldInfo]:
    """Type, bounds, default and description of every field of `TrainSettings`, by name."""
    fields: dict[str, FieldInfo] = TrainSettings.__pydantic_fields__  # type: ignore[attr-defined]
    return fields


def training_preset(name_or_file: PathLike) -> tuple[dict[str, Any], str]:
    """Settings of a TOML file or of one in data/training, and its path.

    A preset with the key ``extends`` begins with the settings of the preset it names, a file beside it or
    one of data/training. The key ``sensor`` names a camera of data/sensors, or a TOML file
    beside the preset, whose settings take its place.

    Raises
    ------
    PresetError : no such file, not TOML, presets that extend each other in a circle, or a camera that
        cannot be read.
    """
    layers: list[dict[str, Any]] = []
    origins: list[str] = []
    name: PathLike | None = name_or_file
    while name is not None:
        data, origin = _read_layer(name, origins)
        if origin in origins:
            raise PresetError(f"{' extends '.join([*origins, origin])}: a circle has no beginning")
        origins.append(origin)
        name = _extended(data.pop("extends", None), Path(origin))
        layers.append(data)
    settings = {key: value for layer in reversed(layers) for key, value in layer.items()}
    if isinstance(settings.get("sensor"), str):
        settings["sensor"] = asdict(_sensor_of(settings["sensor"], origins))
    return settings, origins[0]


def _sensor_of(name: str, origins: list[str]) -> SensorSettings:
    """The camera that a preset names: a file beside it or beside one that it extends, or in data/sensors."""
    try:
        for origin in origins:
            beside = inside(Path(origin).parent, name)
            if beside.is_file():
                return load_sensor(beside)
        return load_sensor(shipped_file("sensors", name))
    except (NightError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise PresetError(f"{origins[0]}, key sensor: {reason}") from None


def _read_layer(name: PathLike, origins: list[str]) -> tuple[dict[str, Any], str]:
    """Settings of one file, and its path; an error also names the file in `origins` that extends it."""
    try:
        return read_settings("training", name)
    except PresetError as error:
        if not origins:
            raise
        raise PresetError(f"{origins[-1]}, key extends: {error}") from None


def _extended(name: object, origin: Path) -> PathLike | None:
    """The preset that the file `origin` extends: a file beside it, or a name in data/training."""
    if name is None:
        return None
    try:
        beside = inside(origin.parent, str(name))
        return beside if beside.is_file() else shipped_file("training", str(name))
    except (NightError, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise PresetError(f"{origin}, key extends: {reason}") from None


def settings_from_dict(data: dict[str, Any], origin: str) -> TrainSettings:
    """Check plain data against the settings there are; `origin` names the file in the error.

    Raises
    ------
    PresetError : an unknown key, a wrong type or an impossible value, by name.
    """
    settings: TrainSettings = checked_data(TypeAdapter(TrainSettings), data, origin, PresetError)
    return settings
