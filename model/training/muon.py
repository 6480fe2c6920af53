"""Muon: an optimiser for the weights of layers that map features to features."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

MOMENTUM = 0.95
SCALE = 0.2  # size of a step of a weight, in learning rates: that of Adam in the middle of a training
ITERATIONS = 5
_QUINTIC = (3.4445, -4.7750, 2.0315)  # brings singular values between 0.01 and 1 to between 0.7 and 1.2


class Muon(torch.optim.Optimizer):
    """Momentum whose steps are orthogonalised: all singular values of the step of a layer are about 1.

    Adam's steps are dominated by few directions of a layer; here all directions move alike. A weight with
    more than two axes counts as a matrix of its first axis and all others. The step of a matrix of n x m is
    scaled by 0.2 times the root of the larger of n and m, so that its weights change by 0.2 learning rates
    (root mean square), as with Adam.

    `torch.optim.Muon` refuses the weights of convolutions, and computes in bfloat16 only, which takes several
    times as long as float32 on a processor without such instructions.

    Parameters
    ----------
    weights : at least one, each with two or more axes.
    learning_rate : step size.
    number_type : number type of the matrix products; bfloat16 is enough.

    Source: Jordan et al., "Muon: an optimizer for hidden layers in neural networks", 2024 (momentum, the
    coefficients of the iteration); Liu et al., "Muon is scalable for LLM training", arXiv 2502.16982, 2025,
    sec. 2.2 (scale).
    """

    def __init__(
        self, weights: Iterable[Tensor], learning_rate: float, number_type: torch.dtype = torch.float32
    ) -> None:
        self._number_type = number_type
        super().__init__(weights, {"lr": learning_rate})
        for group in self.param_groups:
            for weight in group["params"]:  # from the start, because steps may be left out
                self.state[weight]["momentum"] = torch.zeros_like(weight)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> None:  # type: ignore[override]
        """One step against the gradients; a weight without a gradient stays as it is."""
        for group in self.param_groups:
            for weight in group["params"]:
                if weight.grad is not None:
                    self._move(weight, weight.grad, group["lr"])

    def _move(self, weight: Tensor, gradient: Tensor, learning_rate: float) -> None:
        momentum = self.state[weight]["momentum"].lerp_(gradient, 1 - MOMENTUM)
        ahead = gradient.lerp(momentum, MOMENTUM).flatten(1)  # Nesterov
        step = orthogonalised(ahead.to(self._number_type)).to(weight.dtype)
        scale: float = SCALE * max(ahead.shape) ** 0.5
        weight -= step.reshape(weight.shape) * (learning_rate * scale)  # inf, not an error, if too large


def orthogonalised(matrix: Tensor) -> Tensor:
    """The (n, m) matrix with singular values between 0.7 and 1.2 instead of its own.

    The Newton-Schulz iteration X <- a X + b (X X^T) X + c (X X^T)^2 X changes singular values only. Those
    below a thousandth of the norm stay smaller, and so do all of a matrix with a norm below 1e-7: such is the
    momentum of a layer that gets no gradient any more.

    Source: Jordan et al. 2024.
    """
    is_tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if is_tall else matrix
    x = x / x.norm().clamp(min=1e-7)
    a, b, c = _QUINTIC
    for _ in range(ITERATIONS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.T if is_tall else x
