"""Other networks and losses than those of NIGHT: train and judge each, beside NIGHT's own.

This makes the table of notebook/experiments.md again, and is the place for new ideas. Each row changes one
thing against the preset `five-levels` without images of the three bounces. Interrupted runs continue, and
finished runs are only judged. Run, for all or for some:

    .venv/bin/python benchmarks/other_networks.py data80 --out others
    .venv/bin/python benchmarks/other_networks.py data80 --out others --only dense-map residual --seeds 3
"""

import argparse
import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

import torch
from ablations import cells, judged
from torch import Tensor, nn
from torch.nn import functional

from itof.metrics import Summary
from model.data.shards import Shards, open_shards
from model.network.loss import MaskAndDepthLoss
from model.network.mask_and_depth import log_error
from model.network.unet import LEVELS, UNet
from model.prediction.predictor import load
from model.run_folder import run_config
from model.settings.keys import merged
from model.settings.presets import training_preset
from model.settings.train_settings import TrainSettings, settings_from_dict
from model.training import step
from model.training.loop import train
from scenegen import Dataset, open_dataset

MAP_LEVEL = 2  # of the encoder: 12 x 8 positions at 80 x 60 with blocks of 2 x 2
MAP_CHANNELS = 16
EDGE_WEIGHT = 1.0
SLOPE_WEIGHT = 2.0


class ResidualUNet(UNet):
    """Each pair of convolutions adds to a 1x1 convolution of its input."""

    def __init__(self, *sizes: int, generator: torch.Generator | None = None, **options: object) -> None:
        super().__init__(*sizes, generator=generator, **options)  # type: ignore[arg-type]
        self.encoder = nn.ModuleList(_Residual(pair) for pair in self.encoder)
        self.decoder = nn.ModuleList(_Residual(pair) for pair in self.decoder)
        self._initialise(generator)
        for block in (*self.encoder, *self.decoder):
            nn.init.zeros_(block.pair[2].weight)  # otherwise the scale doubles with every block


class _Residual(nn.Module):
    def __init__(self, pair: nn.Sequential) -> None:
        super().__init__()
        self.pair = pair[:3]  # without the last ReLU
        self.brought = nn.Conv2d(pair[0].in_channels, pair[0].out_channels, kernel_size=1)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.pair(x) + self.brought(x))


class DenseMapUNet(UNet):
    """On one level, learned weights connect every position of the image with every other one.

    Each pixel of the wall shows light of the whole object.
    """

    def __init__(
        self, *sizes: int, positions: int, generator: torch.Generator | None = None, **options: object
    ) -> None:
        super().__init__(*sizes, generator=generator, **options)  # type: ignore[arg-type]
        channels = self.encoder[MAP_LEVEL][0].out_channels
        self.encoder[MAP_LEVEL].append(_DenseMap(channels, positions, generator))


class _DenseMap(nn.Module):
    def __init__(self, channels: int, positions: int, generator: torch.Generator | None) -> None:
        super().__init__()
        self.narrow, self.wide = nn.Conv2d(channels, MAP_CHANNELS, 1), nn.Conv2d(MAP_CHANNELS, channels, 1)
        values = MAP_CHANNELS * positions
        self.map = nn.Linear(values, values, bias=False)
        nn.init.normal_(self.narrow.weight, std=channels**-0.5, generator=generator)
        nn.init.normal_(self.map.weight, std=values**-0.5, generator=generator)
        for zero in (self.narrow.bias, self.wide.weight, self.wide.bias):
            nn.init.zeros_(zero)  # the first output is that of the network without the map

    def forward(self, x: Tensor) -> Tensor:
        few = self.narrow(x)
        mapped = self.map(few.flatten(1)).reshape(few.shape)
        return x + self.wide(functional.relu(mapped))


class FewerPixelsUNet(UNet):
    """Every 2 x 2 pixels of the input have their mean, so the output has four times the pixels of the input.

    The light on the wall is smooth, the object's edge is not.
    """

    def forward(self, channels: Tensor) -> Tensor:
        """As that of `UNet`."""
        height, width = channels.shape[-2:]
        means = functional.avg_pool2d(channels, 2, ceil_mode=True, count_include_pad=False)
        return super().forward(functional.interpolate(means, scale_factor=2)[..., :height, :width])


class EdgeLoss(MaskAndDepthLoss):
    """The cross entropy of the pixels at the edge of the true object counts once more, as their mean."""

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """As that of `MaskAndDepthLoss`."""
        grown = functional.max_pool2d(mask[:, None], 3, stride=1, padding=1)[:, 0]
        shrunk = 1 - functional.max_pool2d(1 - mask[:, None], 3, stride=1, padding=1)[:, 0]
        edge = grown - shrunk  # (N, H, W)
        entropy = functional.binary_cross_entropy_with_logits(output[:, 0], mask, reduction="none") * edge
        more = (entropy.sum(dim=(1, 2)) / edge.sum(dim=(1, 2)).clamp_min(1)).mean()
        return super().__call__(output, target, radial_depth_m, mask) + EDGE_WEIGHT * more


