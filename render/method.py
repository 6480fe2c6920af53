"""What a rendering method is: it turns a Mitsuba scene into rows of time-resolved pixels."""

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
    max_bounces : how many surfaces light may meet.
    seed : random stream of this measurement; same seed, same numbers on the same device.
    """

    layout: TransientLayout
    max_bounces: int
    seed: int


class Method(Protocol):
    """A way to render; `render.methods.METHODS` lists them."""

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""

    def row_blocks(self, scene: mi.Scene, view: View) -> Iterator[NDArray[np.float32]]:
        """Image rows from top to bottom in blocks (rows, W, T) of radiance per bin, W m^-2 sr^-1."""
