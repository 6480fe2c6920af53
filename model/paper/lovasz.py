"""Lovász-Softmax loss of one class: a convex extension of 1 - intersection over union to probabilities."""

from __future__ import annotations

import torch
from torch import Tensor


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