class SlopeLoss(MaskAndDepthLoss):
    """The differences of depth between neighbouring object pixels count, too: they say its normals."""

    def __call__(self, output: Tensor, target: Tensor, radial_depth_m: Tensor, mask: Tensor) -> Tensor:
        """As that of `MaskAndDepthLoss`."""
        error = output[:, 1] - self.readout.standardised(radial_depth_m)
        more = torch.zeros((), device=output.device)
        for axis in (1, 2):
            both = mask.narrow(axis, 1, mask.shape[axis] - 1) * mask.narrow(axis, 0, mask.shape[axis] - 1)
            slope = torch.diff(error, dim=axis).abs() * both
            more = more + (slope.sum(dim=(1, 2)) / both.sum(dim=(1, 2)).clamp_min(1)).mean()
        return super().__call__(output, target, radial_depth_m, mask) + SLOPE_WEIGHT * more


class LaplaceLoss(MaskAndDepthLoss):
    """The likelihood of a Laplace distribution for the depth too, not only for its expected error."""

    def of_depth(self, output: Tensor, expected: Tensor) -> Tensor:
        """As that of `MaskAndDepthLoss`."""
        scale = log_error(output)
        return (output[:, 1] - expected).abs() * (-scale).exp() + scale


@dataclass(frozen=True)
class Other:
    """A row of the table: its words, and the network and the loss that stand in for those of NIGHT."""

    words: str
    network: Callable[[Shards], Callable[..., UNet]] = lambda _: UNet
    loss: type[MaskAndDepthLoss] = MaskAndDepthLoss
    bounce_images: bool = False


def dense_map(shards: Shards) -> Callable[..., UNet]:
    """The network with a dense map for images of this size."""
    step = 2 * 2 ** (LEVELS - 1)  # pixels of a position of the deepest level, with blocks of 2 x 2
    sides = (shards.manifest.width, shards.manifest.height)
    across, down = (-(-side // step) * 2 ** (LEVELS - 1 - MAP_LEVEL) for side in sides)
    return partial(DenseMapUNet, positions=across * down)


OTHERS = {
    "none": Other("preset `five-levels` without images of the three bounces"),
    "images": Other("preset `five-levels`", bounce_images=True),
    "residual": Other("residual blocks", lambda _: ResidualUNet),
    "dense-map": Other("a dense learned map at 12 x 8 positions", dense_map),
    "fewer-pixels": Other("means of 2 x 2 pixels in, every pixel out", lambda _: FewerPixelsUNet),
    "edge": Other("pixels at the edge of the object count more", loss=EdgeLoss),
    "slope": Other("slopes of the depth count, too", loss=SlopeLoss),
    "laplace": Other("Laplace likelihood of the depth", loss=LaplaceLoss),
}


def main() -> None:
    """Train and judge what is not finished, a row at a time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--only", nargs="+", choices=list(OTHERS), default=list(OTHERS))
    parser.add_argument("--seeds", type=int, default=1, help="runs per row, default 1")
    parser.add_argument("--width", type=int, default=16, help="channels of the first level, default 16")
    parser.add_argument("--max-epochs", type=int, default=30)
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    epochs = {"max_epochs": given.max_epochs, "patience": given.max_epochs}
    dataset = open_dataset(given.dataset)
    for name in given.only:
        found = []
        for seed in range(given.seeds):
            images = {"input": {"channels": {"bounce_images": OTHERS[name].bounce_images}}}
            of_row = images | {"network": {"width": given.width}, "run": epochs | {"seed": seed}}
            settings = settings_from_dict(merged(training_preset("five-levels")[0], of_row), "five-levels")
            found.append(result(OTHERS[name], dataset, settings, given.out / f"{name}-{seed}"))
            print(line(OTHERS[name], found), flush=True)


def result(other: Other, dataset: Dataset, settings: TrainSettings, out: Path) -> Summary:
    """Metrics of the test scenes, after the training if that is not finished."""
    shards = open_shards(dataset)
    network = other.network(shards)
    with patch.object(run_config, "UNet", network), patch.object(step, "MaskAndDepthLoss", other.loss):
        train(dataset, out, settings, resume=(out / "run.json").is_file())
        return judged(load(out), shards, shards.rows("test"))


def line(other: Other, found: list[Summary]) -> str:
    """A row of the table."""
    return f"| {other.words} | {len(found)} | {cells(*found)} |"


if __name__ == "__main__":
    main()
