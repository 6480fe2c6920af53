"""The weights of a network for images with more pixels: each block has more pixels, the U-Net stays."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

_HEADS = ("head", "uncertainty_head")


def with_finer_pixels(weights: Mapping[str, Tensor], block: int, times: int) -> dict[str, Tensor]:
    """The weights of a network whose blocks have `times` as many pixels per side.

    Its first convolution takes the means of `times` x `times` pixels for the earlier pixels. The first
    convolution of a head gives all of them the same features. So the network predicts what it did, except
    that the 3x3 convolutions of the head, which see single pixels, now see a smaller part of the image.

    Parameters
    ----------
    weights : of a `UNet`, by name, without the images of its corner.
    block : pixels per side of a block of this network.
    times : at least 1.
    """
    if times == 1:
        return dict(weights)
    finer = {}
    for name, weight in weights.items():
        head, *place = name.split(".")
        if name == "encoder.0.0.weight":
            finer[name] = _repeated(weight, 1, block, times) / times**2
        elif head in _HEADS and place[0] == "0":
            finer[name] = _repeated(weight, 0, block, times)
        elif head in _HEADS and block == 1:  # the layer that makes pixels of blocks comes in between
            finer[f"{head}.{int(place[0]) + 1}.{place[1]}"] = weight
        else:
            finer[name] = weight
    return finer


def _repeated(weight: Tensor, axis: int, block: int, times: int) -> Tensor:
    """A weight with an entry for each pixel of a block along `axis`, each for `times` x `times` pixels."""
    by_pixel = weight.unflatten(axis, (-1, block, block))
    rows_and_columns = by_pixel.repeat_interleave(times, axis + 1).repeat_interleave(times, axis + 2)
    return rows_and_columns.flatten(axis, axis + 2)
