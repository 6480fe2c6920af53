"""The training loss: mean of a weighted mean absolute error and of 1 - intersection over union."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.network.readout import Readout
from model.settings import LossName, LossTarget, TrainSettings


@dataclass(frozen=True)
class NightLoss:
    """L = (L_MAE + L_IoU) / 2, averaged over the images of a batch; `name` selects other terms.

    *L_MAE* = w MAE(object) + MAE(background), w = alpha |B| / |O|, where |O| and |B| are the numbers of
    object and background pixels of the image. Both MAE are sums over their pixels divided by the number of
    pixels of the *whole* image. With this normalisation alpha = 1 balances object and background, and
    alpha = 1/7 gives an object pixel the weight of about 4 background pixels (|B| / |O| = 30.2 in the
    paper). With means over the own pixels instead, w would give an object pixel the weight of 130
    background pixels. The object term equals alpha |B| / (|B| + |O|) times the mean error of the object
    pixels: it is bounded if an image has a single object pixel, and 0 if it has none.

    *L_IoU* = 1 - |P ∩ O| / |P ∪ O| of the predicted mask P and the true mask O; 0 if both are empty.

    *Gradient at an empty prediction.* Neither term is stationary there: |0 - target| has a gradient on every
    object pixel, and so does the straight-through mask, dIoU/dP = 1 / |O|. On the background both gradients
    are 0.

    *Other names.* ``mae``: L_MAE alone. ``mse``: squares instead of absolute values, with the same weights.
    ``mse+iou``: the mean of that and L_IoU.

    Attributes
    ----------
    readout : computes mask and depth from the output.
    name : terms of the loss.
    on : quantity whose error is taken. ``components``: the mean of |Re error| and |Im error| of the raw
        output, as in the paper's released code; this target is smooth and does not wrap. ``depth``: the
        radial depth in metres, as in the paper's text; where the mask is wrong, the error is the depth
        itself.
    alpha : weight of the object pixels.

    Source: Caligiuri et al. 2024, sec. 4.2; normalisation and straight-through details are ours.
    """

    readout: Readout
    name: LossName = TrainSettings.loss
    on: LossTarget = TrainSettings.loss_on
    alpha: float = TrainSettings.alpha

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """Loss of (N, 2, H, W) outputs, a scalar.

        Parameters
        ----------
        target : (N, 2, H, W) true Re and Im.
        radial_depth_m : (N, H, W) true radial depth, metres, 0 on background.
        mask : (N, H, W) true mask, 0 or 1, of the same number type as the output.
        """
        error = self.mean_error(output, target, radial_depth_m, mask)
        if not self.name.endswith("+iou"):
            return error.mean()
        overlap = intersection_over_union(self.readout.mask(output), mask)
        return (error + 1 - overlap).mean() / 2

    def mean_error(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """(N,) L_MAE of every image, or the same with squares."""
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
    """(N,) IoU of (N, H, W) masks of 0 and 1; 1 if both are empty. Differentiable in `mask_pred`."""
    intersection = (mask_pred * mask_gt).sum(dim=(1, 2))
    union = (mask_pred + mask_gt - mask_pred * mask_gt).sum(dim=(1, 2))
    return torch.where(union > 0, intersection / union.clamp_min(1), torch.ones_like(union))
