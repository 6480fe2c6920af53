"""Update of the weights: Adam or Muon, learning rate schedule, gradient clipping, averaged weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from math import cos, pi
from typing import Any, Final, cast

import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_
from torch.optim.swa_utils import AveragedModel

from model.device import number_type
from model.network.unet import UNet
from model.settings.train_settings import OptimiserSettings, TrainSettings
from model.training.checkpoint_contents import (
    ContentsError,
    checked_adam,
    checked_keys,
    checked_muon,
    checked_scaler,
    checked_tensors,
    checked_whole,
)
from model.training.muon import Muon

_FORGOTTEN: Final = 10


def learning_rate(settings: OptimiserSettings, step: int, steps_per_epoch: int, max_epochs: int) -> float:
    """Learning rate of a step; the first step is 0.

    It grows linearly during the warm-up, whose last step has the full rate. Then it is constant, or falls as
    half a cosine that reaches 0 in the step after the last of `max_epochs`.

    Source: Caligiuri et al. 2024, sec. 4.2 (constant); Loshchilov, Hutter, "SGDR", ICLR 2017, eq. 5.
    """
    warm_up = settings.warm_up_epochs
    rate = settings.learning_rate
    if warm_up:
        rate *= min(1.0, (step + 1) / (warm_up * steps_per_epoch))
    if settings.schedule == "constant" or max_epochs <= warm_up:
        return rate
    done = (step / steps_per_epoch - warm_up) / (max_epochs - warm_up)
    done = min(1.0, max(0.0, done))
    return rate * (1 + cos(pi * done)) / 2


def epochs_without_improvement(losses: Sequence[float], min_delta: float) -> int:
    """Epochs since the last validation loss that counts as better.

    A loss counts if it is lower by more than `min_delta` than the last one that counted; the first one
    counts. Many small improvements therefore count together as soon as their sum is large enough.

    Source: a least improvement of 0.015 from the released code of Caligiuri et al. 2024.
    """
    counted, since = math.inf, 0
    for loss in losses:
        since += 1
        if loss < counted - min_delta:
            counted, since = loss, 0
    return since


def averaging(decay: float) -> Callable[[Sequence[Tensor], Sequence[Tensor], Tensor | int], None]:
    """Update of averages by new weights, after a number of updates, in place.

    The new weights count as 1 - decay, or as much as the mean of the last tenth of all steps would let them:
    else the random weights of the beginning would stay for thousands of steps.

    Source: TensorFlow's tf.train.ExponentialMovingAverage with num_updates.
    """

    def update(averages: Sequence[Tensor], weights: Sequence[Tensor], count: Tensor | int) -> None:
        share = max(1 - decay, (_FORGOTTEN - 1) / (_FORGOTTEN + int(count)))
        torch._foreach_lerp_(averages, weights, share)  # type: ignore[call-overload]

    return torch.no_grad()(update)


class Optimisation:
    """Updates the weights of a network with Adam, or with Muon and Adam, according to the settings.

    Attributes
    ----------
    steps : number of steps so far.
    average : exponential moving average of the weights (Polyak averaging), or None.
    gradient_norm : norm of the gradient in the last step, before clipping; 0 before the first step, and
        always 0 without clipping; with uncertainty, of all but its head.
    """

    def __init__(
        self, network: UNet, settings: TrainSettings, steps_per_epoch: int, device: torch.device
    ) -> None:
        self.network, self.steps_per_epoch = network, steps_per_epoch
        self.settings, self._max_epochs = settings.optimiser, settings.run.max_epochs
        rate, numbers = self.settings.learning_rate, number_type(settings.run.precision, device)
        self._by_adam, self._by_muon = self._shared_out()
        self.adam = torch.optim.Adam(self._by_adam, lr=rate, fused=True)
        muon_numbers = torch.bfloat16 if numbers == torch.bfloat16 else torch.float32
        self.muon = Muon(self._by_muon, rate, muon_numbers) if self._by_muon else None
        # Half floats round gradients below 6e-8 to 0, so the loss is scaled up first.
        self.scaler = torch.amp.GradScaler(device.type, enabled=numbers == torch.float16)
        decay = self.settings.ema_decay
        self.average = AveragedModel(network, multi_avg_fn=averaging(decay)) if decay else None
        self.steps = 0
        self.gradient_norm = torch.zeros(())

    def _shared_out(self) -> tuple[list[Tensor], list[Tensor]]:
        """The weights of Adam and those of Muon."""
        trained: list[Tensor] = list(self.network.parameters())
        has_muon = self.settings.algorithm == "muon"
        inner = {id(weight) for weight in self.network.inner_weights} if has_muon else set()
        by_muon = [weight for weight in trained if id(weight) in inner]
        return [weight for weight in trained if id(weight) not in inner], by_muon

    @property
    def _optimisers(self) -> list[torch.optim.Optimizer]:
        return [self.adam, self.muon] if self.muon else [self.adam]

    @property
    def judged(self) -> UNet:
        """The network that is validated and kept; it has the averaged weights if there are any."""
        if self.average is None:
            return self.network
        return cast(UNet, self.average.module)

    def learning_rate(self, step: int) -> float:
        """Learning rate of a step; the first step is 0."""
        return learning_rate(self.settings, step, self.steps_per_epoch, self._max_epochs)

    def step(self, loss: Tensor) -> None:
        """Update the weights to reduce `loss`."""
        rate = self.learning_rate(self.steps)
        for optimiser in self._optimisers:
            for group in optimiser.param_groups:
                group["lr"] = rate
            optimiser.zero_grad()
        self.scaler.scale(loss).backward()
        if self.muon and self.scaler.is_enabled():
            self._spoil_all_if_one_overflowed()
        if self.settings.clip_norm > 0:
            for optimiser in self._optimisers:
                self.scaler.unscale_(optimiser)
            self.gradient_norm, *_ = (
                clip_grad_norm_(part, self.settings.clip_norm) for part in self.network.independent_parts
            )
        for optimiser in self._optimisers:
            self.scaler.step(optimiser)
        self.scaler.update()
        if self.average is not None:
            self.average.update_parameters(self.network)
        self.steps += 1

    def _spoil_all_if_one_overflowed(self) -> None:
        """Let the scaler leave the step of every optimiser out, not only of the one that has the overflow."""
        gradients = [weight.grad for weight in (*self._by_adam, *self._by_muon) if weight.grad is not None]
        if not all(bool(gradient.isfinite().all()) for gradient in gradients):
            for weights in (self._by_adam, self._by_muon):
                next(weight.grad for weight in weights if weight.grad is not None).fill_(math.inf)

    def state(self) -> dict[str, Any]:
        """State that a resumed run needs besides the weights: tensors, numbers and text."""
        return {
            **({"muon": self.muon.state_dict()} if self.muon else {}),
            "adam": self.adam.state_dict(),
            "scaler": self.scaler.state_dict(),
            "average": self.average.state_dict() if self.average is not None else None,
            "steps": self.steps,
        }

    def restore(self, state: Any, steps: int) -> None:
        """Load a state after `steps` steps; `ContentsError` if it is not that of this network."""
        found = checked_keys(state, self.state(), "optimisation")
        if checked_whole(found["steps"], 0, steps, "optimisation.steps") != steps:
            raise ContentsError(f"optimisation.steps must be {steps}, as history and position say")
        adam = checked_adam(found["adam"], self.adam.state_dict(), self._by_adam, steps)
        self.adam.load_state_dict(adam)
        if self.muon:
            muon = checked_muon(found["muon"], self.muon.state_dict(), self._by_muon)
            self.muon.load_state_dict(muon)
        self.scaler.load_state_dict(checked_scaler(found["scaler"], self.scaler.state_dict()))
        if self.average is None:
            if found["average"] is not None:
                raise ContentsError("optimisation.average must be absent")
        else:
            average = checked_tensors(found["average"], self.average.state_dict(), "average")
            if int(average["n_averaged"]) != steps:
                raise ContentsError(f"average: n_averaged must be {steps}")
            self.average.load_state_dict(average)
        self.steps = steps
