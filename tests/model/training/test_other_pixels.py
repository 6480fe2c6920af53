"""A network for images with more or fewer pixels than another: the same U-Net on other blocks of pixels."""

import pytest
import torch
from synthetic_dataset import write_synthetic_dataset
from training_runs import FLIP, settings

from model.network.unet import UNet
from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.training.loop import train
from model.training.other_pixels import with_other_pixels

pytestmark = pytest.mark.usefixtures("one_thread")
PROBABLE = FLIP | {"target": "mask+depth", "uncertainty": True, "width": 4}


def finer(image, times):
    return image.repeat_interleave(times, -2).repeat_interleave(times, -1)


def seeing_single_pixels(network):
    """The network with heads whose 3x3 convolutions see only the pixel itself."""
    with torch.no_grad():
        for head in (network.head, network.uncertainty_head):
            for layer in head.modules():
                if isinstance(layer, torch.nn.Conv2d) and layer.kernel_size == (3, 3):
                    centre = layer.weight[..., 1:2, 1:2].clone()
                    layer.weight.zero_()
                    layer.weight[..., 1:2, 1:2] = centre
    return network


@pytest.mark.parametrize(("block", "times"), [(1, 2), (2, 2), (2, 3), (1, 1)])
def test_it_predicts_the_same_for_images_that_show_the_same(block, times):
    options = {"width": 4, "levels": 3, "uncertainty": True}
    generator = torch.Generator().manual_seed(0)
    coarse = seeing_single_pixels(UNet(3, block=block, generator=generator, **options).double())
    network = UNet(3, block=block * times, **options).double()
    network.load_state_dict(with_other_pixels(coarse.state_dict(), block, block * times))
    image = torch.randn(2, 3, 14, 22, generator=generator).double()
    with torch.no_grad():
        wanted = finer(coarse(image), times)
        torch.testing.assert_close(network(finer(image, times)), wanted, rtol=0, atol=1e-12)
        # It sees the means of the pixels only (here without padding, which repeats single pixels).
        noise = torch.randn(2, 3, 16 * times, 24 * times, generator=generator).double()
        means = torch.nn.functional.avg_pool2d(noise, times)
        torch.testing.assert_close(network(noise), network(finer(means, times)), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("block", "times"), [(1, 2), (2, 2), (1, 6)])
def test_more_pixels_and_fewer_again_are_the_same_network(block, times):
    weights = UNet(3, 4, levels=2, block=block, uncertainty=True).state_dict()
    more = with_other_pixels(weights, block, block * times)
    again = with_other_pixels(more, block * times, block)
    assert again.keys() == weights.keys()
    for name, weight in weights.items():  # means of equal numbers: rounding only
        torch.testing.assert_close(again[name], weight, rtol=4e-7, atol=0)


def test_a_training_begins_with_the_network_of_a_run_with_smaller_blocks(closed_form_scenes, tmp_path):
    coarse, still = tmp_path / "coarse", {"learning_rate": 1e-30, "noise_sigma": 0.0, "max_epochs": 1}
    train(closed_form_scenes, coarse, settings(**PROBABLE, block=1))
    many = write_synthetic_dataset(tmp_path / "many", count=6, width=48, height=28)
    for name, block in (("kept", 1), ("finer", 2)):
        train(many, tmp_path / name, settings(**PROBABLE | still, block=block), start_from=coarse)
    network = load(tmp_path / "finer", "cpu").network
    weights = load(coarse, "cpu").network.state_dict()
    expected = with_other_pixels(weights, 1, 2)
    for name, weight in network.state_dict().items():
        last = name.startswith(("head.7", "uncertainty_head.5"))  # scaled after each epoch
        assert last or torch.allclose(weight, expected[name], rtol=0, atol=1e-20), name
    assert load(tmp_path / "finer", "cpu").config.settings.network.block == 2
    with pytest.raises(RunError, match=r"block is 3, but .* with 2.* a multiple or a part of 2"):
        train(many, tmp_path / "no", settings(**PROBABLE, block=3), start_from=tmp_path / "finer")
