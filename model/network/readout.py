"""Reading a network output: object mask and radial depth, with gradients through the thresholds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from itof import depth_from_phase, unambiguous_range_m
from model.settings.target import ComponentsTarget, MaskGradient, MaskSource, Target

# The gradient of the phase is 1 / amplitude and diverges at 0. Below this amplitude, the dead zone of the
# paper's released code, it is that of this amplitude.
LEAST_AMPLITUDE = 0.05


@dataclass(frozen=True)
class Readout:
    """Mask and depth of (N, C, H, W) outputs: C = 2, Re and Im of the mirrored scene, or C = 1, its depth.

    A step function has no useful gradient. Each one here is *straight-through*: its value is exact, and its
    gradient is that of the identity.

    Attributes
    ----------
    frequency_hz : modulation frequency of the output, Hz; the first of the dataset.
    mask_threshold : a pixel shows the object if its amplitude is at least this. The ground truth has the
        amplitudes 0 and 1; 0.5 is halfway.
    dead_zone : components of smaller magnitude become 0 before mask and depth are computed. 0.05 in the
        released code: this moves phases within 0.05 rad of an axis onto that axis, up to 6 cm at 20 MHz. 0
        switches it off. If the output is a depth: depths below so many metres become 0, also negative ones.
    mask_from : ``amplitude``: a pixel shows the object if its amplitude is at least `mask_threshold`.
        ``depth``: if its radial depth is above `mask_depth_m`, as in the paper. An output of 0 has phase 0
        and depth 0, so it is background; so is a pixel whose Re alone is above 0, at any amplitude.
    mask_depth_m : threshold of the depth, metres.
    target : what the output is; ``depth``: radial depth in metres, whose mask is that of the depth.
    mask_gradient : what moves a mask that is taken from the depth of a phasor: its amplitude, or that depth.

    Raises
    ------
    ValueError : the mask of a predicted depth is to come from an amplitude.

    Source: thresholds on the depth from Caligiuri et al. 2024, sec. 4.2; straight-through gradients from
    Bengio et al., "Estimating or propagating gradients through stochastic neurons", 2013.
    """

    frequency_hz: float
    mask_threshold: float = ComponentsTarget.mask_threshold
    dead_zone: float = ComponentsTarget.dead_zone
    mask_from: MaskSource = ComponentsTarget.mask_from
    mask_depth_m: float = ComponentsTarget.mask_depth_m
    target: Target = ComponentsTarget.kind
    mask_gradient: MaskGradient = ComponentsTarget.mask_gradient

    def __post_init__(self) -> None:
        if self.target == "depth" and self.mask_from != "depth":
            raise ValueError("a predicted depth has no amplitude: its mask must come from the depth")

    @property
    def output_channels(self) -> int:
        """C, number of channels of the network's output, without that of the uncertainty."""
        return 1 if self.target == "depth" else 2

    @property
    def of_phasors(self) -> Readout:
        """Reads what `components` has made of an output: other than this readout if the output is a depth."""
        if self.target == "components":
            return self
        return replace(self, target="components", mask_from="amplitude", dead_zone=0.0)

    @property
    def rule(self) -> str:
        """What says whether a pixel shows the object, in words."""
        if self.mask_from == "depth":
            dead_zone_m = self.dead_zone if self.target == "depth" else 0.0
            return f"depth above {max(self.mask_depth_m, dead_zone_m):g} m"
        return f"mask threshold {self.mask_threshold:g}"

    @property
    def metres_per_radian(self) -> float:
        """Radial depth per radian of phase, metres."""
        return float(depth_from_phase(1.0, self.frequency_hz))

    def components(self, output: Tensor) -> Tensor:
        """(N, 2, H, W) output with the components inside the dead zone set to 0; straight-through.

        Of a predicted depth: the phasor of amplitude 1 on the mask with the phase of that depth, without a
        gradient.
        """
        if self.target == "depth":
            phase = self.radial_depth_m(output.detach()) / self.metres_per_radian  # (N, H, W)
            return torch.stack([phase.cos(), phase.sin()], dim=1) * self.mask(output.detach())[:, None]
        zeroed = torch.where(output.abs() < self.dead_zone, 0.0, output)
        return straight_through(zeroed, output)

    def mask(self, output: Tensor) -> Tensor:
        """(N, H, W) float mask, 0 or 1, with a straight-through gradient.

        *Of phasors.* The gradient is that of `presence`, the amplitude clipped to [0, 1]. Clipping is
        necessary: beyond amplitude 1 the mask does not change, but the gradient of an unclipped amplitude is
        about ten times that of the mean absolute error on every object pixel and drives amplitudes to 1e17.
        A mask from the depth has this gradient, too: the depth of a pixel appears and disappears with its
        amplitude, at the dead zone. The gradient of the depth itself (`mask_gradient`) only turns phases, and
        with it trainings end at "no object" (notebook/results.md).

        *Of a depth.* The gradient is that of the depth in metres, in the pixels whose mask would
        change if the gradient were followed far enough: those that show the object and should not, and the
        reverse. Without this condition, the depth of every pixel that is right would grow without bound.
        """
        if self.target == "depth" or (self.mask_from == "depth" and self.mask_gradient == "depth"):
            return self._mask_of_depth(self._depth_everywhere_m(output))
        if self.mask_from == "depth":
            shown = self._depth_everywhere_m(output.detach()) > self.mask_depth_m  # (N, H, W)
        else:
            shown = self.components(output).norm(dim=1) >= self.mask_threshold
        return straight_through(shown.to(output.dtype), self.presence(output))

    def presence(self, output: Tensor) -> Tensor:
        """(N, H, W) amplitude of the output, clipped to [0, 1]: 1 on the true object, 0 elsewhere.

        The gradient of the amplitude is the direction of the output. At amplitude 0 the direction is
        undefined (any one is a subgradient); the diagonal is used, so that an output of 0 everywhere can
        still grow.
        """
        diagonal = torch.full_like(output, 0.5**0.5)
        amplitude = (_direction(output, diagonal) * output).sum(dim=1)
        return torch.where(amplitude > 1, 1.0, amplitude)  # `clamp` of torch 2.14 has no gradient at 0 and 1

    def radial_depth_m(self, output: Tensor) -> Tensor:
        """(N, H, W) radial depth, metres: c φ / (4π f) with φ in [0, 2π) on the mask, 0 elsewhere.

        With a mask from the amplitude, the phase receives gradients on the mask only, the mask everywhere.
        With a mask from the depth, the gradient is that of the depth before the threshold, everywhere.
        """
        if self.mask_from == "depth":
            depth_m = self._depth_everywhere_m(output)
            return straight_through(depth_m * (depth_m > self.mask_depth_m), depth_m)
        mask = self.mask(output)  # (N, H, W)
        z = self.components(output)
        # Outside the mask the phase is not differentiated: near amplitude 0 its gradient diverges.
        z = torch.where((mask.detach() > 0)[:, None], z, z.detach())
        return mask * self._depth_of_components_m(z)

    def _mask_of_depth(self, depth_m: Tensor) -> Tensor:
        """(N, H, W) float mask of a depth before the threshold."""
        hard = (depth_m > self.mask_depth_m).to(depth_m.dtype)
        surrogate = depth_m.clone()
        if surrogate.requires_grad:
            # Descent raises the depth where the gradient is negative, which only a missed pixel needs.
            surrogate.register_hook(lambda gradient: gradient * ((gradient < 0) == (hard == 0)))
        return straight_through(hard, surrogate)

    def _depth_everywhere_m(self, output: Tensor) -> Tensor:
        """(N, H, W) depth of every pixel, metres, 0 where both components are in the dead zone.

        A predicted depth is itself the value, and 0 in the dead zone; its gradient is straight-through.
        Otherwise the gradient is that of the raw output's phase, bounded by `LEAST_AMPLITUDE`. An output of 0
        is taken to be on the positive real axis, where the depth is 0.
        """
        if self.target == "depth":
            depth_m = output[:, 0]
            return straight_through(torch.where(depth_m < self.dead_zone, 0.0, depth_m), depth_m)
        value = self._depth_of_components_m(self.components(output.detach()))
        positive_real = torch.zeros_like(output)
        positive_real[:, 0] = 1
        along = _direction(output, positive_real)  # (N, 2, H, W)
        across = torch.stack([-along[:, 1], along[:, 0]], dim=1)  # the direction of a growing phase
        amplitude = output.detach().norm(dim=1).clamp_min(LEAST_AMPLITUDE)  # (N, H, W)
        return straight_through(value, self.metres_per_radian * (across * output).sum(dim=1) / amplitude)

    def _depth_of_components_m(self, z: Tensor) -> Tensor:
        """(N, H, W) radial depth, metres, of (N, 2, H, W) components."""
        wrapped = torch.atan2(z[:, 1], z[:, 0])
        turn_m = float(unambiguous_range_m(self.frequency_hz))  # depth for a phase of 2π
        depth_m = wrapped * self.metres_per_radian  # (N, H, W), in (-range / 2, range / 2]
        return torch.where(depth_m < 0, depth_m + turn_m, depth_m)


def _direction(output: Tensor, at_zero: Tensor) -> Tensor:
    """(N, 2, H, W) output divided by its amplitude, without a gradient; `at_zero` where that is 0."""
    size = output.detach().norm(dim=1, keepdim=True)  # (N, 1, H, W)
    return torch.where(size > 0, output.detach() / size.clamp_min(1e-30), at_zero)


def straight_through(forward: Tensor, backward: Tensor) -> Tensor:
    """The value of `forward` with the gradient of `backward`."""
    return forward.detach() + (backward - backward.detach())
