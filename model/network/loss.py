"""The loss of the default network, of a mask and a depth; that of the paper is `model.paper.loss`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from model.network.mask_and_depth import MaskAndDepth, log_error
from model.settings.target import MaskAndDepthTarget

MOST_CERTAIN = 40.0  # logit


@dataclass(frozen=True)
class MaskAndDepthLoss:
    """L = cross entropy of the mask + (1 - soft IoU) + error of the depth, averaged over images.

    With uncertainty, the mean of |error| / b + log b over the true object's pixels is added, where b is the
    expected error: the likelihood of a Laplace distribution. The error itself gets no gradient from it.

    The soft IoU of the probabilities p and the true mask m is sum(p m) / sum(p + m - p m). The error e of the
    standardised depth counts as smooth L1, e^2 / (2 beta) below beta and |e| - beta / 2 above, as a mean over
    the true object's pixels; 0 without an object. There the soft IoU is 0 for any p, and the cross entropy
    alone teaches.

    A pixel that is right with a logit beyond +-40 gets no gradient from the mask, instead of one below 1e-17.
    Trained networks have logits of -300 on the background; their gradients would be subnormal numbers, which
    are many times slower on a processor.
    """

    readout: MaskAndDepth
    beta: float = MaskAndDepthTarget.smooth_l1_beta

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """Loss of (N, 2, H, W) outputs, a scalar; the parameters are those of `NightLoss`."""
        logit = torch.where(
            mask > 0, output[:, 0].clamp(max=MOST_CERTAIN), output[:, 0].clamp(min=-MOST_CERTAIN)
        )
        entropy = functional.binary_cross_entropy_with_logits(logit, mask, reduction="none")
        probability = logit.sigmoid()
        both = (probability * mask).sum(dim=(1, 2))  # (N,)
        overlap = both / ((probability + mask).sum(dim=(1, 2)) - both)  # not 0: background has p > 0
        error = self.of_depth(output, self.readout.standardised(radial_depth_m)) * mask
        depth = error.sum(dim=(1, 2)) / mask.sum(dim=(1, 2)).clamp_min(1)
        return (entropy.mean(dim=(1, 2)) + 1 - overlap + depth).mean()

    def of_depth(self, output: Tensor, expected: Tensor) -> Tensor:
        """(N, H, W) loss of each pixel if it shows the object at this standardised depth."""
        error = functional.smooth_l1_loss(output[:, 1], expected, reduction="none", beta=self.beta)
        if self.readout.has_uncertainty:
            scale = log_error(output)
            actual = (output[:, 1] - expected).detach().abs()
            error = error + actual * (-scale).exp() + scale
        return error
