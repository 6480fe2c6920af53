"""Dead units of a network: channels behind a ReLU that are 0 in every pixel of every image."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from model.network.unet import UNet

_AT_ONCE = 16  # images
_PASSES = 8  # a pass leaves about half of the dead units dead


@dataclass(frozen=True)
class _Layer:
    """A convolution of the U-Net, and where its input channels come from.

    Attributes
    ----------
    inputs : name of the rectified layer that the next input channels come from, or a number of channels that
        are behind no ReLU.
    is_rectified : whether a ReLU follows.
    """

    name: str
    convolution: nn.Conv2d | nn.ConvTranspose2d
    inputs: tuple[str | int, ...]
    is_rectified: bool = True

    @property
    def by_output(self) -> Tensor:
        """(outputs, inputs, h, w) view of the weight."""
        weight = self.convolution.weight
        return weight.transpose(0, 1) if isinstance(self.convolution, nn.ConvTranspose2d) else weight


def dead_units(network: UNet, channels: Tensor) -> dict[str, Tensor]:
    """(n,) bool of the n units of each layer of encoder and decoder: whether they are 0 on all images.

    Parameters
    ----------
    channels : (N, C, H, W) input channels of the images.
    """
    alive: dict[str, Tensor] = {}

    def watch(layer: _Layer) -> torch.utils.hooks.RemovableHandle:
        def note(_: nn.Module, __: object, output: Tensor) -> None:
            seen = (output > 0).any(dim=-1).any(dim=-1).any(dim=0)
            alive[layer.name] = alive.get(layer.name, torch.zeros_like(seen)) | seen

        return layer.convolution.register_forward_hook(note)

    hooks = [watch(layer) for layer in _layers(network) if layer.is_rectified]
    try:
        with torch.no_grad():
            for images in channels.split(_AT_ONCE):
                network(images)
    finally:
        for hook in hooks:
            hook.remove()
    return {name: ~each for name, each in alive.items()}


def revive(network: UNet, channels: Tensor, generator: torch.Generator) -> int:
    """Give dead units new weights, so that a training can use them; the number of units that were dead.

    A dead unit has no gradient, so it stays dead. Here it gets random weights, as in a new network. The
    weights with which living units see it become 0, so the output of the network on these images does not
    change. Some of the new units are 0 on all images again; they are drawn again, up to 8 times.

    Parameters
    ----------
    channels : (N, C, H, W) input channels of the images.

    Source: Sokar et al., "The dormant neuron phenomenon in deep reinforcement learning", ICML 2023, sec. 4
    (ReDo: random incoming and zero outgoing weights).
    """
    first = dead = dead_units(network, channels)
    for _ in range(_PASSES):
        if not any(bool(each.any()) for each in dead.values()):
            break
        for layer in _layers(network):
            _renew(layer, dead, generator)
        dead = dead_units(network, channels)
    return sum(int(each.sum()) for each in first.values())


@torch.no_grad()
def _renew(layer: _Layer, dead: Mapping[str, Tensor], generator: torch.Generator) -> None:
    """New weights for the dead units of a layer; its living units no longer see dead ones."""
    weight, bias = layer.by_output, layer.convolution.bias
    outputs, inputs = weight.shape[:2]
    own = dead.get(layer.name, torch.zeros(outputs, dtype=torch.bool))
    weight[~own[:, None] & _dead_inputs(layer.inputs, dead)] = 0
    fresh = torch.randn(int(own.sum()), *weight.shape[1:], generator=generator)
    weight[own] = fresh * (2 / (inputs * weight[0, 0].numel())) ** 0.5
    if bias is not None:
        bias[own] = 0


def _dead_inputs(inputs: Sequence[str | int], dead: Mapping[str, Tensor]) -> Tensor:
    """(C,) bool of the input channels of a layer."""
    parts = [dead[each] if isinstance(each, str) else torch.zeros(each, dtype=torch.bool) for each in inputs]
    return torch.cat(parts)


def _layers(network: UNet) -> Iterator[_Layer]:
    """The convolutions of encoder and decoder, and the first one of each head."""
    parts: dict[str, Any] = dict(network.named_modules())
    before: str | int = parts["encoder.0.0"].in_channels
    for level in range(network.levels):
        one, two = f"encoder.{level}.0", f"encoder.{level}.2"
        yield _Layer(one, parts[one], (before,))
        yield _Layer(two, parts[two], (one,))
        before = two
    for place in range(network.levels - 1):
        up, one, two = f"upsampling.{place}", f"decoder.{place}.0", f"decoder.{place}.2"
        yield _Layer(up, parts[up], (before,), is_rectified=False)
        skip = f"encoder.{network.levels - 2 - place}.2"
        yield _Layer(one, parts[one], (skip, parts[up].out_channels))
        yield _Layer(two, parts[two], (one,))
        before = two
    for head in ("head.0", "uncertainty_head.0"):
        if head in parts:
            yield _Layer(head, parts[head], (before,), is_rectified=False)
