"""What the network sees: its input channels."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from disk.contract import DOCUMENTED
from disk.quantities import Frequency

Channels = Literal["paper", "residual", "paper+residual", "residual+wall", "residual+wall+rays"]
AmplitudeDivisor = Literal["mean", "maximum"]
_SEEN_WIDTH: Final = 40  # pixels
Reference = Literal["geometry", "capture", "self", "self+wiggling"]


def averaged_over(width: int) -> int:
    """Side of the blocks, pixels, whose means a network that knows rays sees of images of so many pixels."""
    return max(1, width // _SEEN_WIDTH)


@dataclass(frozen=True, config=DOCUMENTED)
class PaperChannels:
    """The paper's channels: the amplitude, and Re and Im over the amplitude at each frequency."""

    kind: Literal["paper"] = "paper"
    """With these channels alone, the network learns slowly (notebook/results.md)."""
    amplitude_divisor: AmplitudeDivisor = "mean"
    """The amplitude channel is divided by this amplitude of the training scenes; the paper: to [0, 1]."""


@dataclass(frozen=True, config=DOCUMENTED)
class ResidualChannels:
    """The hidden light: phasors over the direct return of the wall, and their differences."""

    kind: Literal["residual"] = "residual"
    """Phasors over the direct return of the wall."""
    reference: Reference = "self"
    """Where the direct return of the residual channels comes from. geometry: computed from camera and wall.
    capture: a capture of the empty corner, which predictions then need. self: computed for the wall and
    phases that each measurement shows. self+wiggling: the same with the four-cycle error of a square-wave
    camera."""
    bounce_images: bool = True
    """The network also sees images of the hidden scene, which a linear inverse of the three bounces makes
    from these channels. For datasets of one corner."""


@dataclass(frozen=True, config=DOCUMENTED)
class PaperAndResidualChannels:
    """Both kinds of channels, the paper's first."""

    kind: Literal["paper+residual"] = "paper+residual"
    """The paper's channels, then the residual ones."""
    amplitude_divisor: AmplitudeDivisor = "mean"
    """As for the channels paper."""
    reference: Reference = "self"
    """As for the channels residual."""
    bounce_images: bool = True
    """As for the channels residual."""


@dataclass(frozen=True, config=DOCUMENTED)
class WallChannels:
    """The residual channels, and one that says where the wall of each image is. For many corners."""

    kind: Literal["residual+wall"] = "residual+wall"
    """The residual channels, then the inverse distance of the wall."""
    reference: Literal["self", "self+wiggling"] = "self"
    """As for the channels residual; the wall is the one that each measurement shows."""


@dataclass(frozen=True, config=DOCUMENTED)
class RayChannels:
    """The channels residual+wall, and the rays of the pixels in axes of the wall. For many corners."""

    kind: Literal["residual+wall+rays"] = "residual+wall+rays"
    """Also for images of several times the training's size, of which it sees means."""
    reference: Literal["self", "self+wiggling"] = "self"
    """As for the channels residual+wall."""


@dataclass(frozen=True, config=DOCUMENTED)
class InputSettings:
    """What the network sees."""

    channels: Annotated[
        PaperChannels | ResidualChannels | PaperAndResidualChannels | WallChannels | RayChannels,
        Field(discriminator="kind"),
    ] = ResidualChannels()
    """Set of input channels."""
    frequencies_hz: Annotated[tuple[Frequency, ...], Field(min_length=1)] | None = None
    """Modulation frequencies that the network sees; by default all of the dataset's."""

    def __post_init__(self) -> None:
        if self.frequencies_hz is not None and list(self.frequencies_hz) != sorted(set(self.frequencies_hz)):
            raise ValueError("frequencies_hz must ascend, each once")

    @property
    def reference(self) -> Reference:
        """Where the direct return comes from; it does not matter without residual channels."""
        return "geometry" if isinstance(self.channels, PaperChannels) else self.channels.reference

    @property
    def amplitude_divisor(self) -> AmplitudeDivisor:
        """What the amplitude channel is divided by; it does not matter without the paper's channels."""
        if isinstance(self.channels, PaperChannels | PaperAndResidualChannels):
            return self.channels.amplitude_divisor
        return "mean"

    @property
    def bounce_images(self) -> bool:
        """Whether the network sees images of the three bounces."""
        if isinstance(self.channels, ResidualChannels | PaperAndResidualChannels):
            return self.channels.bounce_images
        return False
