"""What a rendering method is: it exposes a Mitsuba scene and gives phasors or time-resolved rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from itof import TransientLayout

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class View:
    """One measurement of a scene.

    Attributes
    ----------
    layout : image size and time axis (optical path length).
    frequencies_hz : modulation frequencies, Hz, F of them.
    max_bounces : how many surfaces light may meet.
    seed : random stream of this measurement; same seed, same numbers on the same device.
    """

    layout: TransientLayout
    frequencies_hz: tuple[float, ...]
    max_bounces: int
    seed: int


@dataclass(frozen=True)
class PhasorImage:
    """Phasors (H, W, F) of a measurement, and its parts.

    Attributes
    ----------
    total : direct and hidden together.
    direct : one-bounce return of what the camera sees.
    hidden : everything that met the hidden object.
    error : estimated error of `hidden` relative to it; None when there is none to speak of.
    """

    total: NDArray[np.complex128]
    direct: NDArray[np.complex128]
    hidden: NDArray[np.complex128]
    error: float | None


class Exposure(Protocol):
    """A scene ready to be measured."""

    @property
    def attributes(self) -> dict[str, str]:
        """Provenance for the files made of it, text by name."""

    def phasors(self) -> PhasorImage | None:
        """Exact phasors at the view's frequencies, or None where the method knows only bins."""

    def row_blocks(self) -> Iterator[NDArray[np.float32]]:
        """Image rows from top to bottom in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1."""


class Method(Protocol):
    """A way to render; `render.transport.methods.METHODS` lists them."""

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""

    def expose(self, scene: mi.Scene, view: View) -> Exposure:
        """Prepare the measurement of a scene."""
