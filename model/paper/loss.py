"""The training loss: mean of a weighted mean absolute error and of 1 - intersection over union."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.network.readout import Readout
from model.settings.target import Balance, ComponentsTarget, LossName, LossTarget


@dataclass(frozen=True)
class NightLoss:
    """L = (L_MAE + L_IoU) / 2, averaged over the images of a batch; `name` selects other terms.

    *L_MAE* = w MAE(object) + MAE(background), w = alpha |B| / |O|, where |O| and |B| are the numbers of
    object and background pixels. `balance` says of what, and what the two MAE are divided by.

    ``image``: the pixels of the image. Both MAE are sums over their pixels divided by the number of pixels of
    the *whole* image, so alpha = 1 balances object and background, and alpha = 1/7 gives an object pixel the
    weight of about 4 background pixels (|B| / |O| = 30.2 in the released code). The object term equals
    alpha |B| / (|B| + |O|) times the mean error of the object pixels: it is bounded if an image has a single
    object pixel, and 0 if it has none.

    ``dataset``: the same sums, but |B| / |O| is one number, that of all training scenes. An object pixel
    weighs the same in every image; a large object weighs more than a small one.

    ``class-means``: the pixels of the image, and both MAE are means over their own pixels. An object pixel
    then weighs as much as alpha (|B| / |O|)^2 background pixels, 130 in an image of the ratio 30.2. A class
    without pixels has the error 0.

    *L_IoU* = 1 - |P ∩ O| / |P ∪ O| of the predicted mask P and the true mask O; 0 if both are empty.

    *Gradient at an empty prediction.* Neither term is stationary there: |0 - target| has a gradient on every
    object pixel, and so does the straight-through mask, dIoU/dP = 1 / |O|. On the background both gradients
    are 0.

    *Other names.* ``mae``: L_MAE alone. ``mse``: squares instead of absolute values, with the same weights.
    ``mse+iou``: the mean of that and L_IoU. ``mae+lovasz``: the mean of L_MAE and the Lovász-Softmax loss of
    the object (`lovasz_jaccard`) with `Readout.presence` as its probability, which is the amplitude
    also where the mask comes from the depth.

    Attributes
    ----------
    readout : computes mask and depth from the output.
    name : terms of the loss.
    on : quantity whose error is taken. ``components``: the mean of |Re error| and |Im error| of the raw
        output, as in the paper's released code; this target is smooth and does not wrap. ``depth``: the
        radial depth in metres, as in the paper's text; where the mask is wrong, the error is the depth
        itself. A network that predicts depth has always this error.
    alpha : weight of the object pixels.
    balance : ``image`` is ours, ``dataset`` the released code's, ``class-means`` the text's.
    background_per_object : |B| / |O| of the training scenes, for the balance ``dataset``.

    Raises
    ------
    ValueError : the balance ``dataset`` without `background_per_object`.

    Source: Caligiuri et al. 2024, sec. 4.2; normalisation and straight-through details are ours.
    """

    readout: Readout
    name: LossName = ComponentsTarget.loss
    on: LossTarget = ComponentsTarget.loss_on
    alpha: float = ComponentsTarget.alpha
    balance: Balance = ComponentsTarget.balance
    background_per_object: float | None = None

    def __post_init__(self) -> None:
        if self.balance == "dataset" and self.background_per_object is None:
            raise ValueError("the balance dataset needs background_per_object of the training scenes")

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """Loss of (N, C, H, W) outputs, a scalar.

        Parameters
        ----------
        target : (N, 2, H, W) true Re and Im.
        radial_depth_m : (N, H, W) true radial depth, metres, 0 on background.
        mask : (N, H, W) true mask, 0 or 1, of the same number type as the output.
        """
        error = self.mean_error(output, target, radial_depth_m, mask)
        if self.name.endswith("+iou"):
            overlap = intersection_over_union(self.readout.mask(output), mask)
            return (error + 1 - overlap).mean() / 2
        if self.name.endswith("+lovasz"):
            return (error + lovasz_jaccard(self.readout.presence(output), mask)).mean() / 2
        return error.mean()

    def mean_error(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """(N,) L_MAE of every image, or the same with squares."""
        power = 2 if self.name.startswith("mse") else 1
        if self.on == "components" and self.readout.target == "components":
            error = (output - target).abs().pow(power).mean(dim=1)  # (N, H, W)
        else:
            error = (self.readout.radial_depth_m(output) - radial_depth_m).abs().pow(power)
        object_pixels = mask.sum(dim=(1, 2))  # (N,)
        pixels = mask[0].numel()
        background_pixels = pixels - object_pixels
        weight: float | Tensor
        if self.background_per_object is not None and self.balance == "dataset":
            weight = self.alpha * self.background_per_object
        else:
            weight = self.alpha * background_pixels / object_pixels.clamp_min(1)
        on_object = (error * mask).sum(dim=(1, 2))
        on_background = (error * (1 - mask)).sum(dim=(1, 2))
        if self.balance == "class-means":
            return weight * (on_object / object_pixels.clamp_min(1)) + on_background / (
                background_pixels.clamp_min(1)
            )
        return weight * (on_object / pixels) + on_background / pixels


def intersection_over_union(mask_pred: Tensor, mask_gt: Tensor) -> Tensor:
    """(N,) IoU of (N, H, W) masks of 0 and 1; 1 if both are empty. Differentiable in `mask_pred`."""
    intersection = (mask_pred * mask_gt).sum(dim=(1, 2))
    union = (mask_pred + mask_gt - mask_pred * mask_gt).sum(dim=(1, 2))
    return torch.where(union > 0, intersection / torch.where(union > 0, union, 1), torch.ones_like(union))


def lovasz_jaccard(probability: Tensor, mask: Tensor) -> Tensor:
    """(N,) Lovász extension of the Jaccard loss, of (N, H, W) probabilities that a pixel shows the object.

    A pixel has the error m = 1 - p on the object and m = p elsewhere. The Jaccard loss of a set M of wrong
    pixels, with O the object, is J(M) = 1 - |O - M| / |O ∪ M|. With the errors in descending order,
    m_1 >= m_2 >= ..., and M_i the first i pixels, the loss is

        sum_i m_i (J(M_i) - J(M_(i-1))).

    For probabilities 0 and 1 it is 1 - IoU. It is continuous, piecewise linear in p, and differentiable
    except where errors are equal. Without an object it is the largest p.

    Parameters
    ----------
    probability : in [0, 1].
    mask : true mask, 0 or 1, of the same number type.

    Source: Berman, Triki, Blaschko, "The Lovász-Softmax loss: a tractable surrogate for the optimization of
    the intersection-over-union measure in neural networks", CVPR 2018, for one class.
    """
    truth = mask.flatten(1)  # (N, P)
    error = (truth - probability.flatten(1)).abs()
    error, order = error.sort(dim=1, descending=True, stable=True)
    truth = truth.gather(1, order)
    total = truth.sum(dim=1, keepdim=True)  # (N, 1)
    kept = total - truth.cumsum(dim=1)  # |O - M_i|
    union = total + (1 - truth).cumsum(dim=1)  # |O ∪ M_i|, at least 1
    jaccard = 1 - kept / union  # (N, P), J(M_i)
    step = torch.diff(jaccard, dim=1, prepend=torch.zeros_like(total))
    return (error * step).sum(dim=1)
