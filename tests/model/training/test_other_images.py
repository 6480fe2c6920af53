"""A network for other images than another: the same U-Net on other blocks, or at other frequencies."""

import pytest
import torch
from synthetic_dataset import write_synthetic_dataset
from training_runs import FLIP, settings

from model.network.channels import InputSpec
from model.network.unet import UNet
from model.prediction.predictor import load
from model.run_folder.run_config import RunError
from model.training.loop import train
from model.training.other_images import with_other_frequencies, with_other_pixels
from model.training.refusals import TrainingError

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


KNOWN = ("a 20", "a 50", "a 60", "b 50", "b 60")  # imaginary parts, then real ones less that at 20 MHz


@pytest.mark.parametrize(
    ("mhz", "sources"),
    [
        ((20, 60), ["a 20", "a 60", "b 60"]),
        ((40, 70), ["a 50", "a 60", "b 60"]),
        ((20, 30, 50, 60), ["a 20", "a 20", "a 50", "a 60", "b 50", "b 50", "b 60"]),
        ((30,), ["a 20"]),
    ],
)
@pytest.mark.parametrize("block", [1, 2])
def test_other_frequencies_begin_with_the_weights_of_the_nearest_ones(mhz, sources, block):
    """A network sees what it saw, where the images of all frequencies that share weights are the same."""
    options = {"width": 4, "levels": 2, "block": block}
    network = UNet(6, generator=torch.Generator().manual_seed(0), **options).double()
    inputs = InputSpec(
        *("residual+wall", (20e6, 50e6, 60e6), 1.0, (1.0,) * 5, "measured", "self", (1.0, 1.0))
    )
    weights = with_other_frequencies(network.state_dict(), inputs, [1e6 * each for each in mhz], block)
    other = UNet(len(sources) + 1, **options).double()
    other.load_state_dict(weights)
    images = torch.randn(2, len(sources) + 1, 8, 12, generator=torch.Generator().manual_seed(1)).double()
    for place, source in enumerate(sources):
        images[:, place] = images[:, sources.index(source)]
    before = torch.zeros(2, 6, 8, 12).double()
    before[:, 5] = images[:, -1]
    for place, name in enumerate(KNOWN):
        if name in sources:
            before[:, place] = images[:, sources.index(name)]
    torch.testing.assert_close(other(images), network(before))


def test_a_training_at_other_frequencies_begins_with_a_network_and_has_its_own_scales(tmp_path):
    three, two = ({"itof": {"frequencies_hz": hz}} for hz in ([20e6, 50e6, 60e6], [30e6, 60e6]))
    known = write_synthetic_dataset(tmp_path / "three", count=6, **three)
    chosen = {"target": "mask+depth", "channels": "residual", "width": 4, "max_epochs": 1}
    train(known, tmp_path / "known", settings(**FLIP | chosen))
    other = write_synthetic_dataset(tmp_path / "two", count=6, **two)
    still = FLIP | chosen | {"learning_rate": 1e-30, "noise_sigma": 0.0}
    train(
        other, tmp_path / "new", settings(**still, frequencies_hz=[30e6, 60e6]), start_from=tmp_path / "known"
    )
    config = load(tmp_path / "new", "cpu").config
    assert config.inputs.frequencies_hz == (30e6, 60e6)
    assert len(config.inputs.residual_scale) == 3
    with pytest.raises((RunError, TrainingError), match="50 MHz is not among 30, 60 MHz"):
        train(other, tmp_path / "no", settings(**FLIP | chosen), start_from=tmp_path / "known")
