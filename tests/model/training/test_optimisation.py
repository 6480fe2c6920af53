"""Learning rate, clipping, half floats and averaged weights agree with their definitions."""

import math

import numpy as np
import pytest
import torch
import training_runs

from model.network.unet import UNet
from model.settings.train_settings import TrainSettings
from model.training.loss_watch import LossError, LossWatch
from model.training.optimisation import Optimisation, epochs_without_improvement, learning_rate

CPU = torch.device("cpu")


def settings(**changes) -> TrainSettings:
    return training_runs.settings(**({"learning_rate": 1e-2, "max_epochs": 11} | changes))


def rate_of(chosen: TrainSettings, step: int, steps_per_epoch: int) -> float:
    return learning_rate(chosen.optimiser, step, steps_per_epoch, chosen.run.max_epochs)


def network() -> UNet:
    return UNet(1, 2, generator=torch.Generator().manual_seed(0))


def loss_of(net: UNet) -> torch.Tensor:
    images = torch.linspace(0, 1, 16 * 16).reshape(1, 1, 16, 16)
    return net(images).square().mean()


def flat(net: UNet) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in net.parameters()])


def test_a_constant_rate_stays():
    assert {rate_of(settings(), step, 4) for step in (0, 1, 43, 500)} == {1e-2}


def test_the_rate_warms_up_linearly_and_falls_as_half_a_cosine():
    both = settings(schedule="cosine", warm_up_epochs=1.0)
    rates = [rate_of(both, step, 12) for step in range(12 * 11 + 1)]  # twelve steps an epoch
    assert rates[:12] == pytest.approx([1e-2 * (step + 1) / 12 for step in range(12)])
    assert rates[12] == pytest.approx(1e-2)
    assert rates[12 * 6] == pytest.approx(0.5e-2)  # half way from 1 to 11
    assert rates[12 + 40] == pytest.approx(0.75e-2)  # a third of the way: cos 60 degrees
    assert rates[-2] > 0  # the last step
    assert rates[-1] == pytest.approx(0, abs=1e-12)
    assert rate_of(both, 10_000, 12) == pytest.approx(0, abs=1e-12)


def test_a_run_of_a_single_step_learns():
    assert rate_of(settings(schedule="cosine", max_epochs=1), 0, 1) == pytest.approx(1e-2)


def test_the_first_step_of_adam_is_one_learning_rate_long_in_every_weight():
    net = network()
    before = flat(net)
    optimisation = Optimisation(net, settings(schedule="cosine", warm_up_epochs=2.0), 5, CPU)
    optimisation.step(loss_of(net))
    moved = (flat(net) - before).abs()
    # m / sqrt(v) is g / |g| after bias correction; eps matters where |g| is near 1e-8.
    expected = 1e-2 / 10  # the first of ten warm-up steps
    gradient = torch.cat([p.grad.flatten() for p in net.parameters()]).abs()
    seen = gradient > 1e-5  # 1000 eps; weights behind dead units have no gradient
    assert int(seen.sum()) > 20
    torch.testing.assert_close(moved[seen], torch.full_like(moved[seen], expected), rtol=2e-3, atol=0)
    assert float(moved.max()) < expected * 1.002


def test_a_gradient_that_is_too_long_is_scaled_to_the_limit_and_its_norm_is_kept():
    net = network()
    loss_of(net).backward()
    gradient = torch.cat([p.grad.flatten() for p in net.parameters()])
    norm = float(gradient.norm())
    optimisation = Optimisation(net, settings(clip_norm=norm / 4), 5, CPU)
    optimisation.step(loss_of(net))
    clipped = torch.cat([p.grad.flatten() for p in net.parameters()])
    assert float(optimisation.gradient_norm) == pytest.approx(norm, rel=1e-5)
    allowed = 1e-6 / norm + 2**-20  # PyTorch adds 1e-6 to the norm; float32
    torch.testing.assert_close(clipped, gradient / 4, rtol=allowed, atol=1e-9)


