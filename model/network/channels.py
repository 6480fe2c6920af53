"""Input channels of the network, and the constants that scale them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Final

import numpy as np
from array_api_compat import array_namespace, device, is_array_api_obj
from pydantic import Field
from pydantic.dataclasses import dataclass

from disk import NightError
from disk.contract import STRICT
from disk.frequency_text import megahertz
from disk.quantities import Frequency, Positive
from itof import SubpixelWeights, network_channels, residual_channels, weighted_reference
from itof.frequency_images import Slopes
from itof.wall.expected_wall import ExpectedWall
from itof.wall.self_calibration import calibrate
from itof.wall.turned_axes import turned_rays
from itof.wall.turned_reference import brightness_of_wall
from itof.wall.wall_fit import WallFit
from model.settings.input import Channels, Reference

RAYS: Final = 3  # channels of the rays, the last ones: right, down, forward
# Images whose references are found at once, which takes many times the memory of their phasors.
IMAGES_AT_ONCE: Final = 16


class ChannelError(NightError):
    """Input channels that a dataset cannot give."""


@dataclass(frozen=True, config=STRICT)
class InputSpec:
    """Converts phasors to input channels; its constants are fitted once and stored with the run.

    ``paper``: [A_0 / scale, Re_f / A_0, Im_f / A_0], seven channels for three frequencies. A_0 is the
    amplitude at the first frequency.

    ``residual``: the channels of `itof.residual_channels`, five for three frequencies. They divide the
    phasors by the direct return of the relay wall and keep the differences. Each channel is divided by its
    standard deviation over the training scenes. This gives the hidden light, 0.2 % of the signal, unit
    variance; without it a network learns slowly (docs/science/design.md, Input channels).

    ``residual+wall``: one more, the inverse distance of the wall along the ray of each pixel, as the fit of
    ``self`` finds it, less its mean and over its standard deviation over the training scenes. With it the
    network knows the corner, which may be another one in every image. The residual channels are 0 in pixels
    that show something else than the wall, or its edge, because the camera of some corners sees the middle
    wall.

    ``residual+wall+rays``: three more, the rays of the pixels in axes that depend on the wall, in which most
    corners look alike (`itof.wall.turned_axes`). Such a network sees images of several sizes.

    Attributes
    ----------
    channels : one of these sets, or the first two, paper first.
    frequencies_hz : F modulation frequencies of the input, Hz.
    amplitude_scale : what the amplitude channel is divided by, in the unit of the phasors: mean or maximum of
        A_0 over the training scenes.
    residual_scale : 2F - 1 standard deviations, dimensionless; empty if `channels` has no residual.
    subpixel_weights : how `itof.residual_channels` weights the paths within a pixel. ``uniform`` in runs of
        version 0.1, whose ``run.json`` has no such key: they see what they were trained with.
    reference : where the direct return of the residual channels comes from (`reference_for`).
    wall_scale_per_m : mean and standard deviation of the inverse distance of the wall, 1/m; None without it.
    largest_shift_m : with the channel of the wall: the largest mean shift of a wall among the scenes that
        scale the channels, metres along the rays.
    training_mean_amplitude : mean A_0 of the training scenes; None if `amplitude_scale` is the mean.
    wall_alone : as for `itof.residual_channels`. False in runs whose ``run.json`` has no such key.

    Raises
    ------
    ValueError : the number of residual scales does not fit `channels` and `frequencies_hz`; or the channel
        of the wall lacks its scale or a fit.

    Source: ``paper`` from Caligiuri et al. 2024, sec. 4.2; ``residual`` is ours.
    """

    channels: Channels
    frequencies_hz: Annotated[tuple[Frequency, ...], Field(min_length=1)]
    amplitude_scale: Positive
    residual_scale: tuple[Positive, ...]
    subpixel_weights: Annotated[SubpixelWeights, Field(exclude_if=lambda value: value == "uniform")] = (
        "uniform"
    )
    reference: Annotated[Reference, Field(exclude_if=lambda value: value == "geometry")] = "geometry"
    wall_scale_per_m: Annotated[
        tuple[Positive, Positive] | None, Field(exclude_if=lambda value: value is None)
    ] = None
    largest_shift_m: Annotated[float, Field(ge=0, exclude_if=lambda value: value == 0)] = 0.0
    training_mean_amplitude: Annotated[Positive | None, Field(exclude_if=lambda value: value is None)] = None
    wall_alone: Annotated[bool, Field(exclude_if=lambda value: not value)] = False

    def __post_init__(self) -> None:
        expected = self._residual_count if self.uses_residual else 0
        if len(self.residual_scale) != expected:
            raise ValueError(
                f"channels {self.channels} at {len(self.frequencies_hz)} frequencies need {expected} "
                f"residual scales, got {len(self.residual_scale)}"
            )

        if self.shows_wall and not (self.wall_scale_per_m and self.self_calibrates):
            raise ValueError(f"channels {self.channels} need wall_scale_per_m and the reference self")

    @property
    def mean_amplitude(self) -> float:
        """Mean A_0 of the training scenes, in the unit of the phasors."""
        return self.training_mean_amplitude or self.amplitude_scale

    @property
    def uses_residual(self) -> bool:
        """Whether `apply` needs the direct return."""
        return "residual" in self.channels

    @property
    def shows_wall(self) -> bool:
        """Whether there is the channel of the wall."""
        return "wall" in self.channels

    @property
    def shows_rays(self) -> bool:
        """Whether there are the channels of the rays."""
        return "rays" in self.channels

    @property
    def self_calibrates(self) -> bool:
        """Whether `reference_for` moves the direct return to the wall that each image shows."""
        return self.uses_residual and self.reference in ("self", "self+wiggling")

    @property
    def needs_capture(self) -> bool:
        """Whether a prediction needs a capture of the empty corner."""
        return self.uses_residual and self.reference == "capture"

    @property
    def channel_count(self) -> int:
        """C, the number of input channels."""
        paper = self._paper_count if "paper" in self.channels else 0
        return paper + len(self.residual_scale) + self.shows_wall + RAYS * self.shows_rays

    @property
    def residual_channels(self) -> tuple[int, int]:
        """Number of the first residual channel, and how many there are."""
        return (self._paper_count if "paper" in self.channels else 0), len(self.residual_scale)

    @property
    def reference_count(self) -> int:
        """Values of a pixel in a reference of `reference_for`; 0 if `apply` needs none."""
        return len(self.frequencies_hz) + self.shows_wall + self.shows_rays if self.uses_residual else 0

    @property
    def _paper_count(self) -> int:
        return 1 + 2 * len(self.frequencies_hz)

    @property
    def _residual_count(self) -> int:
        return 2 * len(self.frequencies_hz) - 1

    def places(self, available_hz: Sequence[float]) -> list[int]:
        """Indices of `frequencies_hz` in the frequencies of a measurement.

        Raises
        ------
        ChannelError : a frequency was not measured.
        """
        missing = [f for f in self.frequencies_hz if f not in available_hz]
        if missing:
            raise ChannelError(f"{megahertz(*missing)} is not among {megahertz(*available_hz)}")
        return [list(available_hz).index(f) for f in self.frequencies_hz]

    def fit_of(self, phasor: Any, wall: ExpectedWall, weights: Slopes | None = None) -> WallFit:
        """The wall and phases that these phasors (..., H, W, F) show; only where `self_calibrates`.

        `weights` is their `brightness_of_wall`, if it is known.
        """
        return calibrate(phasor, wall, wiggling=self.reference == "self+wiggling", weights=weights)

    def reference_for(self, phasor: Any, wall: ExpectedWall, *, is_weighted: bool = False) -> Any:
        """The reference that `apply` needs for these phasors (..., H, W, F).

        The direct return of the wall, (H, W, F). With ``self`` and ``self+wiggling`` it is moved to the wall
        and phases that each image shows (`itof.wall.self_calibration`), (..., H, W, F). With the channel of
        the wall its inverse distance, 1/m, follows, (..., H, W, F + 1). With the rays, the imaginary part of
        that is the forward part of the pixel's ray, and one more value has its parts to the right (real) and
        down (imaginary), (..., H, W, F + 2).

        Parameters
        ----------
        is_weighted : it has the weights that the amplitudes of the phasors give it, (..., H, W, F to F + 2),
            for `apply` with ``is_weighted``. Noise of relative size σ in the amplitudes changes its phase by
            less than σ / 40 (`itof.weighted_reference`).
        """
        is_weighted = is_weighted and self.subpixel_weights == "measured"
        if not self.self_calibrates:
            xp = array_namespace(phasor)
            return weighted_reference(wall.direct, xp.abs(phasor[..., 0])) if is_weighted else wall.direct
        weights = brightness_of_wall(phasor, wall)
        fit = self.fit_of(phasor, wall, weights)
        direct = fit.moved(phasor, wall, weights if is_weighted else None)
        if not self.shows_wall:
            return direct
        xp = array_namespace(direct)
        inverse = xp.astype(fit.inverse_distance_per_m(wall), direct.dtype)
        rest = [inverse]
        if self.shows_rays:
            right, down, forward = xp.unstack(turned_rays(fit.plane_per_m, wall.rays_by_axis), axis=-3)
            rest = [inverse + 1j * forward, right + 1j * down]
        return xp.concat([direct, xp.astype(xp.stack(rest, axis=-1), direct.dtype)], axis=-1)

    def reference_of_image(self, phasor: Any, wall: ExpectedWall) -> Any:
        """`reference_for` with the weights of the amplitudes, if the run has them."""
        return self.reference_for(phasor, wall, is_weighted=True)

    def parted(self, reference: Any) -> tuple[Any, Any]:
        """The direct return (..., H, W, F) in a reference, and the rest, which is empty without a wall."""
        count = len(self.frequencies_hz)
        return reference[..., :count], reference[..., count:]

    def apply(self, phasor: Any, reference: Any = None, *, is_weighted: bool = False) -> Any:
        """Input channels (..., C, H, W) of phasors (..., H, W, F).

        Parameters
        ----------
        phasor : (..., H, W, F) complex at `frequencies_hz`, from numpy, torch or another library of the
            array API. The channels are an array of the same library on the same device.
        reference : (H, W, F) complex direct return of the relay wall, or one for each image, as
            `reference_for` gives it; only the residual channels need it.
        is_weighted : the reference is that of `reference_of_image`.

        Raises
        ------
        ValueError : the number of frequencies differs, or the reference is missing.
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
            direct, rest = self.parted(reference)
            weights = "uniform" if is_weighted else self.subpixel_weights
            residual = residual_channels(z, direct, weights, wall_alone=self.wall_alone)
            scale = xp.asarray(self.residual_scale, dtype=xp.float32, device=device(z))
            parts.append(residual / scale[:, None, None])  # (2F - 1, 1, 1)
            if self.wall_scale_per_m:
                mean, spread = self.wall_scale_per_m
                wall = xp.astype((xp.real(rest[..., 0]) - mean) / spread, xp.float32)  # (..., H, W)
                parts.append(wall[..., None, :, :])
            if self.shows_rays:
                ray = [xp.real(rest[..., 1]), xp.imag(rest[..., 1]), xp.imag(rest[..., 0])]
                parts.append(xp.astype(xp.stack(ray, axis=-3), xp.float32))
        return xp.concat(parts, axis=-3)
