"""The weights of a network for other images: more or fewer pixels, or other frequencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log

import torch
from torch import Tensor

from model.network.channels import InputSpec

_HEADS = ("head", "uncertainty_head")


_FIRST = "encoder.0.0.weight"


def with_other_frequencies(
    weights: Mapping[str, Tensor], inputs: InputSpec, frequencies_hz: Sequence[float], block: int
) -> dict[str, Tensor]:
    """The weights of a network for residual channels at other modulation frequencies.

    The channels of a frequency get the first weights of the nearest one that the network knows, by their
    ratio; frequencies that share these, equal parts. All else stays.

    Parameters
    ----------
    weights : of a `UNet`, by name, without the images of its corner.
    inputs : the input channels of the network.
    frequencies_hz : wanted ones, Hz, ascending.
    block : pixels per side of a position of the U-Net.
    """
    own, first = inputs.frequencies_hz, inputs.residual_channels[0]
    above = range(1, len(own))  # their real parts, less that of the first one, are channels

    def nearest(places: Sequence[int], hz: float) -> int:
        return min(places, key=lambda place: abs(log(own[place] / hz)))

    taken = [first + nearest(range(len(own)), hz) for hz in frequencies_hz]
    taken += [first + len(own) - 1 + nearest(above, hz) for hz in frequencies_hz[1:] if above]
    by_channel = weights[_FIRST].unflatten(1, (-1, block**2))
    residual = torch.stack([by_channel[:, place] / taken.count(place) for place in taken], dim=1)
    rest = by_channel[:, first + inputs.residual_channels[1] :]
    joined = torch.cat([by_channel[:, :first], residual, rest], dim=1)
    return {**weights, _FIRST: joined.flatten(1, 2)}


def with_other_pixels(weights: Mapping[str, Tensor], block: int, other: int) -> dict[str, Tensor]:
    """The weights of a network whose blocks have `other` pixels per side instead of `block`.

    *More pixels.* The first convolution takes the means of pixels for the earlier pixels. The first
    convolution of a head gives all of them the same features. So the network predicts what it did, except
    that the 3x3 convolutions of the head, which see single pixels, now see a smaller part of the image.

    *Fewer pixels.* The opposite: the first convolution takes a pixel for all those that were in its place,
    and the head has the means of their features. More pixels and fewer again give the same weights.

    Parameters
    ----------
    weights : of a `UNet`, by name, without the images of its corner.
    block, other : one is a multiple of the other.
    """
    found = {}
    for name, weight in weights.items():
        head, *place = name.split(".")
        if name == _FIRST:
            found[name] = _of_blocks(weight, 1, block, other) * (block / other) ** 2
        elif head in _HEADS and place[0] == "0":
            found[name] = _of_blocks(weight, 0, block, other)
        elif head in _HEADS:  # after the layer that makes pixels of blocks, if there is one
            number = int(place[0]) - (block > 1) + (other > 1)
            found[f"{head}.{number}.{place[1]}"] = weight
        else:
            found[name] = weight
    return found


def _of_blocks(weight: Tensor, axis: int, block: int, other: int) -> Tensor:
    """A weight with an entry for each pixel of a block along `axis`, repeated or averaged for `other`."""
    by_pixel = weight.unflatten(axis, (-1, block, block))
    for side in (axis + 1, axis + 2):
        if other > block:
            by_pixel = by_pixel.repeat_interleave(other // block, side)
        else:
            by_pixel = by_pixel.unflatten(side, (other, -1)).mean(side + 1)
    return by_pixel.flatten(axis, axis + 2)
