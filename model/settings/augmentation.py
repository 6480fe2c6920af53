"""Random changes of the training images."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED
from disk.quantities import Fraction, HalfTurn, NotNegative
from itof.sensor.settings import SensorSettings


@dataclass(frozen=True, config=DOCUMENTED)
class PaperChanges:
    """The changes of the paper that are no symmetries of a corner; half of a turn, shift or flip is none."""

    flip_columns: bool = False
    """Flip half of the images left to right."""
    rotation_deg: HalfTurn = 0.0
    """Turn images at random by up to so many degrees."""
    translation: Fraction = 0.0
    """Shift images at random by up to this fraction of their size."""
    channel_noise_sigma: NotNegative = 0.0
    """Noise on each normalised input channel. The paper has noise of 1; the released code adds it here."""
    copies_per_change: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Enlarge the training set once: so many changed copies of scenes for each change that is switched on, of
    flips (flip_rows too), rotation, shift and channel noise. An epoch has the scenes without these changes,
    and all copies. 0: change every image anew."""


@dataclass(frozen=True, config=DOCUMENTED)
class CameraSettings:
    """A camera that measures the training images."""

    sensor: SensorSettings
    """Measure every image with a camera like this one: a name in data/sensors, or a .toml file. In a preset
    it may be a table. Each image is measured by another camera of this type, with its own noise;
    amplitude_spread is the exposure's."""
    empty_corner: bool = False
    """Divide by what the camera makes of the empty corner, for predictions that have such a capture."""


@dataclass(frozen=True, config=DOCUMENTED)
class AugmentationSettings:
    """Random changes of the training images."""

    flip_rows: bool = True
    """Flip half of the images top to bottom: an exact symmetry of the scene."""
    amplitude_spread: NotNegative = 0.0
    """Change the exposure at random by a factor of up to 1 + this."""
    noise_sigma: NotNegative = 1e-4
    """Noise on each component, as a fraction of the amplitude at the first frequency."""
    largest_noise_sigma: NotNegative = 0.0
    """Each image has its own noise between noise_sigma and this, evenly in the logarithm; 0: noise_sigma."""
    camera: CameraSettings | None = None
    """Measure every image with a camera."""
    paper: PaperChanges | None = None
    """The paper's changes."""

    def __post_init__(self) -> None:
        least, most = self.noise_sigma, self.largest_noise_sigma
        if most and not 0 < least <= most:
            raise ValueError(
                f"augmentation.largest_noise_sigma is the upper end of a range that begins with noise_sigma "
                f"above 0: got {least:g} to {most:g}"
            )
