"""How a training runs: scenes, epochs, machine."""

from __future__ import annotations

from typing import Literal

from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED
from disk.quantities import Minutes, NotNegative, RelativeError, Seed, WholeCount

GroundTruth = Literal["geometry", "simulated"]
DeviceName = Literal["auto", "cpu", "cuda"]
Precision = Literal["auto", "float32", "bfloat16", "float16"]


@dataclass(frozen=True, config=DOCUMENTED)
class RunSettings:
    """Scenes, epochs and machine."""

    max_epochs: WholeCount = 40
    """Training ends after so many epochs at the latest."""
    patience: WholeCount = 40
    """Training ends after so many epochs without a better validation loss."""
    min_delta: NotNegative = 0.0
    """For patience, a validation loss is better only if it is lower by more than this."""
    train_scenes: WholeCount | None = None
    """Train on the first so many training scenes only, for learning curves; by default on all."""
    epoch_scenes: WholeCount = 8192
    """With --fresh: scenes between two validations."""
    fresh_error: RelativeError = 0.04
    """With --fresh: error of the hidden light of the scenes, relative to it."""
    workers: WholeCount = 1
    """With --fresh: processes that render scenes, of each training process."""
    ground_truth: GroundTruth = "geometry"
    """Truth from the shape of the mirrored object, or from the simulator's transient of the mirrored scene,
    as in the paper; simulated needs transients."""
    average_flip: bool = True
    """Predict every image and its mirror image top to bottom, and average both outputs."""
    seed: Seed = 0
    """Seed of the weights, of the order of scenes and of the augmentation."""
    precision: Precision = "auto"
    """Number type of the convolutions; auto: bfloat16 where the processor computes in it."""
    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU if there is one."""
    checkpoint_minutes: Minutes = 10.0
    """Minutes between two checkpoints; 0: one after every batch."""
    progress: bool = True
    """Show the progress on stderr: a bar in a terminal, a line now and then elsewhere."""
