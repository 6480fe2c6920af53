"""Reading a network output: object mask and radial depth, with gradients through the thresholds."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from itof import depth_from_phase, unambiguous_range_m
from model.settings import TrainSettings


@dataclass(frozen=True)
class Readout:
    """Mask and depth of (N, 2, H, W) outputs (Re and Im of the mirrored scene).

    A step function has no useful gradient. Each one here is *straight-through*: its value is exact, and its
    gradient is that of the identity.

    Attributes
    ----------
    frequency_hz : modulation frequency of the output, Hz; the first of the dataset.
    mask_threshold : a pixel shows the object if its amplitude is at least this. The ground truth has the
        amplitudes 0 and 1; 0.5 is halfway.
    dead_zone : components of smaller magnitude become 0 before mask and depth are computed. 0.05 in the
        released code: this moves phases within 0.05 rad of an axis onto that axis, up to 6 cm at 20 MHz. 0
        switches it off.

    Source: Bengio et al., "Estimating or propagating gradients through stochastic neurons", 2013.
    """

    frequency_hz: float
    mask_threshold: float = TrainSettings.mask_threshold
    dead_zone: float = TrainSettings.dead_zone

    @property
    def metres_per_radian(self) -> float:
        """Radial depth per radian of phase, metres."""
        return float(depth_from_phase(1.0, self.frequency_hz))

    def components(self, output: Tensor) -> Tensor:
        """(N, 2, H, W) output with the components inside the dead zone set to 0; straight-through."""
        zeroed = torch.where(output.abs() < self.dead_zone, 0.0, output)
        return _straight_through(zeroed, output)

    def mask(self, output: Tensor) -> Tensor:
        """(N, H, W) float mask, 0 or 1. Its gradient is that of the output's amplitude, clipped to [0, 1].

        The gradient of the amplitude is the direction of the output. At amplitude 0 the direction is
        undefined (any one is a subgradient); the diagonal is used, so that an output of 0 everywhere can
        still grow. Clipping is necessary: beyond amplitude 1 the mask does not change, but the gradient of
        an unclipped amplitude is about ten times that of the mean absolute error on every object pixel and
        drives amplitudes to 1e17.
        """
        hard = (self.components(output).norm(dim=1) >= self.mask_threshold).to(output.dtype)  # (N, H, W)
        size = output.detach().norm(dim=1, keepdim=True)  # (N, 1, H, W)
        diagonal = torch.full_like(output, 0.5**0.5)
        direction = torch.where(size > 0, output.detach() / size.clamp_min(1e-30), diagonal)
        return _straight_through(hard, (direction * output).sum(dim=1).clamp(0, 1))

    def radial_depth_m(self, output: Tensor) -> Tensor:
        """(N, H, W) radial depth, metres: c φ / (4π f) with φ in [0, 2π) on the mask, 0 elsewhere.

        The phase receives gradients on the mask only, the mask everywhere.
        """
        mask = self.mask(output)  # (N, H, W)
        z = self.components(output)
        # Outside the mask the phase is not differentiated: near amplitude 0 its gradient diverges.
        z = torch.where((mask.detach() > 0)[:, None], z, z.detach())
        wrapped = torch.atan2(z[:, 1], z[:, 0])
        turn_m = float(unambiguous_range_m(self.frequency_hz))  # depth for a phase of 2π
        depth_m = wrapped * self.metres_per_radian  # (N, H, W), in (-range / 2, range / 2]
        return mask * torch.where(depth_m < 0, depth_m + turn_m, depth_m)


def _straight_through(forward: Tensor, backward: Tensor) -> Tensor:
    """The value of `forward` with the gradient of `backward`."""
    return forward.detach() + (backward - backward.detach())