def test_the_average_of_the_weights_is_that_of_its_definition():
    net = network()
    optimisation = Optimisation(net, settings(ema_decay=0.4), 5, CPU)
    expected = None
    for count in range(8):
        optimisation.step(loss_of(net))
        share = max(0.6, 9 / (10 + count))  # the second until 5 steps are done
        expected = flat(net) if expected is None else (1 - share) * expected + share * flat(net)
    assert optimisation.judged is not net
    torch.testing.assert_close(flat(optimisation.judged), expected, rtol=1e-6, atol=1e-7)


def test_without_an_average_the_network_itself_is_judged():
    net = network()
    assert Optimisation(net, settings(), 5, CPU).judged is net


@pytest.mark.parametrize("precision", ["bfloat16", "float16"])
def test_half_floats_leave_the_first_block_and_the_head_alone(precision):
    net, seen = network(), {}
    for name, module in (("first", net.encoder[0][0]), ("second", net.encoder[1][0]), ("head", net.head[0])):
        module.register_forward_hook(lambda _, __, out, name=name: seen.update({name: out.dtype}))
    # The float32 features of the first block must not make the largest input of the decoder float32, too.
    net.decoder[-1].register_forward_pre_hook(lambda _, inputs: seen.update(joined=inputs[0].dtype))
    images = torch.rand(1, 1, 16, 16, generator=torch.Generator().manual_seed(0))
    number = getattr(torch, precision)
    with torch.no_grad(), torch.autocast("cpu", number):
        half = net(images)
    assert seen == {"first": torch.float32, "second": number, "joined": number, "head": torch.float32}
    with torch.no_grad():
        exact = net(images)
    # About twenty layers, each of which rounds by half a unit in the last of 8 or 11 bits.
    bits = {"bfloat16": 8, "float16": 11}[precision]
    assert float((half - exact).norm() / exact.norm()) < 20 * 2.0 ** -(bits + 1)
    assert not torch.equal(half, exact)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e5])
def test_a_bad_loss_names_its_own_batch_though_it_is_looked_at_later(value):
    watch = LossWatch(3, lambda rows: [f"scene {row}" for row in rows], every=3)
    watch.add(torch.tensor(0.5), [0, 1])
    watch.add(torch.tensor(value), [2, 3])
    with pytest.raises(LossError, match=r"loss became .* in epoch 3, on scenes scene 2, scene 3"):
        watch.add(torch.tensor(value), [4, 5])


def test_good_losses_are_forgotten_once_they_were_looked_at():
    watch = LossWatch(1, lambda rows: [], every=2)
    for _ in range(4):
        watch.add(torch.tensor(1.0), [0])
    watch.look()


@pytest.mark.parametrize(
    ("losses", "min_delta", "since"),
    [
        ([], 0.0, 0),
        ([1.0], 0.5, 0),  # the first epoch counts
        ([1.0, 0.9, 0.9, 0.95], 0.0, 2),  # an equal loss is no better
        ([1.0, 0.75, 0.5, 0.25], 0.25, 1),  # 0.75 is lower by exactly 0.25, 0.5 by 0.5; then 0.25 again
        ([1.0, 0.875, 0.75, 0.625], 0.25, 0),  # small steps count together: 0.375 in three
        ([1.0, 0.5, 0.75, 0.375], 0.25, 2),  # lower than the last that counted, but by 0.125
        ([1.0 - 2.0**-7 * k for k in range(100)], 0.015, 1),  # 2^-7 = 0.0078: every second epoch counts
        (
            [2.0**-k for k in range(20)],
            0.015,
            8,
        ),  # after 2^-6 = 0.0156, 2^-11 = 0.0005 is the first below 0.0006
    ],
)
def test_only_improvements_above_the_least_one_count(losses, min_delta, since):
    assert epochs_without_improvement(losses, min_delta) == since


def test_without_a_least_improvement_the_first_of_the_smallest_losses_is_the_last_that_counts():
    rng = np.random.default_rng(0)
    for length in range(1, 50):
        losses = (rng.integers(8, size=length) / 8).tolist()
        best = losses.index(min(losses))
        assert epochs_without_improvement(losses, 0.0) == len(losses) - 1 - best
