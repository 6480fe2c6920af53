"""The network: number of parameters, image sizes, padding, initial weights, and the ability to learn."""

import math

import pytest
import torch

from itof import phasor_of_return
from model.network.readout import Readout
from model.network.unet import UNet, least_weights
from model.paper.loss import NightLoss

FREQUENCY_HZ = 20e6


pytestmark = pytest.mark.usefixtures("one_thread")


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def weight_count(module):
    return sum(weight.numel() for weight in module.parameters())


def test_the_network_of_the_paper_has_7763270_parameters():
    assert weight_count(UNet(7, 32)) == 7_763_270


@pytest.mark.parametrize(("levels", "block"), [(1, 1), (5, 1), (3, 4), (2, 16)])
def test_the_lower_bound_of_the_number_of_weights_is_about_a_quarter(levels, block):
    count = weight_count(UNet(5, 12, levels=levels, block=block, uncertainty=True))
    assert count / 5 < least_weights(5, 12, levels, block) < count


@pytest.mark.parametrize(("channels", "height", "width"), [(7, 16, 32), (12, 30, 40), (3, 17, 5), (1, 1, 33)])
def test_any_channel_count_and_image_size_gives_two_components_of_the_same_size(channels, height, width):
    network = UNet(channels, 2, generator=seeded())
    assert network(torch.randn(2, channels, height, width, generator=seeded())).shape == (2, 2, height, width)


def test_padding_changes_nothing_where_the_receptive_field_does_not_reach_it():
    # forward repeats the edge, evenly on both sides, up to a multiple of 16.
    network = UNet(2, 4, generator=seeded()).double()
    image = torch.randn(1, 2, 30, 44, generator=seeded()).double()
    by_hand = torch.nn.functional.pad(image, (2, 2, 1, 1), mode="replicate")
    torch.testing.assert_close(network(image), network(by_hand)[..., 1:-1, 2:-2], rtol=0, atol=1e-12)


def test_blocks_give_pixels_back_and_pad_to_whole_blocks():
    network = UNet(2, 4, block=2, generator=seeded()).double()
    image = torch.randn(1, 2, 30, 44, generator=seeded()).double()
    by_hand = torch.nn.functional.pad(image, (10, 10, 1, 1), mode="replicate")  # multiples of 32
    assert network(image).shape == (1, 2, 30, 44)
    torch.testing.assert_close(network(image), network(by_hand)[..., 1:-1, 10:-10], rtol=0, atol=1e-12)
    # What follows the U-Net alone tells the pixels of a block apart: with the same weights for all four
    # pixels of a block, and a head that sees single pixels, they are alike.
    with torch.no_grad():
        network.head[0].weight[:] = network.head[0].weight[::4].repeat_interleave(4, dim=0)
        network.head[0].bias[:] = network.head[0].bias[::4].repeat_interleave(4)
        for layer in network.head[3::2]:
            centre = layer.weight[..., 1:2, 1:2].clone()
            layer.weight.zero_()
            layer.weight[..., 1:2, 1:2] = centre
    output = network(by_hand)
    blocks = output.unflatten(-1, (-1, 2)).unflatten(-3, (-1, 2))  # (1, 2, H/2, 2, W/2, 2)
    torch.testing.assert_close(blocks, blocks[..., :1, :, :1].expand_as(blocks), rtol=0, atol=1e-12)
    assert float(output.detach().std()) > 0


@pytest.mark.parametrize(("block", "seen"), [(4, (16, 22)), (2, (32, 44)), (1, (64, 80))])
def test_the_heads_leave_out_padding_that_changes_no_pixel(block, seen):
    network = UNet(2, 4, block=block, uncertainty=True, generator=seeded()).double()
    seen_by_heads = []
    for head in (network.head, network.uncertainty_head):
        head.register_forward_pre_hook(lambda _, given: seen_by_heads.append(given[0].shape[-2:]))
    image = torch.randn(1, 2, 60, 80, generator=seeded()).double()
    output = network(image)
    assert seen_by_heads == [seen, seen]  # blocks; all of them are (16, 32), (32, 48) and (64, 80)
    left, top = -80 % (16 * block) // 2, -60 % (16 * block) // 2
    by_hand = torch.nn.functional.pad(image, (left, left, top, top), mode="replicate")
    whole = network(by_hand)[..., top : top + 60, left : left + 80]
    torch.testing.assert_close(output, whole, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("levels", "multiple"), [(1, 1), (3, 4), (4, 8)])
def test_a_network_with_fewer_levels_lacks_the_deepest_and_pads_to_smaller_multiples(levels, multiple):
    network, deeper = (UNet(2, 4, levels=each, generator=seeded()).double() for each in (levels, levels + 1))
    deepest = (deeper.encoder[-1], deeper.upsampling[0], deeper.decoder[0])
    assert weight_count(network) == weight_count(deeper) - sum(map(weight_count, deepest))
    image = torch.randn(1, 2, 30, 41, generator=seeded()).double()
    down, across = -30 % multiple, -41 % multiple
    sides = (across // 2, across - across // 2, down // 2, down - down // 2)
    whole = network(torch.nn.functional.pad(image, sides, mode="replicate"))
    assert whole.shape == (1, 2, 30 + down, 41 + across)
    by_hand = whole[..., sides[2] :, sides[0] :][..., :30, :41]
    torch.testing.assert_close(network(image), by_hand, rtol=0, atol=1e-12)


@pytest.mark.parametrize("slope", [0, 0.1])
def test_weights_come_from_the_generator_alone_and_keep_the_signal_alive(slope):
    first, second = (UNet(12, 8, negative_slope=slope, generator=seeded(3)) for _ in range(2))
    other = UNet(12, 8, negative_slope=slope, generator=seeded(4))
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))
    image = torch.randn(4, 12, 30, 40, generator=seeded())
    output = first(image).detach()
    assert not torch.equal(output, other(image))
    # He's initialisation keeps the scale of the input, which is 1. PyTorch's divides it by 2.4 in each of 22
    # layers. The bound is half way between the two.
    assert 2.4**-11 < float(output.std()) < 2.4**11


def test_impossible_networks_are_refused():
    for wrong in ({"input_channels": 0}, {"width": 0}, {"levels": 0}, {"block": 0}):
        with pytest.raises(ValueError, match="at least one channel"):
            UNet(**{"input_channels": 3} | wrong)


def test_the_network_learns_one_batch_by_heart():
    generator = seeded()
    channels = torch.randn(2, 3, 14, 24, generator=generator)
    mask = torch.zeros(2, 14, 24)
    mask[0, 3:7, 5:12], mask[1, 6:11, 12:20] = 1, 1
    depth_m = mask * torch.tensor([2.4, 3.1])[:, None, None]
    phasor = torch.from_numpy(phasor_of_return(depth_m.numpy(), FREQUENCY_HZ))
    target = (torch.stack([phasor.real, phasor.imag], dim=1) * mask[:, None]).float()
    loss = NightLoss(Readout(FREQUENCY_HZ))
    # Learnt by heart: nearer to the truth than the truth moved by one pixel.
    moved = [target.roll(step, axis) for step in (1, -1) for axis in (2, 3)]
    wanted = min(float(loss(output, target, depth_m, mask)) for output in moved)
    network = UNet(3, 8, generator=generator)
    optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
    reached = math.inf
    for _ in range(300):
        optimiser.zero_grad()
        value = loss(network(channels), target, depth_m, mask)
        value.backward()
        optimiser.step()
        reached = min(reached, float(value.detach()))
        if reached < wanted:
            break
    assert reached < wanted
