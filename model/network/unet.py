"""The network: a U-Net from input channels to the phasor, or the depth, of the mirrored scene."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from model.network.bounce_images import PLANES, BounceImages
from model.network.ray_channels import answered, seen

LEVELS = 5  # of the encoder of the paper's network, with four poolings between them
HEAD_CHANNELS = (16, 8, 4)  # then the output
UNCERTAINTY_CHANNELS = (16, 8)  # then the logarithm of the depth's error


class UNet(nn.Module):
    """U-Net of the paper, with the sizes of the released code: any number of input channels, any image size.

    *Layers.* Encoder: levels of width w, 2w, 4w, 8w and 16w (w = 32 in the released code), each with two 3x3
    convolutions and ReLU, and a 2x2 max pooling between levels; with fewer `levels`, the last ones are
    missing. Decoder: on each level a 2x2 transposed convolution, concatenation with the encoder's output of
    that level (skip connection), two 3x3 convolutions with ReLU. Head: a 1x1 convolution to 16 channels, then
    3x3 convolutions to 8, 4 and 2 channels, with ReLU between them. There is no ReLU after the last one,
    because Re and Im have both signs. A network that predicts depth has one output channel instead of two,
    and no other difference.

    *Blocks.* With `block` > 1, each block of that many pixels squared becomes one position of the U-Net, and
    all its values are channels of it; the U-Net's output becomes pixels again before the head's 3x3
    convolutions. Hidden light is smooth over the wall, so nothing is lost (notebook/experiments.md), and
    the U-Net has a quarter of the multiplications with 2. The paper's network has 1.

    *Rectifiers.* A ReLU that is 0 in every pixel of every image gets no gradient any more: such units are
    dead. With a `negative_slope`, the ReLUs are leaky and no unit dies.

    *Uncertainty.* With `uncertainty`, a second head like the first one, with 16 and 8 channels, adds one
    output: the logarithm of the expected error of the depth. It sees the decoder's last features and gives
    them no gradient, so everything else is trained as without it.

    *Images.* With `images`, there are more input channels: images that a linear inverse of the three bounces
    makes from the others (`model.network.bounce_images`).

    *Rays.* With `rays`, the last three channels are the rays of the pixels; large images are averaged to
    fewer pixels, and outputs are interpolated to theirs (`model.network.ray_channels`).

    *Padding.* An image size that is not a multiple of 16 blocks (8 with four levels) is padded to the next
    multiple and the output is cropped. The padding is divided as evenly as possible between the two sides, so
    that a flip of the image is a flip of the padded image. It repeats the edge, because zeros would add an
    edge to a smooth field.

    *Initial weights.* Normal distribution by He et al., biases zero. There are no normalisation layers: with
    PyTorch's default the scale falls by a factor of about 2.4 in each of 22 layers, and the initial output
    is constant over the image.

    *Number types.* Under `torch.autocast` the first block and the head compute in float32. A half float can
    represent neither the hidden 0.2 % of an input channel (docs/science/design.md, Number types) nor phase
    differences of a few thousandths of a radian.

    Parameters
    ----------
    input_channels : C, at least 1.
    width : channels of the first level, at least 1; 32 gives 7,763,270 parameters with 7 input channels.
    levels : of the encoder, at least 1.
    negative_slope : of the ReLUs below 0, at least 0 and below 1.
    output_channels : 2 for Re and Im, 1 for depth.
    block : pixels per side of a position of the U-Net, at least 1.
    uncertainty : whether there is the second head.
    images : makes images of the input channels; None for a network without them.
    rays : whether the last three channels are rays.
    generator : random generator of the initial weights; None for PyTorch's global one.

    Raises
    ------
    ValueError : `input_channels`, `width`, `levels` or `block` is below 1.

    Source: Caligiuri et al. 2024, sec. 4.2 (a network similar to a U-Net, then convolutions); their released
    code (sizes); He et al., "Delving deep into rectifiers", ICCV 2015; Shi et al., "Real-time single
    image and video super-resolution using an efficient sub-pixel convolutional neural network", CVPR 2016
    (blocks).
    """

    def __init__(
        self,
        input_channels: int,
        width: int = 32,
        *,
        levels: int = LEVELS,
        negative_slope: float = 0.0,
        output_channels: int = 2,
        block: int = 1,
        uncertainty: bool = False,
        images: BounceImages | None = None,
        rays: bool = False,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        if min(input_channels, width, levels, block) < 1:
            raise ValueError(
                f"a U-Net needs at least one channel and one level, got {input_channels} channels in, a "
                f"width of {width}, {levels} levels and blocks of {block} pixels"
            )
        self.levels, self.negative_slope, self.block, self.images = levels, negative_slope, block, images
        self.rays = rays
        widths = [width * 2**level for level in range(levels)]
        self.encoder = nn.ModuleList(
            self._two_convolutions(before, after)
            for before, after in pairwise([(input_channels + (PLANES if images else 0)) * block**2, *widths])
        )
        deepest_first = widths[::-1]
        self.upsampling = nn.ModuleList(
            nn.ConvTranspose2d(deep, shallow, kernel_size=2, stride=2)
            for deep, shallow in pairwise(deepest_first)
        )
        self.decoder = nn.ModuleList(
            self._two_convolutions(2 * shallow, shallow) for shallow in deepest_first[1:]
        )
        self.head = self._head(width, (*HEAD_CHANNELS, output_channels))
        # After all else, so that the other initial weights are those of a network without it.
        self.uncertainty_head = self._head(width, (*UNCERTAINTY_CHANNELS, 1)) if uncertainty else None
        self._initialise(generator)

    def forward(self, channels: Tensor) -> Tensor:
        """(N, C', H, W) output channels from (N, C, H, W) input channels, that of the uncertainty last."""
        if not self.rays:
            return self._outputs(channels)
        images, looks_left = seen(channels)
        output = self._outputs(images.contiguous(memory_format=torch.channels_last))
        return answered(output, looks_left, (channels.shape[-2], channels.shape[-1]))

    def _outputs(self, channels: Tensor) -> Tensor:
        height, width = channels.shape[-2:]
        multiple = self.block * 2 ** (self.levels - 1)
        left, right, top, bottom = (*_padding(width, multiple), *_padding(height, multiple))
        x = channels if self.images is None else torch.cat([channels, self.images(channels)], dim=1)
        x = functional.pad(x, (left, right, top, bottom), mode="replicate")
        x = functional.pixel_unshuffle(x, self.block) if self.block > 1 else x
        first, *deeper = self.encoder
        with torch.autocast(x.device.type, enabled=False):
            x = first(x)
        skips = [x]
        for block in deeper:
            x = block(functional.max_pool2d(x, 2))
            skips.append(x)
        skips.pop()  # the output of the deepest level is x itself
        for upsample, block in zip(self.upsampling, self.decoder, strict=True):
            x = upsample(x)
            # The number type of the convolutions: one float32 skip would make both halves float32, and back.
            x = block(torch.cat([skips.pop().to(x.dtype), x], dim=1))
        # The heads see single pixels and few neighbours, so they leave most of the padding out.
        rows, columns = (_blocks_seen(*axis, self.block) for axis in ((top, height), (left, width)))
        top, left = top - rows.start * self.block, left - columns.start * self.block
        with torch.autocast(x.device.type, enabled=False):
            features = x[..., rows, columns].to(channels.dtype)
            output: Tensor = self.head(features)
            if self.uncertainty_head is not None:
                output = torch.cat([output, self.uncertainty_head(features.detach())], dim=1)
        return output[..., top : top + height, left : left + width]

    @property
    def independent_parts(self) -> tuple[list[nn.Parameter], ...]:
        """Weights whose gradients do not depend on each other: all, or those of the second head apart."""
        if self.uncertainty_head is None:
            return (list(self.parameters()),)
        second = list(self.uncertainty_head.parameters())
        apart = {id(weight) for weight in second}
        return [weight for weight in self.parameters() if id(weight) not in apart], second

    @property
    def inner_weights(self) -> list[Tensor]:
        """Weights, without biases, of the convolutions of encoder and decoder but the first one: they map
        features to features.
        """
        first = self.encoder[0][0].weight  # type: ignore[index]
        layers = [*self.encoder.modules(), *self.upsampling, *self.decoder.modules()]
        convolutions = [each for each in layers if isinstance(each, nn.Conv2d | nn.ConvTranspose2d)]
        return [each.weight for each in convolutions if each.weight is not first]

    def _two_convolutions(self, before: int, after: int) -> nn.Sequential:
        return nn.Sequential(
            nn.Conv2d(before, after, kernel_size=3, padding=1),
            self._rectifier(),
            nn.Conv2d(after, after, kernel_size=3, padding=1),
            self._rectifier(),
        )

    def _head(self, width: int, channels: tuple[int, ...]) -> nn.Sequential:
        """A 1x1 convolution to the first of `channels`, then, in pixels, 3x3 ones to the others."""
        layers: list[nn.Module] = [nn.Conv2d(width, channels[0] * self.block**2, kernel_size=1)]
        if self.block > 1:
            layers.append(nn.PixelShuffle(self.block))
        for before, after in pairwise(channels):
            layers += [self._rectifier(), nn.Conv2d(before, after, kernel_size=3, padding=1)]
        return nn.Sequential(*layers)

    def _rectifier(self) -> nn.Module:
        return nn.LeakyReLU(self.negative_slope) if self.negative_slope else nn.ReLU()

    def _initialise(self, generator: torch.Generator | None) -> None:
        last = [head[-1] for head in (self.head, self.uncertainty_head) if head is not None]
        for module in self.modules():
            if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                # An output of a transposed convolution with stride 2 depends on one weight per input channel.
                fan_in = module.in_channels * (
                    1 if isinstance(module, nn.ConvTranspose2d) else module.kernel_size[0] ** 2
                )
                is_linear = isinstance(module, nn.ConvTranspose2d) or module in last
                # A ReLU halves the power (He et al., eq. 10); a leaky one leaves more (their eq. 15).
                gain = 1.0 if is_linear else 2 / (1 + self.negative_slope**2)
                nn.init.normal_(module.weight, std=(gain / fan_in) ** 0.5, generator=generator)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)


def least_weights(input_channels: int, width: int, levels: int, block: int) -> int:
    """A lower bound of the number of weights of a `UNet`, about a quarter of them.

    These are the weights of the first convolution and of the last one of the deepest level.
    """
    return 9 * (input_channels * block**2 * width + (width * 2 ** (levels - 1)) ** 2)


def average_with_flip(network: Callable[[Tensor], Tensor], channels: Tensor, output: Tensor) -> Tensor:
    """(N, C', H, W) mean of `output` of (N, C, H, W) channels and of that of the images upside down."""
    return (output + network(channels.flip(-2)).flip(-2)) / 2


def _blocks_seen(before: int, size: int, block: int) -> slice:
    """The blocks of an axis that the heads need for `size` pixels after `before` pixels of padding."""
    reach = len(HEAD_CHANNELS)  # pixels, one for each 3x3 convolution; the second head has fewer
    return slice(max(0, (before - reach) // block), -(-(before + size + reach) // block))


def _padding(size: int, multiple: int) -> tuple[int, int]:
    """Pixels to add before and after an axis of `size` pixels, so that it becomes a multiple."""
    missing = -size % multiple
    before = missing // 2
    return before, missing - before
