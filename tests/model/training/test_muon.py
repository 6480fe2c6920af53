"""Muon takes the steps of its definition, and only on the inner layers."""

import pytest
import torch
from training_runs import settings

from model.network.unet import UNet
from model.training.muon import SCALE, Muon, orthogonalised
from model.training.optimisation import Optimisation

CPU = torch.device("cpu")
SHAPES = [(12, 5), (5, 12), (7, 7), (8, 1)]


def random(*shape, seed=0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def network(uncertainty=False) -> UNet:
    return UNet(3, 4, uncertainty=uncertainty, generator=torch.Generator().manual_seed(0))


def loss_of(net: UNet) -> torch.Tensor:
    return net(random(2, 3, 16, 16)).square().mean()


def steps_of(net: UNet, **changes) -> dict[str, torch.Tensor]:
    """What the first step of an optimisation adds to each weight."""
    before = {name: weight.detach().clone() for name, weight in net.named_parameters()}
    chosen = settings(learning_rate=1e-2, optimiser="muon", **changes)
    Optimisation(net, chosen, 5, CPU).step(loss_of(net))
    return {name: weight.detach() - before[name] for name, weight in net.named_parameters()}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_singular_values_become_about_1_and_the_directions_stay(shape):
    matrix = random(*shape)
    u, values, v = torch.linalg.svd(matrix, full_matrices=False)
    assert float(values.min() / values.norm()) > 0.01  # those that are smaller need more iterations
    found = u.T @ orthogonalised(matrix) @ v.T
    torch.testing.assert_close(found, torch.diag(found.diagonal()), rtol=0, atol=1e-4)
    assert 0.67 < float(found.diagonal().min()) <= float(found.diagonal().max()) < 1.21


def test_the_length_of_the_gradient_does_not_matter():
    matrix = random(6, 4)
    # Rounding of float32, in five iterations that may triple it.
    for factor in (1e-5, 1e12):
        torch.testing.assert_close(
            orthogonalised(factor * matrix), orthogonalised(matrix), rtol=1e-4, atol=1e-5
        )


def test_a_far_too_large_learning_rate_spoils_the_weights_as_it_does_with_adam():
    # A loss that is not finite then ends the training with one sentence.
    weight = torch.nn.Parameter(random(4, 3))
    optimiser = Muon([weight], 1e300)
    weight.square().sum().backward()
    optimiser.step()
    assert not bool(weight.isfinite().any())


@pytest.mark.parametrize("number", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("factor", [0.0, 1e-38, 1e-22])
def test_a_layer_without_a_gradient_stays_though_its_momentum_is_hardly_0(number, factor):
    # The squares of such numbers are 0, and so is the norm.
    step = orthogonalised((factor * random(6, 4)).to(number))
    assert bool(step.isfinite().all())
    assert float(step.abs().max()) < 1e-10


@pytest.mark.parametrize("shape", SHAPES)
def test_the_steps_are_those_of_pytorch(shape):
    ours, theirs = (torch.nn.Parameter(random(*shape)) for _ in range(2))
    muon = Muon([ours], 0.03, torch.bfloat16)
    reference = torch.optim.Muon([theirs], 0.03, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
    for seed in range(1, 6):
        ours.grad, theirs.grad = random(*shape, seed=seed), random(*shape, seed=seed)
        muon.step()
        reference.step()
    one, other = ours.detach(), theirs.detach()
    assert (
        float((one - other).norm() / (other - random(*shape)).norm()) < 0.02
    )  # products of bfloat16, 8 bits, in another order


def test_a_convolution_counts_as_the_matrix_of_its_first_axis_and_all_others():
    weight, flat = torch.nn.Parameter(random(6, 4, 3, 3)), torch.nn.Parameter(random(6, 36))
    weight.data = weight.data.to(memory_format=torch.channels_last)
    flat.data = weight.data.flatten(1).clone()
    weight.grad = random(6, 4, 3, 3, seed=1).to(memory_format=torch.channels_last)
    flat.grad = weight.grad.flatten(1).clone()
    for each in (weight, flat):
        Muon([each], 0.1).step()
    torch.testing.assert_close(weight.detach().flatten(1), flat.detach(), rtol=0, atol=0)


def test_inner_layers_step_by_a_fifth_of_the_rate_and_all_other_weights_by_adam():
    net = network(uncertainty=True)
    inner = {
        name for name, weight in net.named_parameters() if any(weight is own for own in net.inner_weights)
    }
    # Nine levels of two convolutions without the first, and four transposed ones.
    assert len(inner) == 9 * 2 - 1 + 4
    assert "encoder.0.0.weight" not in inner
    assert not any("head" in name or name.endswith("bias") for name in inner)
    for name, step in steps_of(net).items():
        if name in inner:  # less where the gradient has no part in some directions, as on the deepest levels
            assert 0 < float(step.square().mean().sqrt()) < 1.25 * SCALE * 1e-2, name
        else:
            assert float(step.abs().max()) == pytest.approx(1e-2, rel=0.01) or not step.any(), name
    one = steps_of(network())["encoder.0.2.weight"].square().mean().sqrt()
    assert float(one) > 0.65 * SCALE * 1e-2  # all directions have a part


@pytest.mark.parametrize("broken", ["encoder.1.0.weight", "encoder.0.0.weight"])
def test_an_overflow_in_the_gradients_of_one_optimiser_leaves_the_whole_step_out(broken):
    net = network()
    chosen = settings(learning_rate=1e-2, optimiser="muon", clip_norm=1.0, precision="float16")
    optimisation = Optimisation(net, chosen, 5, CPU)
    before = {name: weight.detach().clone() for name, weight in net.named_parameters()}
    hook = net.get_parameter(broken).register_hook(lambda gradient: gradient * float("nan"))
    optimisation.step(loss_of(net))
    hook.remove()
    assert all(torch.equal(weight, before[name]) for name, weight in net.named_parameters())
    again = Optimisation(net, chosen, 5, CPU)
    again.restore(optimisation.state(), 1)  # a checkpoint after such a step can be resumed
    again.step(loss_of(net))
    assert all(bool(weight.isfinite().all()) for weight in net.parameters())
    assert not torch.equal(net.get_parameter(broken), before[broken])
