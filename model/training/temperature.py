"""Temperature scaling: one factor on the logits, after which the probabilities of validation pixels hold.

Networks that are trained with an overlap in their loss are more certain than they are right. The factor
leaves the mask at the threshold 0.5 as it is. It is fitted after each epoch and becomes part of the kept
weights: the last layer is linear, so scaled weights give scaled logits.

Source: Guo et al., "On calibration of modern neural networks", ICML 2017, sec. 4.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

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
        clipped = logit.detach().double().clamp(-_LARGEST, _LARGEST).flatten()
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


def scaled_logits(network: UNet, weights: Mapping[str, Tensor], factor: float) -> dict[str, Tensor]:
    """Weights of `network` whose first output is `factor` times that of `weights`; the others are shared."""
    last = f"head.{len(network.head) - 1}"
    scaled = dict(weights)
    for name in (f"{last}.weight", f"{last}.bias"):
        changed = weights[name].clone()
        changed[0] *= factor
        scaled[name] = changed
    return scaled
