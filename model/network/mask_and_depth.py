"""A network output of two images, what shows the object and how far it is: how it is read."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from itof import unambiguous_range_m
from model.network.readout import Readout, straight_through
from model.settings.target import MaskAndDepthTarget, Target

LARGEST_LOG_ERROR = 10.0


@dataclass(frozen=True)
class MaskAndDepth(Readout):
    """Mask and depth of (N, 2, H, W) outputs: the logit of an object pixel, and its standardised depth.

    A third channel, where the network has it, is the logarithm of the expected error of that depth.

    Unlike Re and Im, the depth does not wrap, has no small values where the mask is unsure, and is only
    trained where there is an object. The phasor of the mirrored scene follows from both: its amplitude is the
    probability of an object pixel, its phase that of the depth.

    Attributes
    ----------
    depth_mean_m, depth_spread_m : the depth is mean + spread · output, metres: mean and standard deviation of
        the object's radial depth over the training scenes.
    mask_threshold : a pixel shows the object if its probability is at least this.
    has_uncertainty : the output has the third channel.

    Source: ours.
    """

    dead_zone: float = 0.0
    target: Target = MaskAndDepthTarget.kind
    depth_mean_m: float = 0.0
    depth_spread_m: float = 1.0
    has_uncertainty: bool = False

    @property
    def of_phasors(self) -> Readout:
        """Reads what `components` has made of an output."""
        return Readout(self.frequency_hz, self.mask_threshold, 0.0, self.mask_from, self.mask_depth_m)

    def components(self, output: Tensor) -> Tensor:
        """(N, 2, H, W) Re and Im of the mirrored scene."""
        phase = self._depth_of_output_m(output) / self.metres_per_radian  # (N, H, W)
        return self.presence(output)[:, None] * torch.stack([phase.cos(), phase.sin()], dim=1)

    def mask(self, output: Tensor) -> Tensor:
        """(N, H, W) float mask, 0 or 1, with the gradient of the probability."""
        probability = self.presence(output)
        return straight_through((probability >= self.mask_threshold).to(output.dtype), probability)

    def presence(self, output: Tensor) -> Tensor:
        """(N, H, W) probability that a pixel shows the object."""
        return output[:, 0].sigmoid()

    def radial_depth_m(self, output: Tensor) -> Tensor:
        """(N, H, W) radial depth, metres, 0 outside the mask."""
        return self.mask(output) * self._depth_of_output_m(output)

    def depth_error_m(self, output: Tensor) -> Tensor | None:
        """(N, H, W) expected absolute error of the depth of an object pixel, metres, at most the range of
        depths; None without a third channel.
        """
        if not self.has_uncertainty:
            return None
        return (self.depth_spread_m * log_error(output).exp()).clamp(max=self._farthest_m)

    @property
    def _farthest_m(self) -> float:
        return float(unambiguous_range_m(self.frequency_hz))

    def standardised(self, radial_depth_m: Tensor) -> Tensor:
        """The output that stands for this depth, metres."""
        return (radial_depth_m - self.depth_mean_m) / self.depth_spread_m

    def _depth_of_output_m(self, output: Tensor) -> Tensor:
        """(N, H, W) depth of every pixel, metres, within the range that the phasor can express."""
        farthest_m = self._farthest_m * (1 - 1e-6)
        return (self.depth_mean_m + self.depth_spread_m * output[:, 1]).clamp(0.0, farthest_m)


def log_error(output: Tensor) -> Tensor:
    """(N, H, W) logarithm of the expected error of the standardised depth, within bounds."""
    return output[:, 2].clamp(-LARGEST_LOG_ERROR, LARGEST_LOG_ERROR)
