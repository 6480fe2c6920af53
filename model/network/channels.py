"""What the network is fed: which channels, scaled by which constants of the training set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from array_api_compat import array_namespace, device, is_array_api_obj
from pydantic import Field
from pydantic.dataclasses import dataclass

from itof import network_channels, residual_channels
from model.settings import Channels
from scenegen.contract import STRICT, Positive


@dataclass(frozen=True, config=STRICT)
class InputSpec:
    """How phasors become network channels; fitted once, kept with the run.

    ``paper`` is [A_0 / scale, Re_f / A_0, Im_f / A_0]: seven channels with three frequencies. ``residual``
    is what is left when the known phase of the wall's direct return is turned back (five channels with
    three frequencies), each divided by its standard deviation over the training scenes: it lifts the
    hidden 0.1-0.3 % to unit variance, without which a network learns little (docs/design.md, Input channels).

    Attributes
    ----------
    channels : which of the two sets, or both, paper first.
    frequencies_hz : F modulation frequencies that the network sees, Hz; A_0 belongs to the first.
    amplitude_scale : mean amplitude at the first frequency over the training scenes, in the phasors' unit.
    residual_scale : 2F - 1 standard deviations, without unit; empty when `channels` has no residual.

    Raises
    ------
    ValueError : a number of residual scales that does not fit.
    """

    channels: Channels
    frequencies_hz: Annotated[tuple[Positive, ...], Field(min_length=1)]
    amplitude_scale: Positive
    residual_scale: tuple[Positive, ...]

    def __post_init__(self) -> None:
        expected = self._residual_count if self.uses_residual else 0
        if len(self.residual_scale) != expected:
            raise ValueError(
                f"channels {self.channels} at {len(self.frequencies_hz)} frequencies need {expected} "
                f"residual scales, got {len(self.residual_scale)}"
            )

    @property
    def uses_residual(self) -> bool:
        """Whether the direct return is needed."""
        return "residual" in self.channels

    @property
    def channel_count(self) -> int:
        """C, the network's input channels."""
        return (self._paper_count if "paper" in self.channels else 0) + len(self.residual_scale)

    @property
    def _paper_count(self) -> int:
        return 1 + 2 * len(self.frequencies_hz)  # A_0, and two components a frequency

    @property
    def _residual_count(self) -> int:
        return 2 * len(self.frequencies_hz) - 1  # two components a frequency, less Re r_0

    def places(self, available_hz: Sequence[float]) -> list[int]:
        """Where the frequencies stand among those of a measurement.

        Raises
        ------
        ValueError : one of them was not measured.
        """
        missing = [f for f in self.frequencies_hz if f not in available_hz]
        if missing:
            raise ValueError(f"{_megahertz(missing)} MHz is not among {_megahertz(available_hz)} MHz")
        return [list(available_hz).index(f) for f in self.frequencies_hz]

    def apply(self, phasor: Any, reference: Any = None) -> Any:
        """Network channels (..., C, H, W) of phasors (..., H, W, F), of the same library and device.

        Parameters
        ----------
        phasor : array of numpy, torch or another library of the array API, at `frequencies_hz`.
        reference : (H, W, F) direct return of the bare relay wall; needed by the residual channels alone.

        Raises
        ------
        ValueError : another number of frequencies, or no reference where one is needed.
        """
        z = phasor if is_array_api_obj(phasor) else np.asarray(phasor)
        if z.shape[-1] != len(self.frequencies_hz):
            raise ValueError(f"expected phasors at {len(self.frequencies_hz)} frequencies, got {z.shape[-1]}")
        xp = array_namespace(z)
        parts = []
        if "paper" in self.channels:
            parts.append(network_channels(z, self.amplitude_scale))
        if self.uses_residual:
            if reference is None:
                raise ValueError(f"channels {self.channels} need the relay wall's direct return as reference")
            residual = residual_channels(z, reference)
            scale = xp.asarray(self.residual_scale, dtype=xp.float32, device=device(z))
            parts.append(residual / scale[:, None, None])  # (2F - 1, 1, 1)
        return xp.concat(parts, axis=-3)


def _megahertz(frequencies_hz: Sequence[float]) -> str:
    return ", ".join(f"{f / 1e6:g}" for f in frequencies_hz)
