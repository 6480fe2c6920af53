"""The training loss: weighted mean absolute error and intersection over union, half each."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.network.readout import Readout
from model.settings import LossName, LossTarget, TrainSettings


@dataclass(frozen=True)
class NightLoss:
    """L = (L_MAE + L_IoU) / 2, or its ablations; each term the mean over the images of a batch.

    L_MAE = w_l MAE(object) + MAE(background) with w_l = alpha |B| / |O|, where |O| and |B| count an image's
    object and background pixels. Both errors are sums over their own pixels divided by the pixels of the
    *whole* image: then w_l = |B| / |O| is what balances the two (alpha = 1), and with alpha = 1/7 an
    object pixel weighs about 4 background pixels (|B| / |O| = 30.2 in the paper). Were each a mean over its
    own pixels, they would be balanced before any weight, and w_l would make an object pixel weigh 130
    background pixels. Put in class means, the object term is alpha |B| / (|B| + |O|) times the mean error
    of an object pixel: it stays bounded when a crop leaves a single object pixel, and it is 0 for an image
    without any.

    L_IoU = 1 - |P ∩ O| / |P ∪ O| of predicted mask P and true mask O; two empty masks agree (0).

    Both can leave a prediction of nothing: |0 - target| has a gradient on every object pixel, and so has
    the straight-through mask, dIoU/dP = 1 / |O|. On the background both are at rest there.

    The ablations: ``mae`` is L_MAE alone, ``mse`` has squares in place of the absolute values, with the
    same weights, ``mse+iou`` is the mean of that and L_IoU.

    Attributes
    ----------
    readout : how an output is read.
    name : which terms.
    on : ``components``: the error is the mean of |Re error| and |Im error|, as in the paper's released
        code, on the raw output (a smooth target everywhere, no wrap). ``depth``: the error is that of the
        radial depth in metres, as in the paper's text; where the mask is wrong it is the depth itself.
    alpha : weight of the object.

    Source: Caligiuri et al. 2024, sec. 4.3; normalisation and straight-through details are ours.
    """

    readout: Readout
    name: LossName = TrainSettings.loss
    on: LossTarget = TrainSettings.loss_on
    alpha: float = TrainSettings.alpha

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """Scalar loss of (N, 2, H, W) outputs.

        Parameters
        ----------
        target : (N, 2, H, W) true Re and Im.
        radial_depth_m : (N, H, W) true depth, metres, 0 on background.
        mask : (N, H, W) true mask, 0 or 1, of the outputs' type.
        """
        error = self.mean_error(output, target, radial_depth_m, mask)
        if not self.name.endswith("+iou"):
            return error.mean()
        overlap = intersection_over_union(self.readout.mask(output), mask)
        return (error + 1 - overlap).mean() / 2  # the mean of two terms, not a path length

    def mean_error(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """(N,) L_MAE, or its like of squares, of every image."""
        power = 2 if self.name.startswith("mse") else 1
        if self.on == "components":
            error = (output - target).abs().pow(power).mean(dim=1)  # (N, H, W)
        else:
            error = (self.readout.radial_depth_m(output) - radial_depth_m).abs().pow(power)
        object_pixels = mask.sum(dim=(1, 2))  # (N,)
        pixels = mask[0].numel()
        weight = self.alpha * (pixels - object_pixels) / object_pixels.clamp_min(1)
        on_object = (error * mask).sum(dim=(1, 2)) / pixels
        on_background = (error * (1 - mask)).sum(dim=(1, 2)) / pixels
        return weight * on_object + on_background


def intersection_over_union(mask_pred: Tensor, mask_gt: Tensor) -> Tensor:
    """(N,) IoU of (N, H, W) masks of 0 and 1; 1 where both are empty. Gradients flow into `mask_pred`."""
    intersection = (mask_pred * mask_gt).sum(dim=(1, 2))
    union = (mask_pred + mask_gt - mask_pred * mask_gt).sum(dim=(1, 2))
    return torch.where(union > 0, intersection / union.clamp_min(1), torch.ones_like(union))
