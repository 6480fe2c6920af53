"""The interface of a rendering method: it exposes a Mitsuba scene and returns phasors or transient rows."""

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
    max_bounces : most surfaces that light may meet.
    seed : of the random numbers; equal seeds give equal results on the same device.
    accept_lost_light : whether transients may lack light that arrives outside the time axis.
    all_is_direct : whether the direct return is the whole signal, as in the mirrored scene. Then its errors
        count relative to it. Otherwise, they count relative to the hidden part that a scene would have.
    """

    layout: TransientLayout
    frequencies_hz: tuple[float, ...]
    max_bounces: int
    seed: int
    accept_lost_light: bool = False
    all_is_direct: bool = False


@dataclass(frozen=True)
class PhasorImage:
    """Phasors (H, W, F) of a measurement and of its parts, radiance in W m^-2 sr^-1.

    Attributes
    ----------
    total : sum of both parts.
    direct : one-bounce return of the surfaces that the camera sees.
    hidden : all light that met the hidden object.
    error : upper bound of the error of `hidden`, relative to `hidden`; it holds in 95 % of renders. None
        without a hidden object.
    """

    total: NDArray[np.complex128]
    direct: NDArray[np.complex128]
    hidden: NDArray[np.complex128]
    error: float | None


@dataclass(frozen=True)
class LitRows:
    """Time-resolved image rows, of the time bins that light may reach.

    Attributes
    ----------
    bins : these bins, of all T; at least one.
    blocks : rows from top to bottom, in blocks (rows, W, bins) of radiance per bin, W m^-2 sr^-1.
    """

    bins: range
    blocks: Iterator[NDArray[np.float32]]

    def of_all_bins(self, bin_count: int) -> Iterator[NDArray[np.float32]]:
        """The same rows with all T bins, (rows, W, T)."""
        for block in self.blocks:
            rows = np.zeros((*block.shape[:2], bin_count), np.float32)
            rows[..., self.bins.start : self.bins.stop] = block
            yield rows


class Exposure(Protocol):
    """A scene ready to be measured."""

    @property
    def attributes(self) -> dict[str, str]:
        """Provenance of the measurement for its files, text by name."""

    def phasors(self) -> PhasorImage | None:
        """Phasors at the frequencies of the view, without time bins; None if the method has only bins."""

    def lit_rows(self) -> LitRows:
        """Image rows with time bins."""


class Method(Protocol):
    """A rendering method; `render.transport.methods.METHODS` lists all of them."""

    @property
    def name(self) -> str:
        """Name of the method, as ``--method`` takes it."""

    @property
    def rough_wall(self) -> str:
        """Plugin for the material of a rough relay wall: ``roughplastic``, or one that is equal to it."""

    def expose(self, scene: mi.Scene, view: View) -> Exposure:
        """Prepare the measurement of a scene."""
