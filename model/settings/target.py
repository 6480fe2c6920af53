"""What the network predicts, how that is read, and the loss that goes with it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED
from disk.quantities import Distance, NotNegative, Positive

Target = Literal["components", "depth", "mask+depth"]
LossName = Literal["mae", "mse", "mae+iou", "mse+iou", "mae+lovasz"]
LossTarget = Literal["components", "depth"]
Balance = Literal["image", "dataset", "class-means"]
MaskSource = Literal["amplitude", "depth"]
MaskGradient = Literal["amplitude", "depth"]


@dataclass(frozen=True, config=DOCUMENTED)
class ComponentsTarget:
    """The paper's output: Re and Im of the mirrored scene."""

    kind: Literal["components"] = "components"
    """Re and Im of the mirrored scene."""
    loss: LossName = "mae+iou"
    """Terms of the loss: error of the output (mae or mse), and overlap of the masks (iou or lovasz)."""
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
    mask_depth_m: Distance = 0.0
    """With mask_from depth: radial depth in metres above which a pixel shows the object."""
    dead_zone: NotNegative = 0.05
    """Components of the output below this become 0 before mask and depth are taken."""

    def __post_init__(self) -> None:
        if self.mask_gradient == "depth" and self.mask_from != "depth":
            raise ValueError("mask_gradient depth needs mask_from depth: or take mask_gradient amplitude")


@dataclass(frozen=True, config=DOCUMENTED)
class DepthTarget:
    """A baseline of the paper: the depth of the mirrored scene in metres, directly."""

    kind: Literal["depth"] = "depth"
    """Radial depth in metres; error and mask are those of this depth."""
    loss: Literal["mae", "mse", "mae+iou", "mse+iou"] = "mae+iou"
    """Terms of the loss, as for the target components; there is no amplitude for lovasz."""
    alpha: NotNegative = 1 / 7
    """As for the target components."""
    balance: Balance = "image"
    """As for the target components."""
    mask_depth_m: Distance = 0.0
    """Radial depth in metres above which a pixel shows the object."""
    dead_zone: NotNegative = 0.05
    """Depths below so many metres become 0."""


@dataclass(frozen=True, config=DOCUMENTED)
class MaskAndDepthTarget:
    """Our output: the probability that a pixel shows the object, its depth, and the error of that.

    Its loss is the cross entropy and the overlap of the mask, and the error of the depth.
    """

    kind: Literal["mask+depth"] = "mask+depth"
    """Probability and depth of an object pixel."""
    smooth_l1_beta: NotNegative = 0.1
    """The error of the depth counts squared up to this many standard deviations of the objects' depth (about
    20 cm each), and linearly above."""
    uncertainty: bool = True
    """A second head predicts the error of the depth; it changes nothing else."""
    mask_threshold: Positive = 0.5
    """Probability from which on a pixel shows the object."""


TargetSettings = Annotated[ComponentsTarget | DepthTarget | MaskAndDepthTarget, Field(discriminator="kind")]
