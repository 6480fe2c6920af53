"""What a network output says: object mask and radial depth, with gradients through the hard decisions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from itof import depth_from_phase, unambiguous_range_m
from model.settings import TrainSettings


@dataclass(frozen=True)
class Readout:
    """From (N, 2, H, W) outputs (Re, Im of the mirrored scene) to mask and depth.

    A step has no useful gradient, so each is *straight-through*: exact forward, and backward as if the
    step were the identity (Bengio et al., "Estimating or propagating gradients through stochastic
    neurons", 2013).

    Attributes
    ----------
    frequency_hz : modulation frequency of the output, the first of the dataset, Hz.
    mask_threshold : amplitude from which on a pixel shows the object. The truth has amplitude 0 or 1; 0.5
        is as far from both.
    dead_zone : a component smaller than this becomes 0 before mask and depth are taken. The paper uses
        0.05; it snaps phases within 0.05 rad of an axis onto it, up to 6 cm at 20 MHz. 0 switches it off.
    """

    frequency_hz: float
    mask_threshold: float = TrainSettings.mask_threshold
    dead_zone: float = TrainSettings.dead_zone

    @property
    def metres_per_radian(self) -> float:
        """Radial depth per radian of phase."""
        return float(depth_from_phase(1.0, self.frequency_hz))

    def components(self, output: Tensor) -> Tensor:
        """(N, 2, H, W) output with small components zeroed, straight-through."""
        zeroed = torch.where(output.abs() < self.dead_zone, 0.0, output)
        return _straight_through(zeroed, output)

    def mask(self, output: Tensor) -> Tensor:
        """(N, H, W) float mask, 0 or 1; backward it is the output's amplitude, clipped to [0, 1].

        The amplitude's gradient is the output's direction. At exactly 0 it has none (any direction is a
        subgradient) and the diagonal is taken, so that even a prediction of nothing at all can grow. The
        clip is needed: the mask does not change beyond amplitude 1, but an unclipped gradient would pull on
        every object pixel about ten times as hard as the mean absolute error and drive amplitudes to 1e17.
        """
        hard = (self.components(output).norm(dim=1) >= self.mask_threshold).to(output.dtype)  # (N, H, W)
        size = output.detach().norm(dim=1, keepdim=True)  # (N, 1, H, W)
        diagonal = torch.full_like(output, 0.5**0.5)
        direction = torch.where(size > 0, output.detach() / size.clamp_min(1e-30), diagonal)
        return _straight_through(hard, (direction * output).sum(dim=1).clamp(0, 1))

    def radial_depth_m(self, output: Tensor) -> Tensor:
        """(N, H, W) radial depth, metres: c phi / (4π f) with phi in [0, 2π) on the mask, 0 elsewhere.

        Gradients flow into the phase where there is an object, and into the mask everywhere.
        """
        mask = self.mask(output)  # (N, H, W)
        z = self.components(output)
        # Off the mask the phase must not be differentiated: near amplitude 0 its gradient explodes.
        z = torch.where((mask.detach() > 0)[:, None], z, z.detach())
        wrapped = torch.atan2(z[:, 1], z[:, 0])
        turn_m = float(unambiguous_range_m(self.frequency_hz))  # depth of one whole turn of phase
        depth_m = wrapped * self.metres_per_radian  # (N, H, W), in (-range / 2, range / 2]
        return mask * torch.where(depth_m < 0, depth_m + turn_m, depth_m)


def _straight_through(forward: Tensor, backward: Tensor) -> Tensor:
    """The value of `forward` with the gradient of `backward`."""
    return forward.detach() + (backward - backward.detach())
