"""Factors on the logits and on the expected errors, after which both hold for the validation pixels.

Networks that are trained with an overlap in their loss are more certain than they are right. The factor on
the logits (temperature scaling) leaves the mask at the threshold 0.5 as it is. Both are fitted after each
epoch and become part of the kept weights: the last layers are linear, so scaled weights give scaled logits,
and a moved bias gives scaled errors, whose logarithm the network predicts.

Source: Guo et al., "On calibration of modern neural networks", ICML 2017, sec. 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from model.network.mask_and_depth import MaskAndDepth, log_error
from model.network.unet import UNet

_LARGEST: Final = 1024.0  # of a logit; larger ones count as this
_BINS: Final = 4096  # of the logits, which the fit takes at their means
_LEAST, _MOST = 1e-3, 1e3  # factors
_HALVINGS: Final = 60  # of the interval of the factor's logarithm, down to rounding


class LogitCount:
    """Counts pixels by logit and truth, in sums that processes can add.

    Attributes
    ----------
    sums : (3, BINS) float64: pixels, sum of their logits, and pixels that show the object, in bins of equal
        width in the square root of the logit's size, so that they are finest about 0.
    """

    def __init__(self, device: torch.device) -> None:
        self.sums = torch.zeros(3, _BINS, dtype=torch.float64, device=device)

    def add(self, logit: Tensor, mask: Tensor) -> None:
        """Count (N, H, W) logits of pixels that show the object where `mask` is above 0."""
        known = logit.detach().double().nan_to_num(0.0)  # an epoch with NaN is refused, after its last batch
        clipped = known.clamp(-_LARGEST, _LARGEST).flatten()
        place = (clipped.sign() * (clipped.abs() / _LARGEST).sqrt() + 1) / 2 * _BINS  # in [0, BINS]
        index = place.long().clamp(max=_BINS - 1)
        shown = (mask.flatten() > 0).double()
        for row, values in enumerate((torch.ones_like(clipped), clipped, shown)):
            self.sums[row].index_add_(0, index, values)


def logit_factor(sums: Tensor) -> float:
    """The factor on the logits that minimises the cross entropy of all counted pixels.

    The derivative, sum over pixels of logit (sigmoid(factor · logit) - shown), grows with the factor, so its
    zero is found by halving. 1 if there are only pixels of one kind.
    """
    count, total, shown = sums.cpu()
    there = count > 0
    count, shown = count[there], shown[there]
    logit = total[there] / count
    if not 0 < float(shown.sum()) < float(count.sum()):
        return 1.0

    def slope(factor: float) -> float:
        return float((logit * (count * (factor * logit).sigmoid() - shown)).sum())

    low, high = _LEAST, _MOST
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if slope(middle) < 0 else (low, middle)
    return math.sqrt(low * high)


@dataclass(frozen=True)
class UncertaintyFactors:
    """Factors on the logits and on the expected errors of the depth."""

    logit_factor: float = 1.0
    error_factor: float = 1.0

    def weights(self, network: UNet, weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """`weights` of `network` with these factors; tensors that stay as they are, are shared."""
        last = f"head.{len(network.head) - 1}"
        scaled = dict(weights)
        for name in (f"{last}.weight", f"{last}.bias"):
            changed = weights[name].clone()
            changed[0] *= self.logit_factor
            scaled[name] = changed
        if network.uncertainty_head is not None:
            name = f"uncertainty_head.{len(network.uncertainty_head) - 1}.bias"
            scaled[name] = weights[name] + math.log(self.error_factor)
        return scaled


class UncertaintyFit:
    """Fits `UncertaintyFactors` to predictions that come batch by batch, in one process or several."""

    def __init__(self, readout: MaskAndDepth, device: torch.device) -> None:
        self.readout, self._logits = readout, LogitCount(device)
        self._errors = torch.zeros(2, dtype=torch.float64, device=device)  # sum of actual / expected; pixels

    def add(self, output: Tensor, radial_depth_m: Tensor, mask: Tensor) -> None:
        """Add (N, C, H, W) predictions with their truth: depth in metres and mask, (N, H, W)."""
        self._logits.add(output[:, 0], mask)
        if self.readout.has_uncertainty:
            actual = (output[:, 1] - self.readout.standardised(radial_depth_m)).abs()
            over_expected = (actual / log_error(output).exp())[mask > 0].double()
            self._errors += torch.stack([over_expected.sum(), over_expected.new_tensor(len(over_expected))])

    def result(self, total: Callable[[Tensor], Tensor]) -> UncertaintyFactors:
        """The factors.

        The factor on the errors is the mean of actual / expected error over the true object's pixels: the
        most likely one if errors have a Laplace distribution. 1 if there are none, or if none has an error.

        Parameters
        ----------
        total : sum of a tensor over the processes.
        """
        over_expected, pixels = total(self._errors).tolist()
        factor = over_expected / pixels if over_expected > 0 else 1.0
        return UncertaintyFactors(logit_factor(total(self._logits.sums)), factor)
