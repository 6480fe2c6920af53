"""Units that are 0 on all images are found, and new weights for them leave the output as it is."""

import pytest
import torch
from training_runs import checkpoint, settings

from model import train
from model.network.dead_units import dead_units, revive
from model.network.unet import UNet
from model.training.refusals import TrainingError

IMAGES = torch.randn(3, 2, 32, 48, generator=torch.Generator().manual_seed(1))
# Units of every kind of layer; those of the first levels are also seen through the skip connections.
KILLED = {"encoder.0.0": [1], "encoder.1.2": [0, 5], "encoder.4.2": list(range(64)), "decoder.3.2": [2]}


def network(uncertainty=True) -> UNet:
    return UNet(2, 4, uncertainty=uncertainty, generator=torch.Generator().manual_seed(0))


def with_dead_units() -> UNet:
    net = network()
    layers = dict(net.named_modules())
    with torch.no_grad():
        for name, units in KILLED.items():
            layers[name].bias[units] = -1e3
    return net


def units(dead) -> dict[str, list[int]]:
    return {name: each.nonzero().flatten().tolist() for name, each in dead.items()}


def test_units_that_are_never_above_0_are_found():
    net, layers = with_dead_units(), {}
    found = units(dead_units(net, IMAGES))
    assert len(found) == 9 * 2  # every convolution of encoder and decoder
    for name, killed in KILLED.items():
        assert set(killed) <= set(found[name])
    for name, module in net.named_modules():
        if name in found:
            module.register_forward_hook(
                lambda _, __, out, name=name: layers.update({name: out.amax((0, 2, 3))})
            )
    with torch.no_grad():
        net(IMAGES)
    assert found == {name: (most <= 0).nonzero().flatten().tolist() for name, most in layers.items()}


def test_new_weights_leave_the_output_and_all_living_units_as_they_are():
    net = with_dead_units()
    dead, before = dead_units(net, IMAGES), {n: w.detach().clone() for n, w in net.named_parameters()}
    with torch.no_grad():
        output = net(IMAGES)
    count = revive(net, IMAGES, torch.Generator().manual_seed(3))
    assert count == sum(int(each.sum()) for each in dead.values()) > sum(map(len, KILLED.values()))
    with torch.no_grad():
        torch.testing.assert_close(net(IMAGES), output, rtol=1e-5, atol=1e-6)
    for name, gone in dead.items():
        weight, old = net.get_parameter(f"{name}.weight"), before[f"{name}.weight"]
        assert bool((weight[gone] != old[gone]).all())
        kept = weight[~gone]
        assert bool(((kept == old[~gone]) | (kept == 0)).all())


def test_nearly_all_of_the_new_units_live_and_get_a_gradient():
    net = with_dead_units()
    count = revive(net, IMAGES, torch.Generator().manual_seed(3))
    assert sum(int(each.sum()) for each in dead_units(net, IMAGES).values()) < 0.05 * count
    # The first step gives the weights with which others see them a gradient.
    net(IMAGES).square().mean().backward()
    assert bool((net.get_parameter("upsampling.0.weight").grad.abs().amax((1, 2, 3)) > 0).all())


def test_a_network_without_dead_units_stays():
    net = network()
    many = torch.randn(64, 2, 32, 48, generator=torch.Generator().manual_seed(2))
    revive(net, many, torch.Generator().manual_seed(3))  # until all live
    alive = {name: weight.clone() for name, weight in net.state_dict().items()}
    assert revive(net, many, torch.Generator().manual_seed(4)) == 0
    assert all(torch.equal(weight, net.state_dict()[name]) for name, weight in alive.items())


def test_a_training_begins_with_revived_units_and_the_same_predictions(
    closed_form_scenes, finished_run, tmp_path
):
    tiny = {"learning_rate": 1e-30, "max_epochs": 1}  # its steps are too small to change a weight
    for name, revives in (("same", False), ("new", True)):
        train(closed_form_scenes, tmp_path / name, settings(**tiny, revive=revives), start_from=finished_run)
    same, new = checkpoint(tmp_path / "same"), checkpoint(tmp_path / "new")
    assert new["history"][0]["validation_loss"] == pytest.approx(
        same["history"][0]["validation_loss"], rel=1e-5
    )
    differs = [
        name for name, weight in same["network"].items() if not torch.equal(weight, new["network"][name])
    ]
    assert differs  # this small network has dead units


def test_frozen_layers_are_not_revived(closed_form_scenes, finished_run, tmp_path):
    frozen = settings(revive=True, freeze="encoder")
    with pytest.raises(TrainingError, match="revive renews units also in layers that freeze encoder keeps"):
        train(closed_form_scenes, tmp_path / "run", frozen, start_from=finished_run)


def test_units_with_a_slope_below_0_are_not_dead_and_not_revived(closed_form_scenes, finished_run, tmp_path):
    leaky = UNet(2, 4, negative_slope=0.1, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        leaky.encoder[1][2].bias.fill_(-1e3)
    leaky(IMAGES).square().sum().backward()
    assert bool((leaky.encoder[1][2].bias.grad != 0).all())
    with pytest.raises(TrainingError, match="a network with negative_slope has none"):
        train(
            closed_form_scenes,
            tmp_path / "run",
            settings(revive=True, negative_slope=0.1),
            start_from=finished_run,
        )


def test_a_new_run_has_nothing_to_revive(closed_form_scenes, tmp_path):
    with pytest.raises(TrainingError, match=r"revive renews units of a trained run.*--from"):
        train(closed_form_scenes, tmp_path / "run", settings(revive=True))
