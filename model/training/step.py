"""One step of training: from rows on the device to updated weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Final, cast

import torch
from torch import Tensor

from model.data.augmentation import Augmentation, Draws
from model.data.batches import Batch, BatchMaker
from model.data.rows import RowBlock
from model.device import number_type
from model.network.loss import MaskAndDepthLoss
from model.network.mask_and_depth import MaskAndDepth
from model.paper.augmentation import PaperAugmentation
from model.paper.loss import NightLoss
from model.run_folder.run_config import RunConfig
from model.settings.augmentation import AugmentationSettings
from model.settings.target import ComponentsTarget, MaskAndDepthTarget
from model.training.optimisation import Optimisation
from model.training.processes import Processes

_ORDER: Final = torch.channels_last  # of memory; faster on most processors


def loss_of_run(config: RunConfig) -> NightLoss | MaskAndDepthLoss:
    """The loss that the settings of a run choose."""
    readout, target = config.readout, config.settings.target
    if isinstance(target, MaskAndDepthTarget):
        return MaskAndDepthLoss(cast(MaskAndDepth, readout), target.smooth_l1_beta)
    loss_on = target.loss_on if isinstance(target, ComponentsTarget) else "depth"
    return NightLoss(
        *(readout, target.loss, loss_on, target.alpha, target.balance),
        background_per_object=config.background_per_object,
    )


def augmentation_of(settings: AugmentationSettings) -> Augmentation:
    """The random changes that the settings of a run choose."""
    ours = {field.name: getattr(settings, field.name) for field in fields(Augmentation)}
    if settings.paper is None:
        return Augmentation(**ours)
    others = {field.name for field in fields(PaperAugmentation)} - ours.keys()
    return PaperAugmentation(**ours, **{name: getattr(settings.paper, name) for name in others})


class TrainingStep:
    """Network, loss and optimiser of a run, in the run's number type.

    Attributes
    ----------
    network : the network that is trained.
    maker : makes batches from rows.
    loss : loss of outputs, according to the settings.
    optimisation : updates the weights of `network`.

    Parameters
    ----------
    steps_per_epoch : number of steps in an epoch, for the learning rate schedule.
    weights : weights to start from, all or some; the others are random.
    """

    def __init__(
        self,
        config: RunConfig,
        maker: BatchMaker,
        processes: Processes,
        steps_per_epoch: int,
        weights: Mapping[str, Tensor] | None = None,
    ) -> None:
        settings, device = config.settings, processes.device
        self.maker, self.augmentation = maker, augmentation_of(settings.augmentation)
        self._device_type, self._number_type = device.type, number_type(settings.run.precision, device)
        network = config.network(torch.Generator().manual_seed(settings.run.seed))
        if weights is not None:
            network.load_state_dict(network.state_dict() | dict(weights))
        network = network.to(device)
        self.network = network.to(memory_format=_ORDER)  # type: ignore[call-overload]
        self._trained = processes.parallel(self.network)
        self.loss = loss_of_run(config)
        self.optimisation = Optimisation(self.network, settings, steps_per_epoch, device)

    def loss_of(self, rows: RowBlock, draws: Draws) -> Tensor:
        """Loss of the network on augmented rows, with the graph that `take` needs."""
        batch = self.augmentation(rows, self.maker, draws)
        return self.judge(self.output(batch, self._trained), batch)

    def take(self, loss: Tensor) -> None:
        """Update the weights to reduce `loss`."""
        self.optimisation.step(loss)

    def judge(self, output: Tensor, batch: Batch) -> Tensor:
        """Loss of a network output."""
        return self.loss(output, batch.target, batch.radial_depth_m, batch.mask)

    def uncertainty(self, output: Tensor, batch: Batch) -> Tensor:
        """The part of `judge` that is the likelihood of the expected errors; 0 without uncertainty."""
        readout = self.loss.readout
        if not (isinstance(readout, MaskAndDepth) and readout.has_uncertainty):
            return output.new_zeros(())
        rest = replace(self.loss, readout=replace(readout, has_uncertainty=False))
        without = rest(output, batch.target, batch.radial_depth_m, batch.mask)
        return self.judge(output, batch).double() - without.double()  # so that what is left is `without`

    def output(self, batch: Batch, network: Callable[[Tensor], Tensor]) -> Tensor:
        """(N, C, H, W) float32 output of `network`; its convolutions use the run's number type."""
        with torch.autocast(self._device_type, self._number_type, enabled=self._number_type != torch.float32):
            return network(batch.channels.contiguous(memory_format=_ORDER))
